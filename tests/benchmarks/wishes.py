"""What a new user asks for, by the package and by a controller written by hand: `python -m tests.benchmarks.wishes`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.analysis.masking_error import masking_error
from masking.numerics.sizes import LARGEST
from masking.plants.interface import Settings
from masking.plants.simulated import SimulatedPlant
from masking.records.recording import Recording
from masking.runs.experiment import Experiment
from tests.benchmarks import hand_written as hand
from tests.benchmarks.hand_written import Array, HandWritten, Rig, Virtual


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
    """

    text: str
    name: str
    rig: Rig
    virtual: Callable[[], Virtual]
    ideal: dict[str, object] | None = None
    packaged: str | None = None
    parameters: dict[str, float] | None = None
    short: float = 5.0

    @cached_property
    def experiment(self) -> Experiment:
        """Return the experiment on the imperfect twin, with two samples of delay."""
        made = Experiment.load(self.name, changes=self.parameters)
        if self.name == "two_carts":
            return made.changed(effects={"delay": {"parameters": {"samples": hand.SAMPLES}}})
        return made

    def on_ideal(self, duration: float | None = None) -> float:
        """Return chi on the ideal rig in continuous time."""
        made = Experiment.load(self.packaged) if self.packaged else self.experiment
        if self.packaged is None:
            off = dict.fromkeys(made.assembly.plant.effects, False)
            made = made.changed(controller={"rate": "continuous"}, effects=off, **self.ideal or {})
        return largest(made.changed(duration=duration or made.declaration.duration).run())

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
            force=known.sensors.index("force") if "force" in known.sensors else None,
        )
        return driven(experiment, controller, recording)


PUSH = {"inputs": {"F": "0.5*cos(0.8*t)"}}
WISHES = {
    wish.text: wish
    for wish in (
        Wish("mask the cart alone", "cart_alone_rig", hand.cart_pendulum, lambda: hand.van_der_pol, None, "cart_alone"),
        Wish("Van der Pol", "cart_van_der_pol", hand.cart, lambda: hand.van_der_pol),
        Wish("a one-sided stop", "cart_stop", hand.cart, hand.stop),
        Wish("a bouncing ball", "bouncing_ball_rig", hand.cart, lambda: hand.bouncing_ball, None, "bouncing_ball"),
        Wish("half the inertia, a push is felt", "cart_felt", hand.cart_pendulum, lambda: hand.light_cart, PUSH),
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


def rows() -> Iterator[str]:
    """Yield the lines of a Markdown table."""
    yield "| wish | experiment | chi on the ideal rig | chi on the twin | chi by hand, on the same twin |"
    yield "|---|---|---|---|---|"
    for text, wish in WISHES.items():
        run = wish.run()
        yield f"| {text} | `{wish.name}` | {wish.on_ideal():.1g} | {largest(run):.2g} | {wish.by_hand(run):.2g} |"


def main() -> None:
    """Print the table as it comes."""
    for line in rows():
        print(line, flush=True)


if __name__ == "__main__":
    main()
