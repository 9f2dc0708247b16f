"""Reports: facts, sentences, tables, figures, pages and files of each result.

Each result has a file for its text, its figures, its page and its files, such as `discovery_text`; numbers, with their
deviations and units, are written by `declaration.quantities`.

In: results.
Out: their text, figures, pages and files.
Imports: numerics, declaration, display, effects, modelling, records, analysis, rig, estimation, discovery,
procedures.
"""
