"""PySINDy on the same records: sparse regression on the forces that the declared rig does not explain.

It is given more than a user would have: the equations and parameters of the rig, forces per element by the balance of
momentum, the rate at which the sign in a friction is smooth, and a filter that leaves out noise beyond the excitation
from both sides of the regression. Smoothing and threshold are chosen on the last part of the record.
Source: Brunton, Proctor and Kutz (2016), PNAS 113(15), 3932-3937; terms are normalised before they are thresholded.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tests.benchmarks import hidden
from tests.benchmarks.hidden.laws import SLIDING
from tests.benchmarks.hidden.rig import ELEMENTS, RATE, SENSOR_GAIN, SENSORS, Array, Damping, Rigs, declared

try:
    import pysindy  # type: ignore[import-not-found,unused-ignore]
except ImportError:
    pysindy = None

NAMES = ("d1", "v1", "d2", "v2", "d3", "v3", "V1", "V2", "V3")
CUTOFFS = (6.0, 10.0, 16.0)  # Hz, of the low-pass; the excitation ends at 4 Hz
EVERY = 20  # samples: what is left has no more than 25 Hz
EDGE = 1.0  # s left out at both ends, where the filter has only one side
HELD_OUT = 0.3  # of the record
THRESHOLDS = tuple(np.geomspace(0.005, 0.5, 14).tolist())  # of a term's size for that of the force, both in rms
RIDGE = 1e-6
SPARE = 1.02  # of the least held-out error: the sparsest model within that is taken
WRONG = 0.03  # relative change of a declared term from which it counts as added: three times what is declared
STEP = 5  # samples in a step of the simulation
LOST = 0.1  # m: a model that goes farther has diverged
UNITS = np.array([1e-3, 1e-2, 1e-3, 1e-2, 1e-3, 1e-2, 0.1, 0.1, 0.1])  # so that no column is small beyond reason


@dataclass(frozen=True)
class Fit:
    """Coefficients (3, terms) of the forces of spring1, spring2 and beam, in m/s**2, and names of the terms."""

    terms: tuple[str, ...]
    coefficients: Array
    weights: Array  # (3, terms): what leaving each term out would cost, in standard errors


def version() -> str:
    """Return the version of PySINDy, empty where it is not installed."""
    return str(pysindy.__version__) if pysindy is not None else ""


def library() -> Any:
    """Return cubic polynomials of displacements and rates, v|v|, tanh(v/vs), and powers of the commands."""
    shapes = [lambda v: v * np.abs(v), lambda v: np.tanh(v * (UNITS[1] / SLIDING))]
    names = [lambda v: f"{v}|{v}|", lambda v: f"sign({v})"]
    return pysindy.GeneralizedLibrary(
        [
            pysindy.PolynomialLibrary(degree=3),
            pysindy.CustomLibrary(library_functions=shapes, function_names=names),
            pysindy.PolynomialLibrary(degree=3, include_interaction=False, include_bias=False),
        ],
        inputs_per_library=[[0, 1, 2, 3, 4, 5], [1, 3, 5], [6, 7, 8]],
    )


def base(damping: Damping) -> tuple[Array, Array, Array]:
    """Return stiffness and damping (3,) per mass of the elements, and how commands act on d1'', d2'' and x3'' (3, 3).

    They are as declared.
    """
    rigs = declared_rig(damping)
    return rigs.stiffness[:, 0], rigs.damping[:, 0], rigs.acceleration(np.eye(3)[:, :, None])[:, :, 0].T


def declared_rig(damping: Damping) -> Rigs:
    """Return the declared rig as a batch of one."""
    return Rigs(declared(damping)[None])


def motion(record: hidden.Record, cutoff: float) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return the signals (m, 9) in `NAMES`, accelerations (m, 3) of d1, d2 and x3, and the filter."""
    sections = butter(4, cutoff, fs=RATE, output="sos")

    def smooth(x: Array) -> Array:
        return np.asarray(sosfiltfilt(sections, x, axis=0))

    d = smooth(record.readings) / SENSOR_GAIN
    v = np.gradient(d, 1.0 / RATE, axis=0)
    a = np.gradient(v, 1.0 / RATE, axis=0)
    # A command is held from its sample on: in the mean it acts half a sample later.
    u = record.commands.copy()
    u[1:] = (record.commands[1:] + record.commands[:-1]) / 2.0
    signals = np.empty((len(d), 9))
    signals[:, 0:6:2], signals[:, 1:6:2], signals[:, 6:] = d, v, smooth(u)
    return signals, a, smooth


