"""What all tests share: one cache of compiled models, and models declared in place."""

import gc
import os
import shutil
import signal
import tempfile
import warnings

import hypothesis
import pytest

from masking.model.declaration.schema import ModelDeclaration
from masking.model.modelling.model import Model

# The gate draws the same examples every time; `HYPOTHESIS_PROFILE=explore` draws new ones.
hypothesis.settings.register_profile("gate", derandomize=True)
hypothesis.settings.register_profile("explore", derandomize=False)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "gate"))


def pytest_configure(config):
    """Give the whole session, xdist workers included, one empty cache of generated modules, and signals that work.

    What starts the tests may ignore some, as `nohup` does; processes that tests start would then never be told to stop.
    """
    for number, usual in ((signal.SIGHUP, signal.SIG_DFL), (signal.SIGINT, signal.default_int_handler)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, usual)
    if "MASKING_CACHE" not in os.environ:  # workers inherit the folder from the process that starts them
        os.environ["MASKING_CACHE"] = tempfile.mkdtemp(prefix="masking-tests-")
        config.add_cleanup(lambda: shutil.rmtree(os.environ.pop("MASKING_CACHE"), ignore_errors=True))


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item):
    """Free what a failed try of a test has left open, such as a socket, before another test is blamed for it."""
    if getattr(item, "execution_count", 1) > 1:
        with warnings.catch_warnings(action="ignore", category=ResourceWarning):
            gc.collect()


def declare(**parts) -> Model:
    return Model(ModelDeclaration.model_validate({"name": "test", **parts}))


@pytest.fixture(scope="session")
def declared():
    """Return a function that makes a model of the parts of a declaration."""
    return declare
