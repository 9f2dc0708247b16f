"""Declarations with indices, and systems of many coordinates that are declared with them."""

import cProfile
import pstats
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate

from masking import load_model
from masking.analysis.masking_error import masking_error
from masking.compile.numerics.runge_kutta import fault
from masking.compile.numerics.stop_codes import REACHED
from masking.errors import DeclarationError
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from tests.support.kernels import called

MANY = Path(__file__).parents[3] / "examples" / "many"

CHAIN = """
repeat: [N = 4, i = 1..N]
coordinates: {"x[i]": {meaning: "mass [i] of [N]; see [7]", initial: "0.1*[i] - 0.2"}}
parameters: {"k[i=1..N+1]": "2*[i]"}
definitions: {x0: 0, "x[N+1]": 0}
equations:
  x[i]'': k[i]*(x[i-1] - x[i]) + k[i+1]*(x[i+1] - x[i])
energy: sum(i, x[i]'**2/2) + sum(i=1..N+1, k[i]*(x[i] - x[i-1])**2/2)
oscillators: ["x[i]"]
"""


def declared(folder, text, name="chain.yaml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_entries_are_made_for_each_index(tmp_path):
    model = registry.load_model(declared(tmp_path, CHAIN))
    assert [*model.coordinates] == ["x1", "x2", "x3", "x4"] == [*model.oscillators]
    assert [c.initial for c in model.coordinates.values()] == pytest.approx([-0.1, 0.0, 0.1, 0.2])
    assert model.coordinates["x3"].meaning == "mass 3 of 4; see [7]"
    assert {name: p.value for name, p in model.parameters.items()} == {f"k{i}": 2.0 * i for i in range(1, 6)}
    values = (
        {f"x{i}": 0.3 * i**2 for i in range(1, 5)} | {"x0": 0.0, "x5": 0.0} | {f"k{i}": 2.0 * i for i in range(1, 6)}
    )
    x = [values[f"x{i}"] for i in range(6)]
    for i, right in enumerate(model.equations.values(), 1):
        expected = 2.0 * i * (x[i - 1] - x[i]) + 2.0 * (i + 1) * (x[i + 1] - x[i])
        assert right.evaluate(values) == pytest.approx(expected, rel=1e-12)
    speeds = {f"x{i}'": 0.5 * i for i in range(1, 5)}
    energy = sum(0.125 * i**2 for i in range(1, 5)) + sum(i * (x[i] - x[i - 1]) ** 2 for i in range(1, 6))
    assert model.energy.evaluate(values | speeds) == pytest.approx(energy, rel=1e-12)


def test_counts_are_replaced_in_all_files_of_an_experiment():
    wanted = Experiment.load(MANY / "chain.yaml", counts={"N": 5})
    names = [f"x{i}" for i in range(1, 6)]
    assert [*wanted.virtual.coordinates] == names == [*wanted.plant.coordinates]
    assert [*wanted.assembly.plant.sensors] == [f"s{i}" for i in range(1, 6)]
    assert wanted.assembly.plant.effects["rub4"].at == ("spring4",)
    assert wanted.assembly.plant.effects["noise"].at == tuple(f"s{i}" for i in range(1, 6))
    assert [*wanted.changed(duration=1).assembly.plant.sensors] == [f"s{i}" for i in range(1, 6)]
    assert len(Experiment.load(MANY / "beam.yaml").virtual.coordinates) == 4


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("i = 1..N]", "i = 1.5..N]", "1.5 is 1.5, not an integer"),
        ("[N = 4, i = 1..N]", "i", "'i' is neither a count nor a range; write 'repeat: i = 1..50'"),
        ("[N = 4, i = 1..N]", "[N = 4, N = 5, i = 1..N]", "'N' stands here twice; give it another name"),
        ("[N = 4, i = 1..N]", "[N = 4, i = 1..n]", "unknown symbol 'n'; did you mean 'N'?"),
        ("[N = 4, i = 1..N]", "[N = 5/2, i = 1..N]", "5/2 is 2.5, not an integer"),
        ("[N = 4, i = 1..N]", "[N = 4, i = 9..N]", "the range 9..4 ends before it begins"),
        ("[N = 4, i = 1..N]", "[N = 4, i = 1..10**6]", "the repetition makes more than 100000 entries"),
        ("k[i]*(x[i-1]", "k[j]*(x[i-1]", "[j]: 'j' is neither an index nor a count"),
        ("x[i-1] - x[i])", "x[i-2] - x[i])", "[i-2] is -1 for i = 1; names end in 0 or more; shorten the range"),
        ("sum(i, x[i]'", "sum(k, x[i]'", "sum: 'k' is no index"),
        (
            "energy: sum(i, x[i]'**2/2)",
            "energy: x[i]'**2/2",
            "[i]: the index i has no value here; write the index into",
        ),
        ("equations:", "equations:\n  x2'': 0", "the key 'x2''' is made twice; the first is in line 7"),
    ],
)
def test_what_is_wrong_with_an_index_is_said_with_its_place(tmp_path, old, new, said):
    assert old in CHAIN
    path = declared(tmp_path, CHAIN.replace(old, new, 1))
    with pytest.raises(DeclarationError) as caught:
        registry.load_model(path)
    problem = caught.value.problems[0]
    assert said in str(problem)
    assert re.match(re.escape(str(path)) + r":\d+:\d+: ", str(problem))


