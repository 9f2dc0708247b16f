"""The verbs: as functions over files, and as a command line.

In: files, arguments.
Out: files, text or JSON, an exit status.
Imports: compile, display, model, analysis, control, lab, inference, reports.
"""
