"""What a new user asks for, by the package and by a controller written by hand: `python -m tests.benchmarks.wishes`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from masking.analysis.masking_error import masking_error
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment
from tests.benchmarks import hand_written as hand
from tests.benchmarks.hand_written import Array, HandWritten, Rig, Virtual
from tests.support.compiled_unit import GCC, CompiledUnit

GAPS = np.linspace(0.0, 3.0, 50)  # mm, of examples/scripts/14_sweep.py, with its drive, damping and duration
DRIVE, DAMPING, SWEPT, AFTER = 18.5, 0.1, 40.0, 25.0  # rad/s, 1, s, s
REGULAR = 3  # a motion repeats after fewer periods of the drive


def largest(recording: Recording) -> float:
    """Return chi of the worst coordinate of a run."""
    return float(max(recording.manifest["masking_error"].values()))


def driven(experiment: Experiment, controller: Callable[[Array], Array], ideal: Recording) -> float:
    """Return chi of the worst coordinate with a controller in a loop of one's own around the twin.

    Args:
        experiment: at a rate, recorded at every sample.
        controller: commands from readings; its first sample is that at which the rig rests.
        ideal: a run of the experiment, with the ideal motion.
    """
    made, plant = experiment.sampled, SimulatedPlant(experiment.twin, experiment.declaration.seed)
    plant.configure(Settings(made.rate))
    plant.activate()
    states = []
    for index in range(-made.before, len(ideal.t)):
        sample = plant.read()
        if index >= 0:
            known = plant.telemetry()
            states.append([known[name] for name in experiment.twin.state_names])
        plant.write(sample.index, controller(sample.values))
    plant.deactivate()
    names, found = list(experiment.twin.state_names), np.array(states)
    chi = []
    for name in experiment.virtual.coordinates:
        # Coordinates of the rig in the units of the virtual system: a factor, where both names stand for one length.
        own = name if name in names else {"x1": "a_x", "x2": "b_x"}[name]
        unit = np.dot(ideal[f"rig.{own}"], ideal[f"virtual.{name}"]) / np.dot(ideal[f"rig.{own}"], ideal[f"rig.{own}"])
        chi.append(masking_error(unit * found[:, names.index(own)], ideal[f"ideal.{name}"]))
    return max(chi)


@dataclass(frozen=True)
class Wish:
    """One wish.

    Args:
        text: what is asked for.
        name: the packaged experiment at 500 Hz.
        rig: the nominal model, by hand.
        virtual: makes the virtual system, by hand.
        ideal: sections that make it the ideal rig in continuous time, beside the controller and effects.
        packaged: the packaged experiment in continuous time, where there is one.
        parameters: values of the virtual system.
        short: duration in a test.
        force: the sensor of a force that the controller by hand reads, where there is one.
    """

    text: str
    name: str
    rig: Rig
    virtual: Callable[[], Virtual]
    ideal: dict[str, object] | None = None
    packaged: str | None = None
    parameters: dict[str, float] | None = None
    short: float = 5.0
    force: str = "force"

    @cached_property
    def experiment(self) -> Experiment:
        """Return the experiment on the imperfect twin, with two samples of delay."""
        made = Experiment.load(self.name, changes=self.parameters)
        if self.name == "two_carts":
            return made.changed(effects={"delay": {"parameters": {"samples": hand.SAMPLES}}})
        return made

    @cached_property
    def exact(self) -> Experiment:
        """Return the experiment on the ideal rig in continuous time."""
        if self.packaged:
            return Experiment.load(self.packaged)
        off = dict.fromkeys(self.experiment.assembly.plant.effects, False)
        return self.experiment.changed(controller={"rate": "continuous"}, effects=off, **self.ideal or {})

    def on_ideal(self, duration: float | None = None) -> float:
        """Return chi on the ideal rig in continuous time."""
        return largest(self.exact.changed(duration=duration or self.exact.declaration.duration).run())

    def run(self, duration: float | None = None) -> Recording:
        """Return the run on the imperfect twin."""
        return self.experiment.changed(duration=duration or self.experiment.declaration.duration).run()

    def by_hand(self, recording: Recording) -> float:
        """Return chi with the controller written by hand.

        Args:
            recording: the run on the imperfect twin, which has the ideal motion.
        """
        experiment, settings = self.experiment, self.experiment.declaration.controller
        known, m = experiment.instruments, len(experiment.virtual.coordinates)
        rest, homing = (round((seconds or 0.0) * hand.RATE) for seconds in (settings.rest, settings.homing))
        positions = np.linalg.pinv(known.sensing()[:, : len(experiment.plant.coordinates)])
        start = experiment.rig_start(experiment.sampled)[:m]
        controller = HandWritten(
            rig=self.rig,
            virtual=self.virtual(),
            start=start,
            positions=positions,
            largest=known.limits()[:, LARGEST],
            rest=rest,
            homing=homing,
            force=known.sensors.index(self.force) if self.force in known.sensors else None,
        )
        return driven(experiment, controller, recording)


UNSENSED = "the same, without a force sensor"
PUSH = {"inputs": {"F": "0.5*cos(0.8*t)"}}
WISHES = {
    wish.text: wish
    for wish in (
        Wish("mask the cart alone", "cart_alone_rig", hand.cart_pendulum, lambda: hand.van_der_pol, None, "cart_alone"),
        Wish("Van der Pol", "cart_van_der_pol", hand.cart, lambda: hand.van_der_pol),
        Wish("a one-sided stop", "cart_stop", hand.cart, hand.stop),
        Wish("a bouncing ball", "bouncing_ball_rig", hand.cart, lambda: hand.bouncing_ball, None, "bouncing_ball"),
        Wish("half the inertia, a push is felt", "cart_felt", hand.cart_pendulum, lambda: hand.light_cart, PUSH),
        Wish(
            UNSENSED,
            "cart_felt_observer",
            hand.cart_pendulum,
            lambda: hand.light_cart,
            PUSH,
            force="none",
        ),
        Wish("Bouc-Wen springs", "bouc_wen_rig", hand.setup, hand.bouc_wen, None, "bouc_wen", short=40),
        Wish("clocks with escapements", "escapements_rig", hand.setup, hand.clocks, None, "escapements", short=40),
        Wish(
            "delayed oscillators",
            "delayed_oscillators_rig",
            hand.setup,
            hand.delayed,
            None,
            "delayed_oscillators",
            short=40,
        ),
        Wish("internal state, sine, force from a file", "cart_reference", hand.cart, hand.relaxing),
        Wish("realistic sensors", "cart_sensors", hand.cart, lambda: hand.van_der_pol),
        Wish("two carts with a virtual spring", "two_carts", hand.cart, lambda: hand.two_masses),
    )
}


def pushed(t: Array) -> Array:
    """Return the motion (m,) of the cart of half the inertia under the force with which the hand pushes the rig."""
    made = solve_ivp(
        lambda t, y: [y[1], float(hand.light_cart(t, y[:1], y[1:], 0.5 * np.sin(1.6 * np.pi * t))[0])],
        *((0.0, t[-1]), [0.0, 0.0], "DOP853", t),
        rtol=1e-9,
        atol=1e-12,
    )
    return np.asarray(made.y[0])


def against_the_hand(wish: Wish) -> tuple[float, float]:
    """Return chi against the motion under the true force of the hand, by the package and by hand."""
    run = wish.run()
    columns = {name: run[name] for name in run.names()} | {"ideal.x": pushed(run.t)}
    return masking_error(run["virtual.x"], columns["ideal.x"]), wish.by_hand(Recording(columns, run.manifest))


def sweep(gaps: Array = GAPS) -> Array:
    """Return chi on the ideal rig, on the twin and by hand, at the gaps where the ideal motion is regular (gaps, 3)."""
    base, found = WISHES["a one-sided stop"], []
    strobe = 2 * np.pi / DRIVE * np.arange(np.ceil(AFTER * DRIVE / (2 * np.pi)), SWEPT * DRIVE / (2 * np.pi))
    for gap in gaps:
        values = {"Om": DRIVE, "z": DAMPING, "edge": float(gap)}
        wish = replace(base, parameters=values, virtual=lambda: hand.stop(DRIVE, DAMPING, 1e-3 * float(gap)))  # noqa: B023  # called below
        run = wish.run(SWEPT)
        once = 1e3 * np.interp(strobe, run.t, run["ideal.x"])
        if len(np.unique(np.round(once, 1))) < REGULAR:
            found.append((wish.on_ideal(SWEPT), largest(run), wish.by_hand(run)))
    return np.array(found)


def on_ideal_driven(experiment: Experiment, law: Callable[[float, Array], Array]) -> float:
    """Return chi of the cart as it moves by itself with a law in a loop of one's own, in continuous time.

    Args:
        experiment: of one cart, in continuous time.
        law: the current (1,) at a time in s and a state [x, v], SI units.
    """

    def slope(t: float, y: Array) -> Array:
        free, gain = hand.cart(y[:1], y[1:], 0.0)
        return np.append(y[1:], free + gain @ law(t, y))

    run = experiment.run()
    start = [run["rig.x"][0], 0.0]
    moved = solve_ivp(slope, (0.0, run.t[-1]), start, "DOP853", run.t, rtol=1e-10, atol=1e-14).y[0]
    unit = np.dot(run["rig.x"], run["virtual.x"]) / np.dot(run["rig.x"], run["rig.x"])
    return masking_error(unit * moved, run["ideal.x"])


def own_loop(wish: Wish) -> tuple[float, float]:
    """Return chi on the ideal rig and on the twin, with the controller in a loop of one's own."""
    law: Callable[[float, Array], Array] = wish.exact.controller()
    return on_ideal_driven(wish.exact, law), driven(wish.experiment, wish.experiment.controller(), wish.run())