@pytest.mark.parametrize(("name", "part"), [("pendula_beam", "lagrangian"), ("duffing_chain", "energy")])
def test_the_size_of_what_is_made_is_counted_in_operations(name, part):
    """Two hundred coordinates make a text that nobody would write; a thousand are refused with the place of the sum."""
    made = getattr(load_model(MANY / f"{name}.yaml", {"N": 200}).declaration, part)
    assert len(made.text) > 10_000 > len(made.steps)
    with pytest.raises(
        DeclarationError, match=rf"{name}\.yaml:\d+:\d+: {part}: .* operations and operands, more than 10000"
    ):
        load_model(MANY / f"{name}.yaml", {"N": 1000})


def interpreted(kernels, name):
    """Return a function of a generated module ; its machine code is straight-line."""
    return getattr(kernels, name)


def test_frequencies_of_a_chain_are_those_of_its_closed_form(tmp_path):
    """N equal masses between two walls have the frequencies 2 sqrt(k/m) sin(j pi/(2 (N + 1)))."""
    n, stiffness, mass = 40, 3.0, 0.5
    text = CHAIN.replace('{"k[i=1..N+1]": "2*[i]"}', f"{{m: {mass}, k: {stiffness}}}").replace("k[i+1]", "k")
    text = text.replace("k[i]", "k").replace("  x[i]'':", "  m*x[i]'':").replace("x[i]'**2/2)", "m*x[i]'**2/2)")
    model = load_model(declared(tmp_path, text), {"N": n})
    derivative, p = interpreted(model.kernels, "derivative"), model.values()
    stiff = np.empty((n, n))
    for i in range(n):
        rate = np.empty(2 * n)
        derivative(0.0, np.eye(2 * n)[i], np.zeros(0), p, rate)
        stiff[:, i] = -rate[n:]
    expected = 2.0 * np.sqrt(stiffness / mass) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    np.testing.assert_allclose(np.sqrt(np.linalg.eigvalsh(stiff)), expected, rtol=1e-12)


LARGE = (("chain", 100), ("beam", 30))


