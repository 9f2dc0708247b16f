"""Terms that switch with time, or are pulses in it, against closed forms in pieces and an integral by quadrature.

Each case is one term in x'' + c x' + k x = a f(t) from rest, or from a release; between its switches f is a polynomial,
so that the motion there is an exponential of a matrix; of smooth pulses it is the integral of f with the impulse
response.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyder, polyval
from scipy.integrate import quad
from scipy.linalg import expm

from masking.compile.codegen.time_switches import Spans
from masking.errors import IntegrationError
from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import load_model

C, K = 0.4, 1.3
OFF = 1e6  # an instant that is never reached
TIMES = np.array([0.0, 1.0, 59.0, 60.0, 60.003, 60.3, 62.0, 66.0, 71.5, 100.0])

# Terms of (t, t0, T), and of the same their pieces: (begin, coefficients of powers of the time since then).
PIECES = {
    "heaviside((t - {t0})/{T}) - heaviside((t - {t0} - {T})/{T})": lambda t0, T: [(t0, [1.0]), (t0 + T, [0.0])],
    "where(t > {t0}, where(t < {t0} + {T}, 1, 0), 0)": lambda t0, T: [(t0, [1.0]), (t0 + T, [0.0])],
    "max(1 - abs((t - {t0} - {T})/{T}), 0)": lambda t0, T: [
        (t0, [0.0, 1.0 / T]), (t0 + T, [1.0, -1.0 / T]), (t0 + 2.0 * T, [0.0]),
    ],
    "min(max((t - {t0})/{T}, 0), 1)": lambda t0, T: [(t0, [0.0, 1.0 / T]), (t0 + T, [1.0])],
    "max(1 - ((t - {t0})/{T})**2, 0)": lambda t0, T: [
        (t0 - T, [0.0, 2.0 / T, -1.0 / T**2]), (t0 + T, [0.0]),
    ],
    "(1 + sign(t - {t0}))*exp(0*{T})/2": lambda t0, T: [(t0, [1.0])],
    "floor(min(max((t - {t0})/{T}, 0), 3.5))": lambda t0, T: [
        (t0 + T, [1.0]), (t0 + 2.0 * T, [2.0]), (t0 + 3.0 * T, [3.0]),
    ],
    "heaviside(t - {t0})*heaviside({t0} + {T} - t)*(t - {t0})/{T}": lambda t0, T: [
        (t0, [0.0, 1.0 / T]), (t0 + T, [0.0]),
    ],
}  # fmt: skip
PULSES = {
    "exp(-((t - {t0})/{T})**2)": lambda x: np.exp(-x * x),
    "1/cosh((t - {t0})/{T})**2": lambda x: np.cosh(np.clip(x, -300.0, 300.0)) ** -2,
    "1/(1 + ((t - {t0})/{T})**2)**4": lambda x: (1.0 + x * x) ** -4,
    "(1 + tanh((t - {t0})/{T}))/2": lambda x: 0.5 + 0.5 * np.tanh(x),
}
WIDTHS = (0.003, 0.05, 0.7, 5.0)


def model_of(terms, tmp_path):
    """Model that the sum of terms drives, each with its own size, instant and width."""
    parameters = {
        f"{name}{i}": OFF if name == "t" else 1.0 * (name == "w") for i in range(len(terms)) for name in "atw"
    }
    drive = " + ".join(f"a{i}*({term.format(t0=f't{i}', T=f'w{i}')})" for i, term in enumerate(terms))
    text = f"name: driven\ncoordinates: {{x: {{initial: 0}}}}\nparameters: {{c: {C}, k: {K}, "
    text += ", ".join(f"{name}: {value}" for name, value in parameters.items())
    path = tmp_path / "driven.yaml"
    path.write_text(text + f"}}\nequations:\n  x'': {drive} - c*x' - k*x\n")
    return load_model(path)


@pytest.fixture(scope="module")
def in_pieces(tmp_path_factory):
    return model_of(PIECES, tmp_path_factory.mktemp("pieces"))


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    return model_of(PULSES, tmp_path_factory.mktemp("smooth"))


def by_exponentials(pieces, times, state, size_of_drive):
    """States [x, x'] at times, of a drive of a size, in pieces that are polynomials of the time."""
    edges = sorted({0.0, *times.tolist(), *(begin for begin, _ in pieces)})
    found, y = {0.0: state}, np.array(state)
    for begin, end in pairwise(edges):
        at, coefficients = max([(t, c) for t, c in pieces if t <= begin], default=(0.0, [0.0]))
        size = 2 + len(coefficients)
        matrix = np.zeros((size, size))
        matrix[0, 1], matrix[1, 0], matrix[1, 1], matrix[1, 2] = 1.0, -K, -C, 1.0
        matrix[2:-1, 3:] = np.eye(size - 3)  # each derivative of the drive is the rate of the one before
        drive = [size_of_drive * polyval(begin - at, polyder(coefficients, i)) for i in range(size - 2)]
        y = (expm(matrix * (end - begin)) @ np.append(y, drive))[:2]
        found[end] = y
    return np.array([found[t] for t in times])


@cache
def by_quadrature(term, width):
    """Displacements at the times under a smooth pulse at 60."""
    f, w = PULSES[term], np.sqrt(K - 0.25 * C * C)

    def response(t):
        near = [60.0 + width * n for n in (-30, -10, -4, -2, -1, 0, 1, 2, 4, 10, 30) if 0.0 < 60.0 + width * n < t]
        edges = [0.0, *near, *(x for x in np.arange(60.0, t, 3.0) if all(abs(x - n) > 1e-9 for n in near)), t]
        edges = sorted(edges)
        kernel = lambda s: f((s - 60.0) / width) * np.exp(-0.5 * C * (t - s)) * np.sin(w * (t - s)) / w  # noqa: E731
        return sum(quad(kernel, a, b, epsabs=1e-13, limit=200)[0] for a, b in pairwise(edges))

    return np.array([response(t) for t in TIMES[1:]])


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("term", PIECES)
def test_a_switch_in_time_is_stepped_to(term, width, in_pieces):
    i, instant = [*PIECES].index(term), 60.0
    model = in_pieces.with_parameters(**{f"a{i}": 1.0 / width, f"t{i}": instant, f"w{i}": width})
    for start in ([0.0, 0.0], [1.0, -0.5]):
        truth = by_exponentials(PIECES[term](instant, width), TIMES, start, 1.0 / width)
        found = model.simulate(TIMES, {"x": start[0], "x'": start[1]})
        assert np.max(abs(found.states - truth)) < 1e-8 * np.max(abs(truth))


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("term", PULSES)
def test_a_smooth_pulse_is_not_jumped_over(term, width, smooth):
    i = [*PULSES].index(term)
    model = smooth.with_parameters(**{f"a{i}": 1.0 / width, f"t{i}": 60.0, f"w{i}": width})
    found, truth = model.simulate(TIMES)["x"][1:], by_quadrature(term, width) / width
    assert np.max(abs(found - truth)) < 1e-8 * np.max(abs(truth))


def test_backwards_from_behind_a_switch(in_pieces):
    term = next(iter(PIECES))
    model = in_pieces.with_parameters(a0=20.0, t0=60.0, w0=0.05)
    truth = by_exponentials(PIECES[term](60.0, 0.05), np.array([58.0, 60.025, 62.0]), [1e-3, 0.0], 20.0)
    start = {"x": truth[-1, 0], "x'": truth[-1, 1]}
    found = model.simulate(np.array([62.0, 60.025, 58.0]), start)
    assert found.states[::-1] == pytest.approx(truth, abs=1e-9)


def test_an_ensemble_whose_runs_switch_at_their_own_times(in_pieces):
    term, instants = next(iter(PIECES)), [20.0, 60.0, 60.001]
    model = in_pieces.with_parameters(a0=20.0, w0=0.05)
    found = model.simulate(TIMES, ensemble={"t0": instants})
    for instant, states in zip(instants, found.states, strict=True):
        truth = by_exponentials(PIECES[term](instant, 0.05), TIMES, [0.0, 0.0], 20.0)
        assert states == pytest.approx(truth, abs=1e-9)


def test_a_harmonic_drive_is_integrated_in_one_span(tmp_path):
    """Nothing hides in it: steps are those that the integrator takes by itself."""
    path = tmp_path / "driven.yaml"
    path.write_text("name: driven\nstates: {z: {initial: 0}}\nparameters: {a: 2, w: 3}\nequations: {z': a*cos(w*t)}\n")
    model = load_model(path)
    u, p = np.zeros(0), model.values()
    assert model.kernels.meta["time_switches"] is None
    assert not len(model.kernels.instants(0.0, 1e4, u, p))
    assert not model.kernels.may_switch(TIMES, u, p * np.linspace(0.5, 2.0, 7)[:, None])
    assert model.simulate(TIMES)["z"] == pytest.approx(2.0 / 3.0 * np.sin(3.0 * TIMES), abs=1e-8)


def test_a_delayed_switch_and_a_switch_beside_a_delay(tmp_path):
    """Closed forms: the integral of a pulse, late by a delay; and by the method of steps, over two delays."""
    path = tmp_path / "late.yaml"
    pulse = "a*(heaviside(t - t0) - heaviside(t - t0 - T))"
    path.write_text(
        "name: late\nstates: {z: {initial: 0}, y: {initial: 0}}\nparameters: {a: 100, t0: 60.0, T: 0.01, tau: 2.0}\n"
        f"equations:\n  z': delay({pulse}, tau)\n  y': {pulse} - delay(y, tau)\n"
    )
    times = np.array([0.0, 60.0, 60.005, 61.0, 61.99, 62.005, 62.5, 63.0, 64.0])
    found = load_model(path).simulate(times)
    assert found["z"] == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0], abs=1e-9)
    behind = times - 62.0
    late = np.where(behind < 0.0, 0.0, np.where(behind < 0.01, 50.0 * behind**2, behind - 0.005))
    assert found["y"] == pytest.approx(np.clip(100.0 * (times - 60.0), 0.0, 1.0) - late, abs=1e-9)


