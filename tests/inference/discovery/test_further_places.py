"""Laws that no dictionary has and that follow more than the motion of their own place: memory, another coordinate.

Truths are integrated by scipy from equations typed here.
"""

import json
from math import tanh

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import masking
from masking.app.workflows import discovery_inputs
from masking.inference.discovery import further_places
from masking.inference.discovery.augmented_model import AugmentedModel

NOISE, SAMPLES, RATE = 1e-3, 900, 25.0
MODELS = {
    1: """
name: mass on a spring
coordinates: {q1: {unit: m}}
inputs: {u: {unit: N}}
parameters: {m1: {value: 1.01, unit: kg}, k1: {value: 39.5, unit: N/m}, c1: {value: 0.4, unit: N*s/m}}
equations: {m1*q1'': -k1*q1 - c1*q1' + u}
elements: {spring1: {displacement: q1, unit: N, acts: {q1: -1}}}
""",
    2: """
name: two masses
coordinates: {q1: {unit: m}, q2: {unit: m}}
inputs: {u: {unit: N}}
parameters:
  m1: {value: 1.01, unit: kg}
  m2: {value: 0.795, unit: kg}
  k1: {value: 39.5, unit: N/m}
  k2: {value: 50.3, unit: N/m}
  c1: {value: 0.4, unit: N*s/m}
  c2: {value: 0.3, unit: N*s/m}
equations:
  m1*q1'': -k1*q1 - c1*q1' + k2*(q2 - q1) + c2*(q2' - q1')
  m2*q2'': -k2*(q2 - q1) - c2*(q2' - q1') + u
elements:
  spring1: {displacement: q1, unit: N, acts: {q1: -1}}
  spring2: {displacement: q2 - q1, unit: N, acts: {q1: 1, q2: -1}}
""",
}


def tanh_of_maxwell(y, u):
    """Return the rates of one mass with a force 6 tanh(2 e) of the deflection e of a Maxwell spring, tau = 0.3 s."""
    q, v, z = y
    return [v, -40.0 * q - 0.4 * v - 6.0 * tanh(2.0 * (q - z)) + u, (q - z) / 0.3]


def cubic_maxwell(y, u):
    """Return the same with a force 30 e^3, tau = 0.15 s."""
    q, v, z = y
    return [v, -40.0 * q - 0.4 * v - 30.0 * (q - z) ** 3 + u, (q - z) / 0.15]


def square_of_the_other(y, u):
    """Return the rates of two masses, the second of which pushes the first by 12 q2^2."""
    q1, q2, v1, v2 = y
    joint = 50.0 * (q2 - q1) + 0.3 * (v2 - v1)
    return [v1, v2, -40.0 * q1 - 0.4 * v1 + joint - 12.0 * q2**2, (-joint + u) / 0.8]


CASES = {tanh_of_maxwell: (1, 3), cubic_maxwell: (1, 3), square_of_the_other: (2, 4)}
WORDS = {tanh_of_maxwell: "relaxing rate", cubic_maxwell: "relaxing rate", square_of_the_other: "displacement of q2"}


def record(law, seed):
    """Return a record under a multisine as CSV, its input in straight lines between samples."""
    n, states = CASES[law]
    draw, t = np.random.default_rng(seed), np.arange(SAMPLES) / RATE
    speeds, phases = 6.3 * np.linspace(0.2, 2.2, 20), draw.uniform(0.0, 2.0 * np.pi, 20)
    u = 1.6 * np.sin(np.outer(t, speeds) + phases).sum(axis=1)

    def rates(at, y):
        i = min(int(at * RATE), SAMPLES - 2)
        return law(y, float(u[i] + (u[i + 1] - u[i]) * (at * RATE - i)))

    made = solve_ivp(
        rates, (0.0, t[-1]), np.zeros(states), "LSODA", t_eval=t, rtol=1e-8, atol=1e-10, max_step=1.0 / RATE
    )
    q = made.y[:n]
    read = q + NOISE * q.std(axis=1, keepdims=True) * draw.normal(size=q.shape)
    names = ",".join(["t", "u", *(f"q{i + 1}" for i in range(n))])
    rows = [",".join(f"{x:.9g}" for x in row) for row in np.column_stack([t, u, read.T])]
    return "\n".join([names, *rows]) + "\n"


LONGER = (cubic_maxwell, square_of_the_other)
PARAMETERS = [tanh_of_maxwell, *(pytest.param(law, marks=pytest.mark.search) for law in LONGER)]


@pytest.fixture(scope="module", params=PARAMETERS, ids=lambda law: law.__name__)
def found(request, tmp_path_factory):
    law, folder = request.param, tmp_path_factory.mktemp("memory")
    (folder / "model.yaml").write_text(MODELS[CASES[law][0]])
    for seed, name in ((1, "train"), (2, "unseen")):
        (folder / f"{name}.csv").write_text(record(law, seed))
    given = {"model": folder / "model.yaml", "validation": folder / "unseen.csv", "hold": "first-order"}
    return masking.discover(folder / "train.csv", **given, out=folder / "found"), law, folder


def test_a_law_that_follows_more_than_its_place_leaves_noise(found):
    discovery, law, _ = found
    assert discovery.verdict == "unknown"
    assert discovery.law.place == "spring1"
    assert max(discovery.law.error[1].values()) < 1.5 * NOISE
    assert WORDS[law] in discovery.law.free.nouns.values()


def test_its_written_model_reproduces_what_is_promised(found):
    discovery, _, folder = found
    content = json.loads((folder / "found" / "discovery.json").read_text())
    for name, promised in zip(("train", "unseen"), discovery.law.error, strict=True):
        made = masking.simulate(folder / "found" / "plant.yaml", folder / f"{name}.csv", hold="first-order")
        assert made.chi == pytest.approx(promised, rel=0.01)
    assert content["law"]["follows"]["d_rate"] == discovery.law.free.nouns["v"]


def test_every_place_of_a_rig_stays_beside_a_law_with_memory(tmp_path):
    text = "{name: motor, states: {w: {}, p: {}}, parameters: {a: 2}, equations: {w': -a*w, p': w - p}}"
    (tmp_path / "model.yaml").write_text(text)
    rig = AugmentedModel(discovery_inputs.rig(tmp_path / "model.yaml", None), ("a",))
    (one,) = further_places.of(rig, "p", 1.0)
    assert [place.name for place in one.rig.places] == ["memory_p_place", "w", "p"]
