"""The command line: one sub-command for each verb, each a few lines over `masking.verbs`."""

from masking.cli.parser import main

__all__ = ["main"]