def in_c(wish: Wish, folder: Path) -> tuple[float, float]:
    """Return chi on the ideal rig and on the twin, with the exported controller in a loop of one's own."""
    law = CompiledUnit(folder, law_unit(wish.exact.loop, "law", None))
    law.init()
    unit = CompiledUnit(folder, sampled_unit(wish.experiment.sampled, "controller", 0.02))
    rests = True

    def controller(readings: Array) -> Array:
        nonlocal rests
        if rests:
            unit.init(readings)
        rests = False
        return np.array(unit.step(readings))

    return on_ideal_driven(wish.exact, law.step), driven(wish.experiment, controller, wish.run())


def rows() -> Iterator[str]:
    """Yield the lines of a Markdown table."""
    yield "| wish | experiment | chi on the ideal rig | chi on the twin | chi by hand, on the same twin |"
    yield "|---|---|---|---|---|"
    for text, wish in WISHES.items():
        run = wish.run()
        yield f"| {text} | `{wish.name}` | {wish.on_ideal():.1g} | {largest(run):.2g} | {wish.by_hand(run):.2g} |"
        if text == UNSENSED:
            what, (ours, theirs) = "the same, against the motion under the true force", against_the_hand(wish)
            yield f"| {what} | `{wish.name}` | | {ours:.2g} | {theirs:.2g} |"
    swept = sweep()
    for text, found in (("worst", swept.max(axis=0)), ("median", np.median(swept, axis=0))):
        ideal, ours, theirs = found
        what = f"sweep of {len(GAPS)}, {text} of the {len(swept)} gaps with regular motion"
        yield f"| {what} | `cart_stop` | {ideal:.1g} | {ours:.2g} | {theirs:.2g} |"
    wish = WISHES["Van der Pol"]
    by_hand = wish.by_hand(wish.run())
    with tempfile.TemporaryDirectory() as folder:
        held = {"own loop, in Python": own_loop(wish)}
        if GCC is not None:
            held["own loop, the exported C"] = in_c(wish, Path(folder))
    for text, (ideal, ours) in held.items():
        yield f"| {text} | `{wish.name}` | {ideal:.1g} | {ours:.2g} | {by_hand:.2g} |"


def main() -> None:
    """Print the table as it comes."""
    for line in rows():
        print(line, flush=True)


if __name__ == "__main__":
    main()
