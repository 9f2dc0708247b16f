"""The source document, computed again: its figures and tables beside ours, on the ideal model and on the twin.

`comparison` holds one entry, the chapters and `errata` compute them, `contents` lists them, `cache` keeps them on disk
and `document` writes the page. Numbers of chapters, figures, tables and formulas are those of Rijlaarsdam (2008).
"""