def forces(signals: Array, a: Array, damping: Damping) -> Array:
    """Return the force (m, 3) in each element, in m/s**2, that the declared rig lacks."""
    k, c, gains = base(damping)
    rigs = declared_rig(damping)
    mu = rigs.passed_on[:2, 0]
    d, v, u = signals[:, 0:6:2], signals[:, 1:6:2], signals[:, 6:]
    known = k * d + c * v
    push = u @ gains.T
    # x3'' = mu1 (f1 + F1) + mu2 (f2 + F2) - (f3 + F3) + push3, and x_i'' = d_i'' + x3'' = -(f_i + F_i) + c_i V_i
    absolute = a[:, :2] + a[:, 2:]
    lacking = np.empty_like(known)
    lacking[:, :2] = -absolute - known[:, :2] + push[:, :2] + push[:, 2:]
    lacking[:, 2] = (known[:, :2] + lacking[:, :2]) @ mu - known[:, 2] + push[:, 2] - a[:, 2]
    return lacking


def fit(record: hidden.Record, damping: Damping) -> Fit:
    """Return the sparsest model of each force that does well on the part of the record that is held out."""
    best: list[tuple[float, Array, Array] | None] = [None] * 3
    names: tuple[str, ...] = ()
    for cutoff in CUTOFFS:
        signals, a, smooth = motion(record, cutoff)
        made = library()
        columns = np.asarray(made.fit_transform(signals / UNITS))
        names = tuple(made.get_feature_names(list(NAMES)))
        inside = slice(round(EDGE * RATE), len(columns) - round(EDGE * RATE), EVERY)
        x = smooth(columns)[inside]
        y = smooth(forces(signals, a, damping))[inside]
        # Whatever the smoothing, errors are told apart only in what all of them let through.
        low = sosfiltfilt(butter(4, CUTOFFS[0], fs=RATE / EVERY, output="sos"), np.hstack((x, y)), axis=0)
        cut = round(len(x) * (1.0 - HELD_OUT))
        for i, given in enumerate(declared_terms(damping)):
            linear = [names.index(name) for name in given]
            tried: set[tuple[int, ...]] = set()
            for threshold in THRESHOLDS:
                chosen = _chosen(x[:cut], y[:cut, i], linear, threshold)
                if chosen in tried:
                    continue
                tried.add(chosen)
                found, weights = _refitted(x[:cut], y[:cut, i], chosen)
                error = float(np.mean((low[cut:, len(names) + i] - low[cut:, : len(names)] @ found) ** 2))
                now = best[i]
                fewer = now is not None and len(chosen) <= np.count_nonzero(now[1])
                if now is None or error < now[0] / SPARE or (error < now[0] * SPARE and fewer):
                    best[i] = (error, found, weights)
    parts = [one for one in best if one is not None]
    return Fit(names, np.array([p[1] for p in parts]), np.array([p[2] for p in parts]))


