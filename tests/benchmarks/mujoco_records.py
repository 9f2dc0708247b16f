"""Records of the rig made by MuJoCo, an engine that nobody here wrote, with effects hidden in its own terms.

The beam slides on the ground and both oscillators slide on the beam: the joints `spring1`, `spring2` and `beam` have
d1, d2 and x3 as coordinates, and what MuJoCo does in a joint it does between its two bodies, as an element of the model
does. The beam weighs 1 kg, oscillator i weighs mu_i; only ratios matter. A command pushes an oscillator and the beam,
or the beam alone: an actuator on a fixed tendon with the coefficient m_i c_i at the joint of oscillator i, or c3 at
that of the beam. The classical method of Runge and Kutta at 0.1 ms gives the linear rig within 1e-11 of its rms.

What is hidden is an attribute of a joint, an actuator or a tendon. Its law in the names of `hidden.laws`, and how near
MuJoCo is to it, in parts of the readings:

* joint `frictionloss`: dry_friction with a sign instead of tanh(v/vs). MuJoCo makes it of a constraint that stops the
  motion within `solreffriction` = 0.2 ms, its shortest time at this step, and gives way at the limit: within 1e-4.
* joint `range`: stop. A limit is a constraint too, and makes the acceleration (1 - d) a0 - K r for an impedance d and
  an excess r. With the smallest d, 1e-4, it is a spring: K = stiffness / mass felt in the joint.
* joint `stiffness` and `damping`: k d + k2 d^2 + k3 d^3 and c v + c2 v |v|. Actuator `ctrlrange`, `gear`, `dyntype` and
  `delay`: saturation, actuator_gain, actuator_lag, delay. Tendon `springlength`: backlash. `dcmotor` without motor:
  lugre_friction. A change of `stiffness` by 8 % keeps the damping, so it is a linear spring: w is off and z w is not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata

import numpy as np

from tests.benchmarks.hidden.cases import FAMILIES, NOISE, TRAINING, VALIDATION, VALIDATION_NOISE, Case, rig_of
from tests.benchmarks.hidden.excitation import commands, training, validation
from tests.benchmarks.hidden.generate import Record
from tests.benchmarks.hidden.rig import ACTUATORS, ELEMENTS, PARAMETERS, RATE, SENSOR_GAIN, Array, Damping

STEP = 1e-4  # s
FAR = 1.0  # m: an end that is never reached
SOFT = 1e-4  # the least impedance of a constraint
HARD = 0.9999  # the largest

Values = Mapping[str, float]

HIDDEN: tuple[tuple[str, str, Values], ...] = (
    ("dry_friction", "spring1", {"fc": 0.0055}),
    ("parameter", "w3", {"relative": 1.08**0.5 - 1.0}),
    ("", "", {}),
    ("dry_friction", "spring2", {"fc": 0.0065}),
    ("dry_friction", "beam", {"fc": 7.5e-4}),
    ("parameter", "w1", {"relative": 1.08**0.5 - 1.0}),
    ("parameter", "z2", {"relative": 0.3}),
    ("parameter", "z3", {"relative": 0.3}),
    ("saturation", "V1", {"limit": 0.008}),
    ("saturation", "V3", {"limit": 0.07}),
    ("stop", "spring1", {"k": 200.0, "edge": 2e-3, "c": 0.0, "side": 1.0}),
    ("stop", "beam", {"k": 50.0, "edge": -2e-3, "c": 0.0, "side": -1.0}),
    ("hardening_spring", "spring2", {"k3": 2e6}),
    ("polynomial_spring", "beam", {"k2": 1100.0}),
    ("quadratic_damping", "spring1", {"c": 19.0}),
    ("lugre_friction", "beam", {"fc": 6e-4, "fs": 9e-4, "vst": 1e-2, "s0": 12.0, "s1": 0.06, "s2": 0.0}),
    ("backlash", "spring1", {"k": 5.4, "gap": 1e-3}),
    ("linear_spring", "x1-x2", {"k": 4.5}),
    ("actuator_gain", "V2", {"e": 0.05}),
    ("actuator_lag", "V3", {"tau": 3.3e-3}),
    ("delay", "actuators", {"seconds": 3e-3 - STEP / 6.0}),
    ("", "", {}),
)


def version() -> str:
    """Return the version of MuJoCo that is installed, or nothing."""
    try:
        return metadata.version("mujoco-core")
    except metadata.PackageNotFoundError:
        return ""


def cases(count: int | None = None, *, noise: float = 1e-3, damping: Damping = "own", seed: int = 0) -> list[Case]:
    """Return all cases, or the first `count`; `noise` is in parts of the rms of each reading."""
    seeds = np.random.default_rng([len(FAMILIES), seed]).integers(1, 2**31, len(HIDDEN)).tolist()
    found = []
    for (effect, at, values), own in list(zip(HIDDEN, seeds, strict=True))[:count]:
        parts = ("mujoco", f"{effect}@{at}" if effect else "", damping, f"{noise:g}", str(own))
        name = "/".join(part for part in parts if part)
        found.append(Case(name, effect, at, values, None, noise, damping, 0.01, own, "mujoco"))
    return found


def generate(
    cases: Sequence[Case], seconds: float = 60.0, validation_seconds: float = 60.0
) -> Iterator[tuple[Case, Record, Record]]:
    """Give each case with a record for training and one for validation, in V and s, from rest."""
    for case in cases:
        records = [
            recorded(case, commands(shapes, span, [[case.seed, stream]], [case.damping])[:, :, 0], noise)
            for shapes, span, stream, noise in (
                (training, seconds, TRAINING, NOISE),
                (validation, validation_seconds, VALIDATION, VALIDATION_NOISE),
            )
        ]
        yield case, records[0], records[1]


def recorded(case: Case, told: Array, stream: int) -> Record:
    """Return the record of commands (samples, 3) in V."""
    readings = SENSOR_GAIN * motion(mjcf(case), told)
    size = case.noise * np.sqrt((readings**2).mean(axis=0))
    readings += size * case.random(stream).standard_normal(readings.shape)
    return Record(np.arange(len(told)) / RATE, told, readings)


def motion(model: str, told: Array) -> Array:
    """Return d1, d2 and x3 (samples, 3) in m of a model in MJCF under commands (samples, 3) in V, from rest."""
    import mujoco

    rig = mujoco.MjModel.from_xml_string(model)
    state, steps = mujoco.MjData(rig), round(1.0 / (RATE * rig.opt.timestep))
    where = [rig.joint(name).qposadr[0] for name in ELEMENTS]
    seen = np.empty((len(told), len(where)))
    for k, now in enumerate(told):
        seen[k] = state.qpos[where]
        state.ctrl[: len(now)] = now
        mujoco.mj_step(rig, state, steps)
    return seen


Attributes = dict[str, str]


@dataclass
class Mechanism:
    """The parts of the model in MJCF, to be changed by what is hidden: attributes of joints and actuators, by name.

    `masses` of the bodies that the joints move, `felt`: of the two bodies of a joint against each other, in kg.
    """

    masses: Mapping[str, float]
    felt: Mapping[str, float]
    joints: dict[str, Attributes]
    actuators: dict[str, Attributes] = field(default_factory=lambda: {name: {} for name in ACTUATORS})
    tendons: list[str] = field(default_factory=list)
    motors: list[str] = field(default_factory=list)


def _friction(rig: Mechanism, at: str, p: Values) -> None:
    stiff = {"solreffriction": f"{2.0 * STEP} 1", "solimpfriction": f"{HARD} {HARD} 1"}
    rig.joints[at] |= {"frictionloss": _number(rig.masses[at] * p["fc"]), **stiff}


def _stop(rig: Mechanism, at: str, p: Values) -> None:
    ends = (-FAR, p["edge"]) if p["side"] > 0.0 else (p["edge"], FAR)
    spring = p["k"] * rig.masses[at] / rig.felt[at]
    soft = {"solreflimit": f"{_number(-spring)} -1e-12", "solimplimit": f"{SOFT} {SOFT} 1"}
    rig.joints[at] |= {"range": _number(*ends), **soft}


def _spring(rig: Mechanism, at: str, p: Values) -> None:
    rig.joints[at]["stiffness"] += " " + _number(*(rig.masses[at] * p.get(name, 0.0) for name in ("k2", "k3")))


def _drag(rig: Mechanism, at: str, p: Values) -> None:
    rig.joints[at]["damping"] += " " + _number(rig.masses[at] * p["c"])


def _lugre(rig: Mechanism, at: str, p: Values) -> None:
    bristles = _number(*(rig.masses[at] * p[name] for name in ("s0", "s1", "fc", "fs")), p["vst"])
    rig.motors.append(f'<dcmotor joint="{at}" input="none" motorconst="0" resistance="1" lugre="{bristles}"/>')


def _play(rig: Mechanism, at: str, p: Values) -> None:
    spring = {"stiffness": _number(rig.masses[at] * p["k"]), "springlength": _number(-p["gap"] / 2.0, p["gap"] / 2.0)}
    rig.tendons.append(_tendon({at: 1.0}, spring))


def _between(rig: Mechanism, at: str, p: Values) -> None:
    """Add a spring between both oscillators: d1 - d2 = x1 - x2."""
    assert at == "x1-x2"
    ends = {"spring1": 1.0, "spring2": -1.0}
    rig.tendons.append(_tendon(ends, {"stiffness": _number(rig.masses["spring1"] * p["k"])}))


def _limit(rig: Mechanism, at: str, p: Values) -> None:
    rig.actuators[at]["ctrlrange"] = _number(-p["limit"], p["limit"])


def _gain(rig: Mechanism, at: str, p: Values) -> None:
    rig.actuators[at]["gear"] = _number(1.0 + p["e"])


def _lag(rig: Mechanism, at: str, p: Values) -> None:
    rig.actuators[at] |= {"dyntype": "filter", "dynprm": _number(p["tau"])}


def _late(rig: Mechanism, at: str, p: Values) -> None:
    """Delay all actuators by whole steps, less the sixth of a step that the last stage of a step gives away.

    A quarter of a step keeps what a stage reads off the instants at which commands change, where rounding would tell.
    """
    steps = round(p["seconds"] / STEP)
    for actuator in rig.actuators.values():
        actuator |= {"delay": _number((steps - 0.25) * STEP), "nsample": str(steps + 1)}


HIDE: dict[str, Callable[[Mechanism, str, Values], None]] = {
    "dry_friction": _friction,
    "stop": _stop,
    "hardening_spring": _spring,
    "polynomial_spring": _spring,
    "quadratic_damping": _drag,
    "lugre_friction": _lugre,
    "backlash": _play,
    "linear_spring": _between,
    "saturation": _limit,
    "actuator_gain": _gain,
    "actuator_lag": _lag,
    "delay": _late,
}


def mjcf(case: Case) -> str:
    """Return the rig of a case as a model of MuJoCo."""
    p = dict(zip(PARAMETERS, rig_of(case).tolist(), strict=True))
    damped = dict(zip(PARAMETERS, rig_of(case, off=False).tolist(), strict=True))  # a stiffness that is off keeps this
    masses = {"spring1": p["mu1"], "spring2": p["mu2"], "beam": 1.0}
    felt = {at: 1.0 / (1.0 / m + 1.0) if at != "beam" else m for at, m in masses.items()}
    joints = {}
    for i, (at, m) in enumerate(masses.items(), 1):
        damping = 2.0 * p[f"z{i}"] * damped[f"w{i}"] * m
        joints[at] = {"stiffness": _number(m * p[f"w{i}"] ** 2), "damping": _number(damping)}
    rig = Mechanism(masses, felt, joints)
    for one in case.hidden:
        HIDE[one.effect](rig, one.at, one.parameters)
    pushes = {"V1": {"spring1": p["mu1"] * p["c1"]}, "V2": {"spring2": p["mu2"] * p["c2"]}, "V3": {"beam": p["c3"]}}
    tendons = [*(_tendon(push, {"name": v}) for v, push in pushes.items()), *rig.tendons]
    actuators = [f'<general tendon="{v}" {_written(a)}/>' for v, a in rig.actuators.items()]
    oscillators = "".join(_body(rig, at) for at in ("spring1", "spring2"))
    return f"""<mujoco>
<option timestep="{STEP}" integrator="RK4" gravity="0 0 0" solver="Newton" iterations="50" tolerance="0"/>
<worldbody>{_body(rig, "beam", oscillators)}</worldbody>
<tendon>{"".join(tendons)}</tendon>
<actuator>{"".join(actuators)}{"".join(rig.motors)}</actuator>
</mujoco>"""


def _body(rig: Mechanism, at: str, carried: str = "") -> str:
    inertia = f'<inertial pos="0 0 0" mass="{_number(rig.masses[at])}" diaginertia="1 1 1"/>'  # nothing turns
    joint = f'<joint name="{at}" type="slide" axis="1 0 0" {_written(rig.joints[at])}/>'
    return f"<body>{inertia}{joint}{carried}</body>"


def _tendon(coefficients: Mapping[str, float], attributes: Attributes) -> str:
    parts = "".join(f'<joint joint="{joint}" coef="{_number(c)}"/>' for joint, c in coefficients.items())
    return f"<fixed {_written(attributes)}>{parts}</fixed>"


def _written(attributes: Attributes) -> str:
    return " ".join(f'{name}="{value}"' for name, value in attributes.items())


def _number(*values: float) -> str:
    return " ".join(f"{value:.17g}" for value in values)
