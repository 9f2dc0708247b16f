"""A second generator of records: machines whose effects are written from their text, with numpy alone.

It shares no line with the effects of the package nor with the first generator (`tests.benchmarks.hidden`). Friction is
set-valued: whether a contact slides or sticks is an event. Springs with play, stops and dashpots in series are elements
that take the place of others.
"""
