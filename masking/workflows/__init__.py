"""Workflows: the verbs as functions, files in and files out."""