@pytest.mark.parametrize("term", ["sign(sin(w*t))", "floor(t*w/pi) - 2*floor(t*w/pi/2)", "sign(sin(w*t)) + 0*abs(t)"])
def test_a_square_wave(term, tmp_path):
    """The integral of a square wave is a triangle; of 0 and 1 one that rises."""
    path = tmp_path / "square.yaml"
    path.write_text(f"name: square\nstates: {{z: {{initial: 0}}}}\nparameters: {{w: 7.3}}\nequations: {{z': {term}}}\n")
    times, half = np.linspace(0.0, 40.0, 97), np.pi / 7.3
    triangle = half * abs(np.mod(times / half + 1.0, 2.0) - 1.0)
    truth = 0.5 * (times - triangle) if term.startswith("floor") else triangle
    assert load_model(path).simulate(times)["z"] == pytest.approx(truth, abs=1e-9)


def test_switches_without_end_are_refused(tmp_path):
    path = tmp_path / "fast.yaml"
    path.write_text("name: fast\nstates: {z: {initial: 0}}\nequations: {z': sign(sin(1e9*t))}\n")
    with pytest.raises(IntegrationError, match=r"more often than .* integrate a shorter time"):
        load_model(path).simulate(np.linspace(0.0, 10.0, 11))


def test_spans_keep_each_time_once():
    instants = np.array([[1.0, 1.1], [2.0, 2.0], [4.0, 4.5]])
    for times in (np.array([0.0, 1.0, 1.05, 1.1, 2.0, 3.0, 4.4]), np.array([4.5, 4.4, 3.0, 2.0, 1.1, 1.05, 0.5])):
        spans = Spans.of(times, instants)
        backwards = bool(times[-1] < times[0])
        carried = [next((gap[int(backwards)] for gap in instants if gap[0] < t < gap[1]), t) for t in times]
        assert spans.grid[spans.rows] == pytest.approx(carried)
        begins = sorted(spans.begins.items())
        assert [t for _, t in begins] == sorted((gap[int(not backwards)] for gap in instants), reverse=backwards)
        for first, last in spans.ranges(3):
            assert abs(spans.grid[first:last] - spans.begins.get(first, times[0])).size == last - first