def _chosen(x: Array, y: Array, linear: Sequence[int], threshold: float) -> tuple[int, ...]:
    """Return the terms that sequential thresholding keeps, all normalised; those of the declared rig always stay."""
    basis = np.linalg.qr(x[:, list(linear)])[0]
    others = [j for j in range(x.shape[1]) if j not in linear]
    left = x[:, others] - basis @ (basis.T @ x[:, others])
    rest = y - basis @ (basis.T @ y)
    size = float(np.linalg.norm(rest))
    if size == 0.0:
        return tuple(linear)
    optimizer = pysindy.STLSQ(threshold=threshold, alpha=RIDGE, normalize_columns=True, max_iter=20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where no term is left, which is an answer
        optimizer.fit(left, (rest / size)[:, None])
    # Its coefficients are those of columns that are not normalised: where they are 0 is what matters.
    return (*linear, *(others[j] for j in np.flatnonzero(np.asarray(optimizer.coef_)[0])))


def _refitted(x: Array, y: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
    """Return the coefficients (terms,) by least squares, and what leaving each out would cost, in standard errors."""
    used = x[:, list(chosen)]
    size = np.linalg.norm(used, axis=0)
    inverse = np.linalg.pinv((used / size).T @ (used / size))
    solution = inverse @ ((used / size).T @ y)
    rest = y - (used / size) @ solution
    scale = max(float(np.sqrt(np.mean(rest**2))), 1e-12)
    found, weights = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    found[list(chosen)] = solution / size
    weights[list(chosen)] = np.abs(solution) / (scale * np.sqrt(np.maximum(np.diag(inverse), 1e-300)))
    return found, weights


def declared_terms(damping: Damping) -> list[dict[str, float]]:
    """Return the terms of the declared rig in the force of each element, with the size of their coefficients."""
    k, c, _ = base(damping)
    rigs = declared_rig(damping)
    mu, c3 = rigs.passed_on[:2, 0], float(rigs["c3"][0])
    return [
        {"d1": k[0], "v1": c[0], "V1": float(rigs["c1"][0])},
        {"d2": k[1], "v2": c[1], "V2": float(rigs["c2"][0])},
        {"d3": k[2], "v3": c[2], "V1": c3, "V2": c3, "V3": c3}
        | {f"{n}{i + 1}": mu[i] * value[i] for i in (0, 1) for n, value in (("d", k), ("v", c))},
    ]


def meanings(element: int, term: str) -> list[tuple[str, str]]:  # noqa: PLR0911  # one for each kind
    """Return all that a term in the force of an element may mean as (effect, place); the first is what it looks like.

    d1, d2 and d3 are the displacements of spring1, spring2 and beam, v1 to v3 their rates.
    """
    place, own = ELEMENTS[element], str(element + 1)
    if term == "1":
        return [("constant_force", place), ("actuator_offset", f"V{own}")]
    if match := re.fullmatch(r"([dvV])(\d)(?:\^(\d))?", term):
        kind, number, power = match[1], match[2], int(match[3] or 1)
        if kind == "V":
            gain = [("actuator_gain", f"V{number}"), ("parameter", f"c{number}")]
            return gain if power == 1 else [("actuator_cubic", f"V{number}")] if power == 3 else [("terms", term)]
        if number != own:
            if element == 2:
                return [("parameter", f"mu{number}")] if power == 1 else [("terms", term)]
            if kind == "d" and power == 1 and number != "3":
                return [("linear_spring", "x1-x2")]
            return [("terms", term)]
        laws = {
            ("d", 1): [("parameter", f"w{own}"), ("linear_spring", place)],
            ("d", 2): [("polynomial_spring", place)],
            ("d", 3): [("hardening_spring", place)],
            ("v", 1): [("parameter", f"z{own}"), ("viscous_damping", place)],
        }
        return laws.get((kind, power), [("terms", term)])
    if term == f"v{own}|v{own}|":
        return [("quadratic_damping", place)]
    if term == f"sign(v{own})":
        return [("dry_friction", place)]
    return [("terms", term)]


def added(found: Fit, damping: Damping) -> list[tuple[float, int, str]]:
    """Return the terms that were added, the most important first, as (weight, element, term).

    A term of the declared rig is added where it changes by more than `WRONG`.
    """
    result = []
    for i, terms in enumerate(declared_terms(damping)):
        for j in np.flatnonzero(found.coefficients[i]):
            term = found.terms[j]
            unit = UNITS[NAMES.index(term)] if term in NAMES else 1.0
            if abs(found.coefficients[i, j]) / unit > WRONG * terms.get(term, 0.0):
                result.append((float(found.weights[i, j]), i, term))
    return sorted(result, reverse=True)


def simulated(record: hidden.Record, damping: Damping, found: Fit | None) -> Array | None:
    """Return the readings (m / STEP, 3) in V of the declared rig with the terms found, from the first reading at rest.

    None where it diverges.
    """
    k, c, gains = base(damping)
    mu = declared_rig(damping).passed_on[:2, 0]
    extra = _extra(found) if found is not None else None
    steps = len(record.commands) // STEP
    told = record.commands[: steps * STEP].reshape(steps, STEP, 3).mean(axis=1)
    pushed = told @ gains.T
    h = STEP / RATE

    def rates(y: Array, u: Array, push: Array) -> Array:
        f = k * y[:3] + c * y[3:]
        if extra is not None:
            f += extra(y, u)
        x3 = mu @ f[:2] - f[2]
        out = np.empty(6)
        out[:3] = y[3:]
        out[3:5] = -f[:2] - x3 + push[:2]
        out[5] = x3 + push[2]
        return out

    y = np.zeros(6)
    y[:3] = record.readings[:20].mean(axis=0) / SENSOR_GAIN
    seen = np.empty((steps, 3))
    for n in range(steps):
        seen[n] = y[:3]
        u, push = told[n], pushed[n]
        k1 = rates(y, u, push)
        k2 = rates(y + h / 2.0 * k1, u, push)
        k3 = rates(y + h / 2.0 * k2, u, push)
        k4 = rates(y + h * k3, u, push)
        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        if not np.abs(y[:3]).max() < LOST:
            return None
    return SENSOR_GAIN * seen


def _extra(found: Fit) -> Callable[[Array, Array], Array]:
    """Return the forces (3,) of the terms that are not zero, of a state (6,) and commands (3,)."""
    used = np.flatnonzero(found.coefficients.any(axis=0))
    matrix = found.coefficients[:, used]
    factors = np.full((3, len(used)), 15)  # of the nine signals, v|v| and the smooth sign of each rate, and 1
    for column, j in enumerate(used):
        parts: list[int] = []
        for part in found.terms[j].split():
            if match := re.fullmatch(r"sign\(v(\d)\)", part):
                parts.append(11 + int(match[1]))
            elif match := re.fullmatch(r"v(\d)\|v\d\|", part):
                parts.append(8 + int(match[1]))
            elif part != "1":
                name, _, power = part.partition("^")
                parts += [NAMES.index(name)] * int(power or 1)
        factors[: len(parts), column] = parts

    signals = np.ones(16)

    def extra(y: Array, u: Array) -> Array:
        signals[0:6:2], signals[1:6:2], signals[6:9] = y[:3], y[3:], u
        signals[:9] /= UNITS
        signals[9:12] = signals[1:6:2] * np.abs(signals[1:6:2])
        signals[12:15] = np.tanh(y[3:] / SLIDING)
        return np.asarray(matrix @ signals[factors].prod(axis=0))

    return extra


def answer(case: hidden.Case, training: hidden.Record, validation: hidden.Record) -> dict[str, Any]:
    """Return what PySINDy adds, as JSON can hold it: verdict, terms with their meanings, and gaps of the validation."""
    found = fit(training, case.damping)
    terms = added(found, case.damping)
    before, after = (
        _gap(validation, simulated(validation, case.damping, one)) for one in (None, found if terms else None)
    )
    kinds = [meanings(i, term) for _, i, term in terms]
    coupled = ("linear_spring", "x1-x2")
    if any(kind[0] == coupled for kind in kinds):  # its own part looks like a wrong eigenfrequency
        kinds = [[*kind, coupled] if kind[0] in {("parameter", "w1"), ("parameter", "w2")} else kind for kind in kinds]
    verdict = "none" if not terms else "parameter" if kinds[0][0][0] == "parameter" else "named"
    return {
        "verdict": verdict,
        "terms": kinds,
        "model": [f"{ELEMENTS[i]}: {term}" for _, i, term in terms],
        "simulation_error": {"before": before, "after": after},
    }


def _gap(record: hidden.Record, seen: Array | None) -> Mapping[str, float] | None:
    if seen is None:
        return None
    readings = record.readings[: len(seen) * STEP : STEP]
    chi = np.sqrt(((readings - seen) ** 2).mean(axis=0) / (readings**2).mean(axis=0))
    return dict(zip(SENSORS, map(float, chi), strict=True))
