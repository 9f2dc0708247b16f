"""How well `masking discover` finds hidden effects: a suite of records, a strict score, PySINDy beside it, a page."""