KNOCK = """
name: a mass that is knocked between samples
coordinates: {x: {meaning: displacement, unit: m, initial: 0}}
inputs: {F: {unit: N}}
parameters:
  m: {value: 1, unit: kg}
  a: {value: 100, unit: N}
  t0: {value: 0.50037, unit: s}
  T: {value: 0.0031, unit: s}
equations: {m*x'': "F + a*(heaviside((t - t0)/T) - heaviside((t - t0 - T)/T))"}
"""


@pytest.mark.parametrize("observer", ["exact", "{kind: disturbance, noise: 1e-9}"])
def test_a_plant_that_switches_between_samples(observer, tmp_path):
    """Momentum: that of the held commands, and that of the knock, to the last part of a sample."""
    (tmp_path / "mass.yaml").write_text(KNOCK)
    (tmp_path / "rig.yaml").write_text(
        "name: rig\nmodel: mass.yaml\nsensors: {s: {measures: x, unit: m}}\n"
        "limits: {inputs: {F: {max: 1000, unit: N}}}\n"
    )
    (tmp_path / "free.yaml").write_text(
        "name: free\ncoordinates: {x: {meaning: displacement, unit: m, initial: 0}}\n"
        "parameters: {m: {value: 1, unit: kg}}\nequations: {m*x'': 0}\n"
    )
    path = tmp_path / "experiment.yaml"
    path.write_text(
        f"name: knocked\nplant: rig.yaml\nvirtual: free.yaml\ncontroller: {{rate: 1 kHz, observer: {observer}}}\n"
        "duration: 1\n"
    )
    found = Experiment.load(path).run()
    held = np.sum(found["input.F"][:-1]) / 1000.0
    assert found["rig.x'"][-1] == pytest.approx(held + 100.0 * 0.0031, abs=3e-6)
