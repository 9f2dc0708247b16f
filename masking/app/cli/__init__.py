"""The command line: one sub-command for each verb, each a few lines over `masking.app.workflows`.

The exit status is that of the error (`masking.errors`), 70 for a defect (`defects`), or what the function of a verb
gives (`verbs`, `rig_verbs`); `main_program` makes it the status of the process, an interrupt 130.

In: a command line.
Out: an exit status, and text or JSON.
Imports: display, records, rig, plants, runs, reports, workflows.
"""

from __future__ import annotations

from collections.abc import Sequence

from masking.app.cli.terminal import end_at_interrupts


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, given behind the name of the program; its exit status is that of `parser.main`."""
    if arguments is None:  # in a process of its own
        end_at_interrupts()
    from masking.app.cli import main_program

    return main_program.main(arguments)
