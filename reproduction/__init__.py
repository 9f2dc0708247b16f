"""The source document, computed again: its figures and tables beside ours, on the ideal model and on the twin.

`entry` holds what is compared, the chapters compute it, `contents` lists the entries, `kept` keeps them on disk and
`document` writes the comparison. Numbers of chapters, figures, tables and formulas are those of Rijlaarsdam (2008).
"""
