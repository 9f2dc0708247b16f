"""Processor time of the tests: the order of files, what a test and a file may use, and the slowest files at the end.

`tests/durations.json` holds the processor seconds of each file with its machine code to be made, written by
`pytest --write-durations`. Files are run longest first, so that no worker ends with a long one while the other is idle.
A file that has no entry comes before all others. Processor time counts child processes that have ended; it hardly
depends on what else the machine does, so that a budget can be enforced where a limit of time could not.
"""

import json
import resource
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

DURATIONS = Path(__file__).with_name("durations.json")
MOST_OF_TEST = 150.0  # s: twice what the longest takes on a busy machine, with its machine code to be made
MOST_OF_FILE = 300.0  # s, likewise
SHOWN = 10


def seconds() -> float:
    """Processor time of this process and of its children that have ended, s."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


class ProcessorTime:
    """Plugin of a test session; with xdist, workers measure and the process that starts them sums up."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.files: Counter[str] = Counter()
        self.over: list[str] = []

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Longest files first; within a file the order stays."""
        known = json.loads(DURATIONS.read_text(encoding="utf-8")) if DURATIONS.exists() else {}
        items.sort(key=lambda item: -known.get(file_of(item.nodeid), float("inf")))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure a test with its fixtures; those of a module count in its first test."""
        self.begun = seconds()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
        report = yield
        if call.when == "teardown":
            report.user_properties.append(("processor", seconds() - self.begun))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        used = dict(report.user_properties).get("processor") if report.when == "teardown" else None
        if used is not None:
            self.files[file_of(report.nodeid)] += used
            if used > MOST_OF_TEST:
                self.over.append(f"{report.nodeid}: {used:.0f} s of processor time; a test may use {MOST_OF_TEST:g} s")

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a session in which a test or a file is over its budget."""
        if hasattr(self.config, "workerinput"):
            return
        for name, used in self.files.items():
            if used > MOST_OF_FILE:
                self.over.append(f"{name}: {used:.0f} s of processor time; a file may use {MOST_OF_FILE:g} s")
        if self.over and session.exitstatus == pytest.ExitCode.OK and not self.is_free:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        if self.config.getoption("--write-durations"):
            known = json.loads(DURATIONS.read_text(encoding="utf-8")) if DURATIONS.exists() else {}
            known |= {name: round(used, 1) for name, used in self.files.items()}
            rows = {name: known[name] for name in sorted(known) if (DURATIONS.parents[1] / name).exists()}
            DURATIONS.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")

    @property
    def is_free(self) -> bool:
        """Whether budgets do not hold: those of whole searches are their own."""
        return self.config.getoption("markexpr") == "search"

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """The slowest files, and what is over its budget."""
        if len(self.files) > 1:
            total = sum(self.files.values())
            terminalreporter.write_sep("-", f"processor time: {total:.0f} s, the slowest {SHOWN} files")
            for name, used in self.files.most_common(SHOWN):
                terminalreporter.write_line(f"{used:7.1f} s  {name}")
        if self.over and not self.is_free:
            terminalreporter.write_sep("-", "over the budget of processor time")
            for line in self.over:
                terminalreporter.write_line(line)


def file_of(nodeid: str) -> str:
    """File of a test, relative to the repository."""
    return nodeid.partition("::")[0]
