"""Cases: what is hidden in a record, drawn from a seed; and which answers are right.

A right answer is the effect and place that was hidden, or one that gives EXACTLY the same readings on this rig, since
its eleven parameters are free and it starts from rest in equilibrium. In the linear rig, with x the static change:

1. A constant force F in spring i needs w_i^2 d_i = -F and leaves x3 alone (mu_i (w_i^2 d_i + F) = 0): a shift of d_i by
   -F/w_i^2, which sensor_offset at s_i gives too. At beam it shifts x3 by -F/w3^2: sensor_offset at s3. An offset u0 of
   V3 is a force -c3 u0 at beam, and one of V1 or V2, which push against the beam, is -c_i u0 in spring i: the same.
2. A linear_spring at spring1, spring2 or beam is a change of w_i with z_i w_i kept, and viscous_damping one of z_i:
   they are right for the family `parameter`, and never hidden themselves. An actuator_gain is a change of c_i, but is
   asked for by its own name.
3. polynomial_spring with k0 alone is constant_force, and with k3 alone hardening_spring: the same law.
4. Dahl's friction is Bouc and Wen's hysteresis with n = 1, beta = 1, zmax = x0, k = fc/x0, since then
   z' = v - |v| z/zmax; and LuGre's with fs = fc, s0 = fc/x0, s1 = s2 = 0. (Not the other way round: LuGre's is hidden
   with fs > fc, and hysteresis with n = 2 and beta = 1/2.)
5. A bilinear_spring is a stop at edge 0 with c = 0.
6. What the dictionary calls by another name is the same: relaxation, displacement_damping.

No twins, though one might think so: a gain of s3 is the inverse gain of s1 and s2 together (c1, c2 and c3 take up the
common factor), and a gain of V3 the inverse gain of V1 and V2 together, each two effects; a lag of all sensors is a lag
of all actuators, as a linear rig passes it on, but one lag alone is a row or a column of the transfer matrix; a
backlash is a linear spring less a spring that saturates at half the gap; a spring at x1-x2 has no reaction on the beam.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tests.benchmarks.hidden.amplitudes import AMPLITUDES, LEVELS
from tests.benchmarks.hidden.catalogue import CHI, EFFECTS, IMPERFECTIONS, OTHERS, PLACED, Entry, Strength, parameters
from tests.benchmarks.hidden.excitation import Signals, commands, signals, training
from tests.benchmarks.hidden.rig import ELEMENTS, PARAMETERS, Array, Damping, declared
from tests.benchmarks.hidden.simulate import Hidden

Family = Literal["effect", "none", "parameter", "two", "outside", "dirty", "dirty_none"]
AnyFamily = Literal[Family, "mujoco"]  # these are drawn here, or made by `tests.benchmarks.mujoco_records`
FAMILIES: tuple[Family, ...] = ("effect", "none", "parameter", "two", "outside", "dirty", "dirty_none")
NOISY = 3e-3  # from this noise on, weak effects are left out
SECONDS = 60.0  # of a training record
AT_ONCE = 16  # excitations
IMPERFECT = 0.004  # chi of all the imperfections of a dirty record together
COUNTS = {"none": 20, "dirty_none": 20, "parameter": 44, "two": 40}
OFF = (0.05, 0.2)  # relative error of the parameter that is off
TIMED = ("actuator_lag", "delay")  # at most one of them in a record

SAME_LAW = {"relaxing_spring": "relaxation", "position_damping": "displacement_damping"}  # by its other name

# Streams of random numbers of a case
RIG, TRAINING, VALIDATION, NOISE, VALIDATION_NOISE, DIRT = range(6)


@dataclass(frozen=True)
class Case:
    """One record to be made: what is hidden in it, how strongly, and what surrounds it.

    `effect`, `at` and `parameters` (SI) are the hidden effect, empty where there is none; a parameter of the rig that
    is off has effect `parameter`, its name as `at`, and `relative`. `second` is the other one of two effects. `noise`
    is the standard deviation of a reading in V, or in parts of its rms in the family `mujoco`. Each parameter of the
    rig is off by at most `base_error`, relatively.
    """

    name: str
    effect: str
    at: str
    parameters: Mapping[str, float]
    strength: Strength | None
    noise: float
    damping: Damping
    base_error: float
    seed: int
    family: AnyFamily = "effect"
    second: Hidden | None = None
    imperfections: tuple[Hidden, ...] = ()

    @property
    def dirty(self) -> bool:
        """Return whether inputs are disturbed and half the variance of the noise is coloured."""
        return self.family in ("dirty", "dirty_none")

    @property
    def asked(self) -> Family:
        """Return the family whose answers are right: an engine's record is judged by what is hidden in it."""
        if self.family != "mujoco":
            return self.family
        return "effect" if self.hidden else "parameter" if self.effect else "none"

    @property
    def hidden(self) -> tuple[Hidden, ...]:
        """Return the hidden effects, without imperfections and errors of the rig's parameters."""
        if self.effect in ("", "parameter"):
            return ()
        first = Hidden(self.effect, self.at, self.parameters)
        return (first,) if self.second is None else (first, self.second)

    def random(self, stream: int) -> np.random.Generator:
        """Return the random numbers of one purpose."""
        return np.random.default_rng([self.seed, stream])