@pytest.mark.parametrize("n", [12, pytest.param(30, marks=pytest.mark.search)])
def test_pendula_on_a_beam_keep_their_energy(n):
    model = load_model(MANY / "pendula_beam.yaml", {"N": n})
    derivative, energy, p = (
        interpreted(model.kernels, "derivative"),
        interpreted(model.kernels, "energy"),
        model.values(),
    )

    def rate(t, y):
        dy = np.empty(len(y))
        assert called(fault)(derivative(t, y, np.zeros(0), p, dy), 1.0) == REACHED
        return dy

    run = scipy.integrate.solve_ivp(rate, (0.0, 1.0), model.initial_state({}), "DOP853", rtol=1e-11, atol=1e-12)
    size = len(model.coordinates)
    values = [energy(0.0, y[:size], y[size:], p) for y in run.y.T]
    assert np.ptp(values) < 1e-9 * abs(values[0] + model.parameter_values()["m"] * 9.81 * 0.25)
    assert np.ptp(run.y[0]) > 0.1


@pytest.mark.parametrize(
    ("name", "n"), [("chain", 30), ("beam", 12), *(pytest.param(*large, marks=pytest.mark.search) for large in LARGE)]
)
def test_many_coordinates_are_masked(name, n):
    """The whole control law, with matrices of this size, makes the rig move as the virtual system."""
    wanted = Experiment.load(MANY / f"{name}.yaml", counts={"N": n})
    loop, size = wanted.loop, len(wanted.plant.coordinates)
    transform, derivative = (interpreted(loop.kernels, part) for part in ("transform", "derivative"))
    ideal, p, q = interpreted(wanted.virtual.kernels, "derivative"), loop.values(), wanted.virtual.values()
    mapped, first = np.empty(2 * size), [0.0]

    def rig(t, y):
        dy = np.empty(len(y))
        health = derivative(t, y, np.zeros(size), p, dy)
        first[0] = first[0] or health
        assert called(fault)(health, first[0]) == REACHED
        return dy

    def free(t, y):
        dy = np.empty(len(y))
        ideal(t, y, np.zeros(0), q, dy)
        return dy

    slope = np.diag(loop.controller.driven)
    start = wanted.virtual_start
    moved = np.concatenate([start[:size] / slope, start[size:] / slope / wanted.time_scale])
    times = np.linspace(0.0, 2.0, 21)
    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
    virtual = scipy.integrate.solve_ivp(free, (0.0, 2.0), start, t_eval=times, **options).y[:size].T
    seconds = times * wanted.time_scale
    path = scipy.integrate.solve_ivp(rig, (0.0, seconds[-1]), moved, t_eval=seconds, **options).y
    found = []
    for t, y in zip(seconds, path.T, strict=True):
        transform(t, y[:size], y[size:], p, mapped)
        found.append(mapped[:size].copy())
    columns = zip(np.array(found).T, virtual.T, strict=True)
    assert max(masking_error(one, other) for one, other in columns) <= 1e-6


@pytest.mark.parametrize(
    ("right", "indices", "counts", "most"),
    [
        ("c*(x[i-1] - 2*x[i] + x[i+1]) - x[i]**3", "i = 1..N", (100, 400), 10.0),
        ("c*sum(j, x[j] - x[i]) - x[i]**3 + x0 + x[N+1]", "i = 1..N, j = 1..N", (30, 60), 5.0),
    ],
    ids=["chain", "all to all"],
)
def test_to_check_takes_as_long_as_there_are_terms(tmp_path, right, indices, counts, most):
    """There are four times as many; calls of functions are counted, which no other process changes."""
    calls = []
    for count in (3, *counts):  # the first loads packages
        head = f"repeat: [N = {count}, {indices}]\ncoordinates: {{'x[i]': displacement}}\nparameters: {{c: 1}}\n"
        text = f"{head}definitions: {{x0: 0, 'x[N+1]': 0}}\nequations:\n  x[i]'': {right}\n"
        path = declared(tmp_path, text)
        profile = cProfile.Profile()
        profile.runcall(lambda path=path: load_model(path).validate())
        calls.append(pstats.Stats(profile).total_calls)
    assert calls[2] < most * calls[1]
