"""Numbers in the README and the documentation, computed by the code and written between markers.

A marker is a pair of HTML comments, `<!-- computed: NAME WORDS -->...<!-- end -->`. Between them stands the value that
`tests.documented.values` registers under NAME. `python` is a block of Python whose comments are its values.

    python -m tests.documented            # check every number, also those that take minutes
    python -m tests.documented --write    # compute them again, and write them
"""
