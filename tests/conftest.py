"""What all tests share: one cache of compiled models, and models declared in place."""

import base64
import functools
import os
import shutil
import signal
import tempfile

import hypothesis
import pytest

from masking.model.declaration.schema import ModelDeclaration
from masking.model.modelling.model import Model
from masking.reports.style import CaptionedFigure
from tests.processor_time import ProcessorTime

# The gate draws the same examples every time; `HYPOTHESIS_PROFILE=explore` draws new ones.
hypothesis.settings.register_profile("gate", derandomize=True)
hypothesis.settings.register_profile("explore", derandomize=False)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "gate"))


PRIORITY = pytest.StashKey[str]()
PIXEL = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTj2FAAAAABJRU5ErkJggg==")


def pytest_addoption(parser):
    parser.addoption("--write-durations", action="store_true", help="write tests/durations.json")


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
    if "PYTEST_XDIST_WORKER" not in os.environ:  # what plants at addresses remember of their trips
        os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="masking-state-")
        config.add_cleanup(lambda: shutil.rmtree(os.environ.pop("XDG_STATE_HOME"), ignore_errors=True))
    config.pluginmanager.register(ProcessorTime(config))
    if config.getoption("markexpr").startswith("realtime"):
        put_first(config)


def put_first(config):
    """Put real-time tests, and the processes that they start, before other programs, where that is permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))  # below the loops of `masking`, which take more
        config.stash[PRIORITY] = "real-time priority: other programs keep no test waiting"
    except (AttributeError, OSError):
        config.stash[PRIORITY] = "no real-time priority here: tests may fail while other programs keep the cores busy"


def pytest_terminal_summary(terminalreporter, config):
    if said := config.stash.get(PRIORITY, ""):
        terminalreporter.write_line(said)


def declare(**parts) -> Model:
    return Model(ModelDeclaration.model_validate({"name": "test", **parts}))


@pytest.fixture(scope="session")
def declared():
    """Return a function that makes a model of the parts of a declaration."""
    return declare


@pytest.fixture(scope="module", autouse=True)
def _pictures_drawn_once():
    """Draw a figure of each name once in a file of tests; later ones are a pixel. Drawing took a tenth of the gate."""
    drawn, draw = set(), CaptionedFigure.png.func

    def png(figure):
        if figure.figure is None or figure.name not in drawn:
            drawn.add(figure.name)
            return draw(figure)
        return PIXEL

    once = functools.cached_property(png)
    once.__set_name__(CaptionedFigure, "png")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CaptionedFigure, "png", once)
        yield
