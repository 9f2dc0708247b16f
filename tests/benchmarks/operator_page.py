"""What the operator's page costs the loop: `python -m tests.benchmarks.operator_page [--seconds S] [--blocks N]`.

The controller of a packaged experiment runs on its twin in real time, in turns alone, with rows shown to nobody, and
with the page in a browser. `work` is the controller, the safety chain and the rows of a tick; `lateness` how late it
began. Of each, the median over the blocks of the median and of the 99th percentile.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.app.workflows.operator_process import Attendant, attend
from masking.control.stepwise_controller import SampledStep
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.loop_rows import known
from masking.lab.runs.operator_link import Operator
from masking.lab.runs.realtime import NO_HOOKS, Hooks, RigRun, run_rig
from tests.support import chromium

EXPERIMENT: Final = "huygens_rig"


def run(experiment: Experiment, operator: Operator | None, seconds: float) -> RigRun:
    """Run the controller of an experiment on its twin in real time, shown to an operator."""
    controller, plant = SampledStep(experiment.sampled), SimulatedPlant(experiment.twin)
    rules = safety_limits.rules(experiment.instruments, controller.rate, experiment.twin, controller.estimate)
    before = experiment.sampled.before
    hooks = NO_HOOKS
    if operator is not None:
        operator.begin(experiment, controller, rules)
        hooks = Hooks(
            on_row=[] if operator.put is None else [operator.put],
            look=operator.look,
            on_end=lambda ran: operator.end(ran.reason, ran.trip),
        )
    return run_rig(
        lambda tick, readings: controller(readings, tick - before),
        plant,
        Settings(controller.rate),
        samples=int(seconds * controller.rate),
        limits=rules,
        hooks=hooks,
        known=known(controller, np.zeros((1, 0))),
    )


class Nobody:
    """Who looks at no page."""

    def wait(self) -> None:
        """Nobody looks."""


@contextlib.contextmanager
def looked_at(tab: Any) -> Iterator[Operator]:
    """Give an operator, with the page in a browser if there is one."""
    attendants: list[Attendant] = []

    def begin(ring: Path, switch: Path) -> Attendant:
        attendants.append(attend(ring, switch, page=0))
        tab.open(attendants[0].page)
        tab.wait_for("view.answers > 3")
        return attendants[0]

    with Operator((lambda *_: Nobody()) if tab is None else begin) as operator:
        yield operator
    for one in attendants:
        tab.call("Page.navigate", url="about:blank")
        one.process.wait(20)


def measure(seconds: float, blocks: int) -> dict[str, dict[str, float]]:
    """Return the figures of each way, in us."""
    experiment = Experiment.load(EXPERIMENT)
    found: dict[str, list[list[float]]] = {"alone": [], "rows shown": [], "page in a browser": []}
    skip = int(0.5 * experiment.sampled.rate)
    run(experiment, None, 0.2)
    with chromium.browsing() as tab:
        for _ in range(blocks):
            for way, rows in found.items():
                with contextlib.ExitStack() as way_out:
                    operator = None
                    if way != "alone":
                        operator = way_out.enter_context(looked_at(tab if way == "page in a browser" else None))
                    ran = run(experiment, operator, seconds)
                parts = (ran.work[skip:], ran.lateness[skip:])
                rows.append([1e6 * float(np.quantile(part, q)) for part in parts for q in (0.5, 0.99)])
    names = ("work p50", "work p99", "lateness p50", "lateness p99")
    return {way: dict(zip(names, np.median(rows, axis=0).tolist(), strict=True)) for way, rows in found.items()}


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--blocks", type=int, default=5)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        os.environ.setdefault("MASKING_CACHE", cache)
        found = measure(chosen.seconds, chosen.blocks)
    base = found["alone"]
    for way, figures in found.items():
        each = (f"{name} {value:6.1f} us (x {value / base[name]:.2f})" for name, value in figures.items())
        print(f"{way:18} {', '.join(each)}")


if __name__ == "__main__":
    main()
