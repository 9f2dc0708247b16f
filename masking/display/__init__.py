"""Display: the parts that figures, pages and notebooks are made of, in one style.

In: names, numbers and series.
Out: typeset names, axes, and fragments of HTML.
Imports: nothing.
"""
