"""What a tick of a rig takes: controller, safety chain and row, alone and with page, recording and key, in turns.

`huygens_rig` runs on its twin in another process over UDP: in lockstep, where nothing sleeps, and in real time at
1 kHz. `work` is the controller, the safety chain and the row of a tick, as `rig.timing` of a record has it; `tick` is
the time from one sample to the next, in lockstep with the twin, the socket and the tags of frames in it.
"""

from __future__ import annotations

import contextlib
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.stepwise_controller import SampledStep
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Sample, Settings
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.udp import UdpPlant
from masking.lab.runs import rig_run, safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.loop_rows import known, recorder
from masking.lab.runs.operator_link import Operator
from masking.lab.runs.realtime import Hooks, run_rig
from tests.benchmarks.operator_page import EXPERIMENT, Nobody, looked_at
from tests.benchmarks.table import Row, few, limited, told
from tests.support import chromium

TICKS, ROUNDS = 20_000, 5
PLANT: Final = "tue_rig"
AIMS: Final = {"p50": 10.0, "p99": 50.0}  # us
ALONE, ALL = "alone", "with page, recording and key"
REAL_TURNS: Final = 3


def rows() -> Iterator[Row]:
    """Measure both ways in turns, then the parts."""
    found = measure(few(ROUNDS))
    spread = ", ".join(f"{way}: {min(each):.1f} to {max(each):.1f} us" for way, each in found["work p99"].items())
    for name, aim in AIMS.items():
        ours, theirs = (statistics.median(found[f"work {name}"][way]) for way in (ALL, ALONE))
        what = f"controller, safety chain and row, {name}: {ALL} / {ALONE}"
        yield limited(what, f"{ours:.1f} us", f"{theirs:.1f} us", ours, at_most=aim, unit="us")
    for name in ("work p50", "work p99", "tick p50", "tick p99"):
        ours, theirs = (statistics.median(found[name][way]) for way in (ALL, ALONE))
        note = f"medians of {ROUNDS} turns of {TICKS} ticks; p99 of single turns {spread}" if name == "work p99" else ""
        yield told(f"{name}: {ALL} / {ALONE}", f"{ours:.1f} us", f"{theirs:.1f} us", ours / theirs, note)
    real = measure(few(REAL_TURNS), lockstep=False)
    for name, each in real.items():
        ours, theirs = (statistics.median(each[way]) for way in (ALL, ALONE))
        spread = ", ".join(f"{way}: {min(turns):.1f} to {max(turns):.1f} us" for way, turns in each.items())
        yield told(f"at 1 kHz, {name}: {ALL} / {ALONE}", f"{ours:.1f} us", f"{theirs:.1f} us", ours / theirs, spread)
    for part, times in parts().items():
        p50, p99 = np.quantile(times, [0.5, 0.99])
        yield told(f"{part} in a tick, p50", f"{p50:.2f} us", note=f"p99 {p99:.2f} us, worst {times.max():.0f} us")


def measure(rounds: int = ROUNDS, *, lockstep: bool = True) -> dict[str, dict[str, list[float]]]:
    """Return each figure in us, by the way, of each turn, in lockstep or in real time."""
    experiment, found, clock = _experiment(), {}, ["--lockstep"] * lockstep
    with contextlib.ExitStack() as way_out:
        folder = Path(way_out.enter_context(tempfile.TemporaryDirectory()))
        (folder / "key").write_bytes(b"a key for the benchmark, of 32 bytes or more")
        (folder / "key").chmod(0o600)
        key, tab = Key.read(folder / "key"), way_out.enter_context(chromium.browsing())
        plain, keyed = (way_out.enter_context(_serving(*clock, *more)) for more in ((), ("--key", folder / "key")))
        for turn in range(-1, rounds):
            for way, plant in ((ALONE, UdpPlant(plain)), (ALL, UdpPlant(keyed, key=key))):
                with contextlib.ExitStack() as inner:
                    more: dict[str, Any] = {}
                    if way == ALL:
                        more = {"operator": inner.enter_context(looked_at(tab)), "stream": folder / f"run {turn}"}
                    noted = _Noting(plant)
                    record = rig_run.run(
                        experiment, noted, rig_run.RunSettings(lockstep=lockstep, acknowledge=True, **more)
                    )
                work, ticks = record.manifest["rig"]["timing"]["work"], np.diff(noted.instants)
                each = {"work p50": work["median"], "work p99": work["p99"]}
                each |= {f"tick p{n}": float(np.quantile(ticks, n / 100)) for n in (50, 99)}
                for name, value in each.items() if turn >= 0 else ():  # the first turn loads and compiles
                    found.setdefault(name, {ALONE: [], ALL: []})[way].append(1e6 * value)
    return found


def parts() -> dict[str, Array]:
    """Return what the parts of a tick take in us, in a loop on a twin in this process (ticks,)."""
    experiment = _experiment()
    sampled, twin = experiment.sampled, experiment.twin
    controller = SampledStep(sampled)
    rules = safety_limits.rules(experiment.instruments, sampled.rate, twin, controller.estimate)
    taken: dict[str, list[float]] = {"controller": [], "recording": [], "look for a stop": [], "page": []}

    def timed(part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any) -> Any:
            begin = time.perf_counter()
            answer = call(*given)
            taken[part].append(time.perf_counter() - begin)
            return answer

        return called

    with tempfile.TemporaryDirectory() as folder, Operator(lambda *_: Nobody()) as operator:
        operator.begin(experiment, controller, rules)
        streamed = recorder(experiment, Path(folder) / "run", Path(folder))
        record, show = timed("recording", streamed.ring.put), timed("page", operator.put or print)
        ran = run_rig(
            timed("controller", lambda tick, readings: controller(readings, tick - sampled.before)),
            SimulatedPlant(twin),
            Settings(sampled.rate, lockstep=True),
            samples=TICKS,
            limits=rules,
            hooks=Hooks(on_row=[record, show], look=timed("look for a stop", operator.look)),
            known=known(controller, sampled.feed.lasting(controller.parameters)),
        )
        streamed.discard()
    found = {part: np.array(times) for part, times in taken.items()}
    found["safety chain and row"] = ran.work - sum(found.values())
    return {part: 1e6 * times for part, times in found.items()}


def _experiment() -> Experiment:
    loaded = Experiment.load(EXPERIMENT)
    seconds = (TICKS - loaded.sampled.before) / loaded.sampled.rate
    return loaded.changed(duration=seconds / loaded.time_scale)


@contextlib.contextmanager
def _serving(*options: object) -> Iterator[str]:
    """Serve the twin in a process of its own, and give its address."""
    command = [sys.executable, "-m", "masking", "rig", "serve", PLANT, "--address", "udp://127.0.0.1:0"]
    with subprocess.Popen([*command, *map(str, options)], stderr=subprocess.PIPE, text=True) as process:
        try:
            said = process.stderr.readline() if process.stderr is not None else ""
            yield said.split()[-1]
        finally:
            process.terminate()


class _Noting:
    """A plant that notes when samples came."""

    owns_clock = True

    def __init__(self, plant: UdpPlant) -> None:
        self.plant, self.instants = plant, list[float]()
        self.activate, self.write, self.deactivate = plant.activate, plant.write, plant.deactivate
        self.counters, self.sensors, self.actuators = plant.counters, plant.sensors, plant.actuators

    def configure(self, settings: Settings) -> None:
        self.plant.configure(settings)
        self.sensors, self.actuators = self.plant.sensors, self.plant.actuators

    def read(self) -> Sample:
        sample = self.plant.read()
        self.instants.append(time.perf_counter())
        return sample