@dataclass(frozen=True)
class Truth:
    """What the generator knows of a case: the eleven parameters, the hidden effects, and unnamed imperfections."""

    rig: Mapping[str, float]
    hidden: tuple[Hidden, ...]
    imperfections: tuple[Hidden, ...]


def rig_of(case: Case, *, off: bool = True) -> Array:
    """Return the eleven parameters (11,) of a case; `off` False leaves out the error of the family `parameter`."""
    values = declared(case.damping)
    values *= 1.0 + case.random(RIG).uniform(-case.base_error, case.base_error, len(values))
    if off and case.effect == "parameter":
        number = PARAMETERS.index(case.at)
        values[number] = declared(case.damping)[number] * (1.0 + case.parameters["relative"])
    return values


def truth(case: Case) -> Truth:
    """Return what a perfect answer would find."""
    return Truth(dict(zip(PARAMETERS, rig_of(case).tolist(), strict=True)), case.hidden, case.imperfections)


def twins(effect: str, at: str) -> set[tuple[str, str]]:
    """Return the effects and places that give exactly the same readings as one hidden effect, itself included."""
    same = {(effect, at)}
    statics = (
        {("constant_force", place), ("sensor_offset", f"s{i}"), ("actuator_offset", f"V{i}")}
        for i, place in enumerate(ELEMENTS, 1)
    )
    for group in statics:
        if same & group:
            same |= group | {("polynomial_spring", place) for name, place in group if name == "constant_force"}
    if effect == "hardening_spring":
        same.add(("polynomial_spring", at))
    if effect == "dahl_friction":
        same |= {("hysteresis", at), ("lugre_friction", at)}
    if effect == "bilinear_spring":
        same.add(("stop", at))
    if effect in SAME_LAW:
        same.add((SAME_LAW[effect], at))
    if effect == "parameter" and at[0] in "wz":
        same.add(({"w": "linear_spring", "z": "viscous_damping"}[at[0]], ELEMENTS[int(at[1]) - 1]))
    return same


def answers(case: Case) -> list[set[tuple[str, str]]]:
    """Return the right answers, one set for each hidden effect, or for the parameter that is off."""
    if case.effect == "parameter":
        return [twins(case.effect, case.at)]
    return [twins(one.effect, one.at) for one in case.hidden]


def acceptable(case: Case) -> set[tuple[str, str]]:
    """Return all (effect, place) that count as right: what was hidden, and what is exactly the same on this rig."""
    return set().union(*answers(case))


