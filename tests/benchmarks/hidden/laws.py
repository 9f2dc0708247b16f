"""The laws of the hidden effects, in numpy, from their physical definitions.

A force is per mass, in m/s**2, of a displacement d in m, its rate v in m/s, internal states z (states, rows), the time
t in s and the values of the parameters (rows,), in SI units. What a sensor or an actuator changes is in V.
Names of effects and of their parameters are those of the package that is judged; where a law is not in its dictionary,
it is listed in `OUTSIDE`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.hidden.rig import Array

Values = tuple[Array, ...]  # of the parameters, each (rows,)
Change = Callable[..., Array]  # (s, *parameters) -> s, both (rows, samples)

SLIDING = 1e-3  # m/s: the rate at which tanh(v/vs) has 76 % of the size of the sign
HUNDRED = 100.0  # s: the time of the change that the coefficient of a drift tells


@dataclass(slots=True)
class Motion:
    """What a law sees: displacement d and its rate v (rows,), internal states z (states, rows), and the time t."""

    d: Array
    v: Array
    z: Array
    t: float


@dataclass(frozen=True)
class ElementLaw:
    """A force: names of its parameters, the force, and the rates of its internal states, which are 0 at first."""

    parameters: tuple[str, ...]
    force: Callable[[Motion, Values], Array]
    rates: Callable[[Motion, Values], Array] | None = None
    states: int = 0


def _constant(m: Motion, p: Values) -> Array:
    (f0,) = p
    return f0


def _linear(m: Motion, p: Values) -> Array:
    (k,) = p
    return k * m.d


def _viscous(m: Motion, p: Values) -> Array:
    (c,) = p
    return c * m.v


def _quadratic(m: Motion, p: Values) -> Array:
    (k2,) = p
    return k2 * m.d * m.d


def _cubic(m: Motion, p: Values) -> Array:
    (k3,) = p
    return k3 * m.d * m.d * m.d


def _drag(m: Motion, p: Values) -> Array:
    (c,) = p
    return c * m.v * np.abs(m.v)


def _coulomb(m: Motion, p: Values) -> Array:
    fc, vs = p
    return fc * np.tanh(m.v / vs)


def _asymmetric(m: Motion, p: Values) -> Array:
    fp, fm, vs = p
    return np.where(m.v > 0.0, fp, fm) * np.tanh(m.v / vs)


def _stribeck(m: Motion, p: Values) -> Array:
    fc, fs, vst, vs = p
    return (fc + (fs - fc) * np.exp(-((m.v / vst) ** 2))) * np.tanh(m.v / vs)


def _bristles_rate(m: Motion, p: Values) -> Array:
    fc, fs, vst, s0, _, _ = p
    return m.v - s0 * np.abs(m.v) * m.z / (fc + (fs - fc) * np.exp(-((m.v / vst) ** 2)))


def _bristles(m: Motion, p: Values) -> Array:
    _, _, _, s0, s1, s2 = p
    return np.asarray((s0 * m.z + s1 * _bristles_rate(m, p) + s2 * m.v)[0])


def _dahl(m: Motion, p: Values) -> Array:
    fc, _ = p
    return np.asarray(fc * m.z[0])


def _dahl_rate(m: Motion, p: Values) -> Array:
    _, x0 = p
    return (m.v - np.abs(m.v) * m.z) / x0


def _bouc_wen(m: Motion, p: Values) -> Array:
    k, _, _, _ = p
    return np.asarray(k * m.z[0])


def _bouc_wen_rate(m: Motion, p: Values) -> Array:
    _, zmax, beta, n = p
    part = m.z / zmax
    size = np.abs(part)
    return np.asarray(m.v - beta * np.abs(m.v) * part * size ** (n - 1.0) - (1.0 - beta) * m.v * size**n)


def _play(m: Motion, p: Values) -> Array:
    k, gap = p
    return k * (m.d - np.minimum(np.maximum(m.d, -gap / 2.0), gap / 2.0))


def _stop(m: Motion, p: Values) -> Array:
    k, edge, c, side = p
    return side * k * np.maximum(side * (m.d - edge), 0.0) * np.maximum(1.0 + c * side * m.v, 0.0)


def _local(m: Motion, p: Values) -> Array:
    fc, edge, width, vs, side = p
    return fc * np.tanh(m.v / vs) * (1.0 + np.tanh(side * (m.d - edge) / width)) / 2.0


def _gravity(m: Motion, p: Values) -> Array:
    a, r = p
    return a * np.sin(m.d / r)


def _periodic(m: Motion, p: Values) -> Array:
    a, b, f = p
    return np.asarray(a * np.sin(2.0 * np.pi * f * m.t) + b * np.cos(2.0 * np.pi * f * m.t))


def _drift(m: Motion, p: Values) -> Array:
    (k,) = p
    return k * m.d * (m.t / HUNDRED)


def _bilinear(m: Motion, p: Values) -> Array:
    (k,) = p
    return k * np.maximum(m.d, 0.0)


def _position_damping(m: Motion, p: Values) -> Array:
    (c,) = p
    return c * m.d * m.d * m.v


def _saturating(m: Motion, p: Values) -> Array:
    k, d0 = p
    return k * (d0 * np.tanh(m.d / d0) - m.d)


def _slider_rate(m: Motion, p: Values) -> Array:
    _, gap, _, tau = p
    apart = m.d - m.z
    return (apart - np.minimum(np.maximum(apart, -gap / 2.0), gap / 2.0)) / tau


def _slider(m: Motion, p: Values) -> Array:
    fc, _, vs, _ = p
    return np.asarray(fc * np.tanh(_slider_rate(m, p)[0] / vs))


def _softening(m: Motion, p: Values) -> Array:
    k, _ = p
    return np.asarray(k * m.d * np.expm1(-m.z[0]))


def _softening_rate(m: Motion, p: Values) -> Array:
    _, travel = p
    return (np.abs(m.v) / travel)[None]


def _maxwell(m: Motion, p: Values) -> Array:
    k, _ = p
    return np.asarray(k * m.z[0])


def _maxwell_rate(m: Motion, p: Values) -> Array:
    _, tau = p
    return m.v - m.z / tau


def _rubbing(m: Motion, p: Values) -> Array:
    g, vs = p
    return g * np.abs(m.d) * np.tanh(m.v / vs)


def _magnet(m: Motion, p: Values) -> Array:
    k, d0 = p
    return -k * m.d / (1.0 + (m.d / d0) ** 2) ** 2


FORCES: dict[str, ElementLaw] = {
    "constant_force": ElementLaw(("f0",), _constant),
    "linear_spring": ElementLaw(("k",), _linear),
    "viscous_damping": ElementLaw(("c",), _viscous),
    "polynomial_spring": ElementLaw(("k2",), _quadratic),
    "hardening_spring": ElementLaw(("k3",), _cubic),
    "quadratic_damping": ElementLaw(("c",), _drag),
    "dry_friction": ElementLaw(("fc", "vs"), _coulomb),
    "asymmetric_friction": ElementLaw(("fp", "fm", "vs"), _asymmetric),
    "stribeck_friction": ElementLaw(("fc", "fs", "vst", "vs"), _stribeck),
    "lugre_friction": ElementLaw(("fc", "fs", "vst", "s0", "s1", "s2"), _bristles, _bristles_rate, 1),
    "dahl_friction": ElementLaw(("fc", "x0"), _dahl, _dahl_rate, 1),
    "hysteresis": ElementLaw(("k", "zmax", "beta", "n"), _bouc_wen, _bouc_wen_rate, 1),
    "backlash": ElementLaw(("k", "gap"), _play),
    "stop": ElementLaw(("k", "edge", "c", "side"), _stop),
    "local_friction": ElementLaw(("fc", "edge", "width", "vs", "side"), _local),
    "gravity_force": ElementLaw(("a", "r"), _gravity),
    "periodic_force": ElementLaw(("a", "b", "f"), _periodic),
    "stiffness_drift": ElementLaw(("k",), _drift),
}

OUTSIDE: dict[str, ElementLaw] = {
    # another stiffness while d > 0
    "bilinear_spring": ElementLaw(("k",), _bilinear),
    # damping that grows with the distance from the middle, as of van der Pol (1926), Phil. Mag. 2, 978-992
    "position_damping": ElementLaw(("c",), _position_damping),
    # what a spring loses that gives no more than k d0
    "saturating_spring": ElementLaw(("k", "d0"), _saturating),
    # a slider that is dragged along by a pin in a slot: play, then dry friction; `tau` regularises the impact
    "play_with_friction": ElementLaw(("fc", "gap", "vs", "tau"), _slider, _slider_rate, 1),
    # a spring that loses the stiffness k as the path travelled grows past `travel`
    "softening_with_travel": ElementLaw(("k", "travel"), _softening, _softening_rate, 1),
    # a spring behind a dashpot: linear, but of another order, Maxwell (1867), Phil. Trans. R. Soc. 157, 49-88
    "relaxing_spring": ElementLaw(("k", "tau"), _maxwell, _maxwell_rate, 1),
    # friction of a wedge: in proportion to the distance from the middle
    "rubbing": ElementLaw(("g", "vs"), _rubbing),
    # attraction by a magnet in the middle that fades with distance
    "fading_magnet": ElementLaw(("k", "d0"), _magnet),
}

ELEMENT_LAWS = FORCES | OUTSIDE


def _clip(s: Array, limit: Array) -> Array:
    return np.minimum(np.maximum(s, -limit), limit)


def rounded(s: Array, step: Array | float) -> Array:
    """Return the multiple of the step that is nearest to s, the upper one of two."""
    return np.asarray(step * np.floor(s / step + 0.5))


INERTIA = "added_mass"  # m: a force m x'' on x1 or the beam, by the mass of what it is on

COMMANDS: dict[str, tuple[str, Change]] = {  # what an actuator makes of its command, sample by sample
    "actuator_gain": ("e", lambda u, e: (1.0 + e) * u),
    "actuator_offset": ("u0", lambda u, u0: u + u0),
    "saturation": ("limit", _clip),
    "dead_zone": ("width", lambda u, width: u - _clip(u, width)),
    "dac_quantisation": ("step", rounded),
    "actuator_cubic": ("c", lambda u, c: u + c * u**3),
}

READINGS: dict[str, tuple[str, Change]] = {  # what a sensor makes of 200 V/m times its displacement, before noise
    "sensor_offset": ("e0", lambda s, e0: s + e0),
    "sensor_gain": ("e", lambda s, e: s * (1.0 + e)),
    "sensor_cubic": ("c", lambda s, c: s + c * s**3),
    "sensor_rectification": ("r", lambda s, r: s + r * np.abs(s)),
    "sensor_saturation": ("limit", _clip),
}

TIMED = ("actuator_lag", "delay", "sensor_lag")  # these need the time between samples: tau in s, or seconds
LAST = "quantisation"  # after the noise: step in V
KNOWN = (*FORCES, INERTIA, *COMMANDS, *READINGS, *TIMED, LAST)
