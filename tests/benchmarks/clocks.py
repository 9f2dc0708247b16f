"""Huygens' clocks on the imperfect rig, over seeds: `python -m tests.benchmarks.clocks [SEEDS] [--picture FILE]`.

The packaged experiment `huygens_rig` as it is, and with errors of the rig that its controller is not given. Two figures
at 500 and 2000 units of time, each over the last 10: the amplitude of th1 over that of the ideal clocks, and
|th1 + th2| over the amplitude.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np

from masking.control.rig.twin import Twin
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment
from masking.model.declaration.expression import Expression

SEEDS: Final = 20
TIMES: Final = (500.0, 2000.0)
WINDOW: Final = 10.0
_GIVEN: Final = {"noise": {"sigma": 1e-4}, "delay": {"samples": 1}}


def _twice(name: str) -> dict[str, str]:
    given = Twin.load("tue_rig").declaration.effects[name].parameters["fc"]
    return {"fc": f"2*({given.text if isinstance(given, Expression) else given})"}


def errors() -> dict[str, dict[str, Any]]:
    """Return the changes of the rig's effects by what they are called."""
    gains = {"strong_gain": 0.06, "weak_gain": -0.06}
    return {
        "as it is": {},
        "offsets x 4": {"offset": {"e0": 0.002}},
        "noise x 10": {"noise": {"sigma": 1e-3}},
        "2 samples of delay": {"delay": {"samples": 2}},
        "gains 6 % off": {name: {"enabled": True, "parameters": {"e": e}} for name, e in gains.items()},
        "friction x 2": {f"friction{i}": _twice(f"friction{i}") for i in (1, 2, 3)},
    }


def clocks(effects: Mapping[str, Any], seed: int, duration: float = TIMES[-1], **settings: object) -> Recording:
    """Run the packaged experiment on a rig with other effects, which its controller is not given.

    Args:
        effects: changes of the rig's effects.
        seed: of the noise.
        duration: in virtual time.
        settings: of the controller, in place of those of the file.
    """
    base = Experiment.load("huygens_rig")
    controller = {**base.declaration.controller.model_dump(mode="json", exclude_defaults=True), "effects": _GIVEN}
    changed = {"effects": dict(effects), "seed": seed, "duration": duration, "record": {"rate": "200 Hz"}}
    return base.changed(controller={**controller, **settings}, **changed).run()


def figures(run: Recording, at: float, window: float = WINDOW) -> tuple[float, float]:
    """Return amplitude over the ideal one, and |th1 + th2| over the amplitude, in the units of time before one."""
    tau = run.t / run.manifest["time_scale"]
    last = (tau > at - window) & (tau <= at)
    th1, th2, ideal = (run[name][last] for name in ("virtual.th1", "virtual.th2", "ideal.th1"))
    amplitude = float(np.abs(th1).max())
    return amplitude / float(np.abs(ideal).max()), float(np.abs(th1 + th2).max()) / amplitude


def chi(run: Recording, at: float) -> float:
    """Return the masking error of the worse clock up to a time."""
    part = run.t / run.manifest["time_scale"] <= at
    pairs = [(run[f"virtual.{name}"][part], run[f"ideal.{name}"][part]) for name in ("th1", "th2")]
    return max(float(np.linalg.norm(ours - ideal) / np.linalg.norm(ideal)) for ours, ideal in pairs)


def rows(seeds: int) -> Iterator[str]:
    """Give the lines of a Markdown table: mean and largest deviation of the amplitude, and the largest sum."""
    yield "| the rig has | amplitude, 500 | amplitude, 2000 | sum, 500 | sum, 2000 |"
    yield "|---|---|---|---|---|"
    for name, effects in errors().items():
        runs = [clocks(effects, seed) for seed in range(seeds)]
        found = np.array([[figures(run, at) for at in TIMES] for run in runs])  # (seeds, times, 2)
        low, high = found[..., 0].min(axis=0), found[..., 0].max(axis=0)
        amplitudes = [f"{a:.3f} ... {b:.3f}" for a, b in zip(low, high, strict=True)]
        sums = [f"{worst:.3f}" for worst in found[..., 1].max(axis=0)]
        yield f"| {name} | {' | '.join([*amplitudes, *sums])} |"


def draw(path: str, seeds: int) -> None:
    """Draw the amplitude over the ideal one against time, with and without the energy balance."""
    figure, axis = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    times = np.arange(100.0, TIMES[-1] + 1.0, 20.0)
    for colour, name, settings in (("C3", "observer alone", {"energy_balance": None}), ("C0", "energy balance", {})):
        for seed in range(seeds):
            run = clocks({}, seed, **settings)
            label = name if seed == 0 else None
            axis.plot(times, [figures(run, at)[0] for at in times], color=colour, lw=0.8, alpha=0.7, label=label)
    axis.axhspan(0.95, 1.05, color="0.9", zorder=0, label="5 %")
    axis.set(xlabel="virtual time", ylabel="amplitude / ideal amplitude", xlim=(times[0], times[-1]))
    axis.legend(frameon=False)
    figure.savefig(path, dpi=160)


def main() -> None:
    """Print the table as it comes, and draw the picture if one is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", type=int, default=SEEDS)
    parser.add_argument("--picture", help="file to draw amplitudes over time into, for five seeds")
    given = parser.parse_args()
    if given.picture:
        draw(given.picture, 5)
        return
    for row in rows(given.seeds):
        print(row, flush=True)


if __name__ == "__main__":
    main()