KIN: tuple[frozenset[str], ...] = (
    # Coulomb's friction with and without a small dip, and built up over a short way
    frozenset({"dry_friction", "stribeck_friction"}),
    frozenset({"dry_friction", "asymmetric_friction"}),
    frozenset({"dahl_friction", "lugre_friction", "hysteresis"}),
    frozenset({"dry_friction", "dahl_friction"}),
    frozenset({"stribeck_friction", "lugre_friction"}),
    # odd springs: a cubic one, and those whose power series begins with it
    frozenset({"hardening_spring", "polynomial_spring", "gravity_force"}),
    frozenset({"hardening_spring", "polynomial_spring", "saturating_spring"}),
    # a spring that is softer in the middle, or stiffer outside
    frozenset({"backlash", "fading_magnet"}),
    # a stiffness that changes with time, or with a path that grows with time
    frozenset({"stiffness_drift", "softening_with_travel"}),
    # an actuator that gives less for large commands
    frozenset({"saturation", "actuator_cubic"}),
)


def kin(case: Case) -> set[tuple[str, str]]:
    """Return the near kin of what is hidden: laws that are alike but not the same.

    At medium strength, what the eleven parameters leave of the gaps of kin is often alike to 0.97 or more, as a cosine.
    """
    near = {
        (name, one.at) for one in case.hidden for group in KIN if one.effect in group for name in group - {one.effect}
    }
    return near - acceptable(case)


def cases(
    family: Family,
    *,
    noise: float,
    damping: Damping,
    count: int | None = None,
    seed: int = 0,
    base_error: float = 0.01,
    strengths: Sequence[Strength] | None = None,
    seconds: float = SECONDS,
) -> list[Case]:
    """Return cases of a family; `noise` is the standard deviation of a reading in V.

    `seconds` is how long the training records will be: amplitudes follow the levels of their commands and readings.

    Without `count`, families of effects give each effect at each place in each strength once. With it, they give that
    many, drawn at random, but each effect once before any twice. The same arguments give the same cases.
    """
    chosen = tuple(strengths or [one for one in CHI if one != "weak" or noise < NOISY])
    rng = np.random.default_rng([FAMILIES.index(family), seed])
    if family in ("effect", "dirty", "outside"):
        plans = _spread(OTHERS if family == "outside" else EFFECTS, chosen, count, rng)
    elif family == "two":
        stronger: list[Strength] = [one for one in chosen if one != "weak"]
        plans = [_pair(stronger or chosen, rng) for _ in range(COUNTS[family] if count is None else count)]
    else:
        plans = [([], None)] * (COUNTS[family] if count is None else count)
    seeds = rng.integers(1, 2**31, len(plans)).tolist()
    draw = _Draw(family, noise, damping, base_error)
    made: list[Case] = []
    for start in range(0, len(plans), AT_ONCE):
        few = range(start, min(start + AT_ONCE, len(plans)))
        known: list[Signals | None] = [None] * len(few)
        if any(plans[i][0] for i in few) or draw.dirty:
            told = commands(training, seconds, [[seeds[i], TRAINING] for i in few], [damping] * len(few))
            known = list(signals(told, [damping] * len(few)))
        made += [draw.case(i, plans[i], seeds[i], one) for i, one in zip(few, known, strict=True)]
    return made


Plan = tuple[list[str], Strength | None]  # effects as `effect@place`, and their strength


def _spread(
    entries: Sequence[Entry], strengths: Sequence[Strength], count: int | None, rng: np.random.Generator
) -> list[Plan]:
    names = list(dict.fromkeys(entry.effect for entry in entries))
    kinds: dict[str, list[Plan]] = {name: [] for name in names}
    for key, (entry, _) in PLACED.items():
        if entry.effect in kinds:
            kinds[entry.effect] += [([key], strength) for strength in strengths]
    if count is None:
        return [plan for plans in kinds.values() for plan in plans]
    rounds: list[Plan] = []
    queues = {name: [plans[i] for i in rng.permutation(len(plans))] for name, plans in kinds.items()}
    while len(rounds) < count:
        for name in rng.permutation(names).tolist():
            queue = queues[name] or [kinds[name][i] for i in rng.permutation(len(kinds[name]))]
            rounds.append(queue[0])
            queues[name] = queue[1:]
    return rounds[:count]


