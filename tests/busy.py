"""Tests of real time on machines that may keep any process waiting."""

import functools

TRIES = 3


def repeated(test):
    """Try a test of real time up to `TRIES` times: only where it fails each time does it fail."""

    @functools.wraps(test)
    def patient(*args, **kwargs):
        for _ in range(TRIES - 1):
            try:
                return test(*args, **kwargs)
            except AssertionError:
                pass
        return test(*args, **kwargs)

    return patient
