"""Where motions settle, and what holds of chaotic ones that have parted: against scipy, algebra and literature."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import ks_2samp

from masking.analysis.stability.attractors import Parting, _distances, parting
from masking.model.modelling.model import load_model

MODELS = {
    "ueda": ("B*cos(t) - k*x' - x**3", {"B": 7.5, "k": 0.05}),
    "duffing": ("F*cos(w*t) - 2*z*x' - x - b*x**3", {"F": 0.3, "w": 1.3, "z": 0.05, "b": 0.25}),
    "wells": ("x - x**3 - d*x'", {"d": 0.15}),
    "spring": ("-x - x**3", {}),
    "van_der_pol": ("(1 - x**2)*x' - x", {}),
}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Models by name, each with one coordinate x."""
    folder, found = tmp_path_factory.mktemp("models"), {}
    for name, (force, values) in MODELS.items():
        path = folder / f"{name}.yaml"
        given = "".join(f"  {key}: {{value: {x}}}\n" for key, x in values.items())
        text = f'name: {name}\ncoordinates: {{x: {{initial: 1}}}}\nequations: {{"x\'\'": "{force}"}}\n'
        path.write_text(text + (f"parameters:\n{given}" if given else ""))
        found[name] = load_model(path)
    return found


def simulated(name: str, start: tuple[float, float], times: np.ndarray) -> np.ndarray:
    """States (m, 2) by scipy, of the equation evaluated by Python."""
    force, values = MODELS[name]
    code = compile(force.replace("x'", "v"), name, "eval")

    def rate(t, y):
        return [y[1], eval(code, {"cos": np.cos, "t": t, "x": y[0], "v": y[1], **values})]  # noqa: S307  # our own text

    found = solve_ivp(rate, (times[0], times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853")
    return found.y.T


def met(models, name: str, made: tuple[float, float], wanted: tuple[float, float], length: float) -> Parting:
    times = np.linspace(0.0, length, round(20 * length) + 1)
    return parting(models[name], times, simulated(name, made, times), simulated(name, wanted, times))


def test_chaotic_motions_part_as_their_exponent_says(models):
    """Ueda's oscillator: 0.1034 (Sprott, 2003, A.4.5)."""
    found = met(models, "ueda", (2.5 + 1e-6, 0.0), (2.5, 0.0), 300.0).chaos
    assert found.exponent == pytest.approx(0.1034, abs=0.015)
    assert found.along == pytest.approx(0.1034, abs=0.03)
    assert found.is_alike
    assert found.distribution < 0.25  # of 24 periods of the drive
    # Each motion has an exponent of its own over so short a time: a difference of 1e-6 needs 13 e-folds.
    assert 0.4 * found.predicted < found.time < 2.0 * found.predicted
    assert found.predicted == pytest.approx(np.log(0.5 / found.first) / found.exponent)


def test_a_motion_of_another_distribution_is_not_that_of_the_chaotic_system(models):
    times = np.linspace(0.0, 300.0, 6001)
    wanted = simulated("ueda", (2.5, 0.0), times)
    other = np.column_stack([2.0 * np.cos(times), -2.0 * np.sin(times)])
    found = parting(models["ueda"], times, other, wanted).chaos
    assert found is None or not found.is_alike


def test_distances_are_those_of_scipy():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(500, 2)), rng.normal(0.2, 1.3, size=(300, 2))
    assert [*_distances(a, b)] == pytest.approx([ks_2samp(a[:, i], b[:, i]).statistic for i in (0, 1)])


def test_two_motions_of_a_driven_duffing_oscillator_are_told_by_amplitude_and_period(models):
    found = met(models, "duffing", (1.5, 0.0), (1.0, 0.0), 200.0)
    times = np.linspace(0.0, 600.0, 60001)
    for one, start in ((found.wanted, (1.0, 0.0)), (found.reached, (1.5, 0.0))):
        last = simulated("duffing", start, times)[-10000:, 0]
        assert one.kind == "periodic"
        assert one.period == pytest.approx(2.0 * np.pi / 1.3, rel=1e-5)
        assert one.amplitude["x"] == pytest.approx(0.5 * np.ptp(last), rel=1e-4)
        assert one.middle["x"] == pytest.approx(0.0, abs=1e-6)
    # The first harmonic alone: ((1 - w^2 + 3 b a^2/4)^2 + (2 z w)^2) a^2 = F^2 (Nayfeh and Mook, 1979, section 4.1).
    bend, off = 0.75 * 0.25, 1.0 - 1.3**2
    square = np.roots([bend**2, 2.0 * off * bend, off**2 + (2 * 0.05 * 1.3) ** 2, -(0.3**2)])
    low, _, high = np.sort(np.sqrt(square.real))
    assert found.wanted.amplitude["x"] == pytest.approx(low, rel=0.01)
    assert found.reached.amplitude["x"] == pytest.approx(high, rel=0.02)
    assert not found.is_same


def test_rest_in_another_well_is_another_attractor(models):
    found = met(models, "wells", (2.0, 0.0), (1.8, 0.0), 100.0)
    assert (found.wanted.kind, found.reached.kind) == ("rest", "rest")
    assert found.wanted.middle["x"] == pytest.approx(1.0, abs=1e-6)
    assert found.reached.middle["x"] == pytest.approx(-1.0, abs=1e-6)
    assert found.as_dict({"x": 0.5})["reached"]["middle"]["x"] == pytest.approx(-2.0, abs=1e-6)


def test_a_phase_on_one_limit_cycle_is_no_other_attractor(models):
    """Period 6.6633 of van der Pol's oscillator (Andersen and Geer, 1982), amplitude 2.0086."""
    found = met(models, "van_der_pol", (0.5, 0.0), (-0.5, 1.0), 60.0)
    assert found.is_same
    assert found.wanted.period == pytest.approx(6.66329, abs=1e-4)
    assert found.reached.amplitude["x"] == pytest.approx(2.00862, abs=1e-3)


def test_two_ways_to_one_rest_are_two_motions(models):
    """That one decays otherwise than it should is no matter of phase."""
    assert met(models, "wells", (1.4, 0.0), (1.2, 0.0), 100.0).as_dict({"x": 1.0}) == {}
    ends = [simulated("wells", (start, 0.0), np.linspace(0.0, 300.0, 301))[-1] for start in (1.2, 1.4)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-6), "both come to rest in the same well"


def test_motions_that_nothing_attracts_are_not_named(models):
    assert met(models, "spring", (1.0, 0.0), (0.8, 0.0), 100.0).as_dict({"x": 1.0}) == {}


def test_a_motion_that_has_not_settled_where_it_would_is_not_named(models):
    times = np.linspace(0.0, 100.0, 2001)
    wanted, made = (simulated("wells", start, times) for start in ((1.8, 0.0), (2.0, 0.0)))
    made[-400:, 0] += 0.5  # held aside by something else
    assert parting(models["wells"], times, made, wanted).as_dict({"x": 1.0}) == {}


def test_motions_whose_further_course_meets_a_singular_mass_are_not_named(tmp_path):
    path = tmp_path / "singular.yaml"
    path.write_text('name: singular\ncoordinates: {x: {}}\nequations: {"(2 - x)*x\'\'": "1 - x\'/10"}\n')
    times = np.linspace(0.0, 0.5, 101)
    states = np.column_stack([times**2 / 4.0, times / 2.0])
    assert parting(load_model(path), times, 2.0 * states, states) == Parting()


def test_a_motion_that_takes_too_many_steps_is_not_followed_on(models):
    """Of a record over ten million periods, nine times of which would take hours; a shorter one is followed."""
    times = np.linspace(0.0, 2e7 * np.pi, 201)
    made, wanted = np.column_stack([np.cos(times), -np.sin(times)]), np.column_stack([np.sin(times), np.cos(times)])
    assert parting(models["van_der_pol"], times, made, wanted) == Parting()
    assert met(models, "van_der_pol", (2.0, 0.1), (1.9, 0.3), 100.0).is_same