def _pair(strengths: Sequence[Strength], rng: np.random.Generator) -> Plan:
    keys = [key for key, (entry, _) in PLACED.items() if entry in EFFECTS]
    while True:
        a, b = (keys[i] for i in rng.choice(len(keys), 2, replace=False))
        (one, here), (other, there) = PLACED[a], PLACED[b]
        apart = one.effect != other.effect and here != there
        apart &= not (one.effect in TIMED and other.effect in TIMED)
        if apart and not twins(one.effect, here) & twins(other.effect, there):
            return [a, b], strengths[int(rng.integers(len(strengths)))]


@dataclass(frozen=True)
class _Draw:
    """What the cases of one call have in common."""

    family: Family
    noise: float
    damping: Damping
    base_error: float

    @property
    def dirty(self) -> bool:
        return self.family in ("dirty", "dirty_none")

    def hide(self, key: str, amplitude: float, known: Signals, rng: np.random.Generator) -> Hidden:
        """Return an effect with an amplitude of the table, a random sign and a random phase."""
        entry, place = PLACED[key]
        sign, phase = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.0, 2.0 * np.pi))
        values = parameters(key, amplitude, known, LEVELS[self.damping], sign=sign, phase=phase)
        return Hidden(entry.effect, place, values)

    def table(self, key: str, strength: Strength) -> float:
        """Return an amplitude of the table."""
        return AMPLITUDES[key][0 if self.damping == "own" else 1][list(CHI).index(strength)]

    def case(self, number: int, plan: Plan, seed: int, known: Signals | None) -> Case:
        """Return one case with its own random numbers."""
        rng = np.random.default_rng([seed, 99])
        keys, strength = plan
        hidden: list[Hidden] = []
        imperfections: tuple[Hidden, ...] = ()
        if known is not None and strength is not None:
            hidden = [self.hide(key, self.table(key, strength), known, rng) for key in keys]
        if known is not None and self.dirty:
            imperfections = self.imperfections(hidden, known, rng)
        effect, at, values = "", "", dict[str, float]()
        if self.family == "parameter":
            effect, at = "parameter", PARAMETERS[number % len(PARAMETERS)]
            size = float(rng.uniform(*OFF))
            values = {"relative": float(rng.choice([-1.0, 1.0])) * size}
            strength = "weak" if size < 0.08 else "medium" if size < 0.14 else "strong"
        elif hidden:
            effect, at, values = hidden[0].effect, hidden[0].at, dict(hidden[0].parameters)
        what = "+".join(f"{one.effect}@{one.at}" for one in hidden) or (f"parameter@{at}" if effect else "")
        parts = (self.family, what, strength or "", self.damping, f"{self.noise:g}", str(seed))
        return Case(
            name="/".join(part for part in parts if part),
            effect=effect,
            at=at,
            parameters=values,
            strength=strength,
            noise=self.noise,
            damping=self.damping,
            base_error=self.base_error,
            seed=seed,
            family=self.family,
            second=hidden[1] if len(hidden) == 2 else None,
            imperfections=imperfections,
        )

    def imperfections(self, hidden: Sequence[Hidden], known: Signals, rng: np.random.Generator) -> tuple[Hidden, ...]:
        """Return small effects at random places, each worth the same chi, together about `IMPERFECT`."""
        taken = {(one.effect, one.at) for one in hidden}
        size = IMPERFECT / np.sqrt(len(IMPERFECTIONS)) / CHI["weak"]
        drawn = []
        for name in IMPERFECTIONS:
            keys = [k for k, (entry, place) in PLACED.items() if entry.effect == name and (name, place) not in taken]
            key = keys[int(rng.integers(len(keys)))]
            drawn.append(self.hide(key, float(size) * self.table(key, "weak"), known, rng))
        return tuple(drawn)
