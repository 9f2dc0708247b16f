"""Reports: facts, sentences, tables, figures, pages and files of each result.

A result has a page named after it; where that is long, its text, figures or files stand beside it, such as
`discovery_text`. The page of a run is `run_report`, of what `run_study` finds; `run_text` has its sentences, which
call a phase locked by a threshold of their own. Tables are laid out in `templates/`, with cells from these modules;
the numbers of an error budget are those of `runs.error_budget`. Numbers, with their deviations and units, are written
by `declaration.quantities`.

In: results.
Out: their text, figures, pages and files.
Imports: numerics, declaration, display, effects, modelling, records, analysis, rig, estimation, discovery,
procedures.
"""
