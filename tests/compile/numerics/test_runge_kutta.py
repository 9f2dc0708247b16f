"""Integrators: closed forms, theory's orders, conserved energy, scipy's own method; and how each gives up."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.special
from scipy.integrate._ivp import dop853_coefficients as theirs

from masking.compile.codegen import module_store
from masking.compile.codegen.compiled_functions import InPieces
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.taylor_coefficients import Dynamics
from masking.compile.numerics import dop853_coefficients, runge_kutta, taylor_integrator
from masking.compile.numerics.stop_codes import NOT_FINITE, REACHED
from masking.errors import IntegrationError, SingularityError
from masking.model.declaration import registry
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model

# One equation for all closed forms: harmonic oscillator (w), pendulum (k), x'' = 2 c x^3 (c), and a mass that
# vanishes at x = 1/m.
PARAMETERS = ("w", "k", "c", "m", "f")
TESTBED = {
    "coordinates": {"x": {"initial": 0}},
    "parameters": dict.fromkeys(PARAMETERS, 0),
    "equations": {"(1 - m*x)*x''": "-w**2*x - k*sin(x) + 2*c*x**3 + f"},
}
ORDERS = (4, 8, 14)


@pytest.fixture(scope="module")
def testbed(declared):
    """Return the model's kernels, and with them `taylor_4`, `taylor_8`, `taylor_14` and `classical_4`."""
    model = declared(**TESTBED)
    found = {"runge_kutta": model.kernels.solve_runge_kutta, "taylor": model.kernels.solve_taylor}
    lowered = LoweredEquations.of(model.equations, Graph())
    s = model.equations.symbols
    states = [lowered.symbols[x] for x in (*s.q, *s.v)]
    loads = {**lowered.loads("y[{i}]", "y[{i}]"), "v_x": "y[1]"}
    for order in ORDERS:
        module = Module("test", {})
        derivatives = [states[1], *lowered.accelerations]
        dynamics = Dynamics(lowered.graph, lowered.symbols[s.t], states, derivatives, lowered.health, loads)
        module.add_coefficients(dynamics, {"": order})
        module.add_factory("solve", taylor_integrator.taylor, "coefficients", order, 2, work=(order + 1, 2))
        found[f"taylor_{order}"] = compiled(module, "solve")
    module = Module("test", {})
    results = [("dy[0]", states[1]), ("dy[1]", lowered.accelerations[0])]
    module.add("derivative(t: float, y, u, p, dy)", lowered.graph, results, loads)
    module.add_factory("advance", runge_kutta.steps_of_runge_kutta_4, "derivative", 2, work=(5, 2))
    advance = compiled(module, "advance")

    def classical(t, y, times, u, p, tolerance, fixed_step, out):  # noqa: PLR0917  (the arguments of all kernels)
        steps = round((times[-1] - t) / fixed_step)
        advance(t, y, u, p, steps * fixed_step, steps)
        out[-1] = y
        return 0, times[-1], steps

    found["classical_4"] = classical
    return SimpleNamespace(model=model, methods=found)


def compiled(module, name):
    """Return a function of a module."""
    return module_store.load(module_store.key({"test": module.text(), "for": name}), lambda: module).function(name)


def parameters(**values):
    return np.array([float(values.get(name, 0.0)) for name in PARAMETERS])


def solve(method, y0, times, p, *, tolerance=1e-12, fixed_step=0.0, start=None):
    """Return status, time reached, steps and the states at `times`."""
    times = np.asarray(times, dtype=float)
    y, out = np.array(y0, dtype=float), np.full((len(times), len(y0)), np.nan)
    start = float(times[0]) if start is None else start
    status, reached, steps = method(start, y, times, np.zeros(0), p, tolerance, fixed_step, out)
    return SimpleNamespace(status=status, reached=reached, steps=steps, states=out, last=y)


def pendulum(times, top):
    """Return angle and rate of x'' = -sin x from rest at `top`: sin(x/2) = k sn(K - t, k), k = sin(top/2)."""
    k = math.sin(top / 2)
    sn, cn, _, _ = scipy.special.ellipj(scipy.special.ellipk(k**2) - np.asarray(times), k**2)
    return np.stack([2 * np.arcsin(k * sn), -2 * k * cn], axis=-1)


HARMONIC = (parameters(w=1), [1.0, 0.0], lambda t: np.stack([np.cos(t), -np.sin(t)], axis=-1))
PENDULUM = (parameters(k=1), [2.0, 0.0], lambda t: pendulum(t, 2.0))
# x'' = 2 x^3 from x = x' = 1 is 1/(1 - t)
POLE = (parameters(c=1), [1.0, 1.0], lambda t: np.stack([1 / (1 - t), 1 / (1 - t) ** 2], axis=-1))


# The numbers of steps keep the error between 1e-3 and 3e-13: above that the next order shows, below it rounding.
# The oscillator's next term is small and the slope is plain to see.
@pytest.mark.parametrize(
    ("method", "order", "counts"),
    [
        ("classical_4", 4, (32, 64, 128, 256)),
        ("taylor_4", 4, (32, 64, 128, 256)),
        ("runge_kutta", 8, (8, 10, 12, 16, 20, 24)),
        ("taylor_8", 8, (8, 12, 16, 24, 32)),
        ("taylor_14", 14, (2, 3, 4, 5)),
    ],
)
def test_the_error_on_an_oscillator_falls_with_the_order_of_theory(testbed, method, order, counts):
    assert observed_order(testbed.methods[method], HARMONIC, 5.0, counts, corrections=0) == pytest.approx(
        order, abs=0.1
    )


# On a non-linear problem the error is C n^-p (1 + a/n + b/n^2 ...) over n steps, and so near to rounding the
# corrections still count: they are fitted along with the order. Plain slopes of order 14 would still be 2 off.
@pytest.mark.parametrize(
    ("method", "order", "end", "counts", "corrections"),
    [
        ("classical_4", 4, 0.5, (8, 16, 32, 64, 128), 1),
        ("taylor_4", 4, 0.5, (8, 16, 32, 64, 128), 1),
        ("runge_kutta", 8, -2.0, range(8, 41), 2),
        ("taylor_8", 8, 0.5, range(3, 37), 1),
        ("taylor_14", 14, 0.6, range(4, 11), 1),
    ],
)
def test_the_error_on_a_pole_falls_with_the_order_of_theory(testbed, method, order, *, end, counts, corrections):
    found = observed_order(testbed.methods[method], POLE, end, counts, corrections)
    assert found == pytest.approx(order, abs=0.1)


def observed_order(method, case, end, counts, corrections):
    p, y0, exact = case
    errors = []
    for count in counts:
        run = solve(method, y0, [0.0, end], p, fixed_step=abs(end) / count)
        assert (run.status, run.steps) == (REACHED, count)
        errors.append(np.linalg.norm(run.states[-1] - exact(end)) / np.linalg.norm(exact(end)))
    assert min(errors) > 3e-13
    assert max(errors) < 1e-3
    n = np.array(counts, dtype=float)
    columns = [np.ones_like(n), -np.log(n), *(n ** -(k + 1) for k in range(corrections))]
    return np.linalg.lstsq(np.stack(columns, axis=1), np.log(errors), rcond=None)[0][1]


@pytest.mark.parametrize("part", [0.2, 0.5, 0.83])
def test_the_dense_output_of_runge_kutta_has_order_7(testbed, part):
    # Order 7 is a local error of h^8: one step, looked at on the way.
    p, y0, exact = HARMONIC
    lengths = np.array([0.6, 0.7, 0.85, 1.0, 1.2])
    errors = []
    for h in lengths:
        run = solve(testbed.methods["runge_kutta"], y0, [0.0, part * h, h], p, fixed_step=h)
        assert run.steps == 1
        errors.append(np.linalg.norm(run.states[1] - exact(part * h)))
    assert np.polyfit(np.log(lengths), np.log(errors), 1)[0] > 8 - 0.1


@pytest.mark.parametrize("method", ["taylor", "runge_kutta"])
@pytest.mark.parametrize(
    ("case", "end"), [(HARMONIC, 50.0), (PENDULUM, 50.0), (POLE, 0.9), (POLE, -20.0)], ids=["w", "k", "c", "back"]
)
def test_controlled_steps_follow_closed_forms_at_every_asked_time(testbed, method, case, end):
    p, y0, exact = case
    times = np.linspace(0.0, end, 501)
    run = solve(testbed.methods[method], y0, times, p)
    assert run.status == REACHED
    np.testing.assert_allclose(run.states, exact(times), rtol=0, atol=1e-9 * np.abs(exact(times)).max())


def test_a_series_with_gaps_is_not_taken_for_one_that_has_ended(declared):
    # x'' = -x^7 from (0, 1): the series has terms of order 1, 9, 17 ..., none of the last two that set the step.
    model = declared(
        coordinates={"x": {"initial": 0, "initial_velocity": 1}},
        equations={"x''": "-x**7"},
        energy="x'**2/2 + x**8/8",
    )
    assert model.kernels.meta["method"] == "taylor"
    found = model.simulate(np.linspace(0.0, 30.0, 301))
    energy = found["x'"] ** 2 / 2 + found["x"] ** 8 / 8
    np.testing.assert_allclose(energy, 0.5, rtol=1e-8)


@pytest.mark.parametrize("method", ["taylor", "runge_kutta"])
@pytest.mark.parametrize(("name", "undamped"), [("duffing", {"z3": 0}), ("huygens", {"z": 0})])
def test_energy_is_kept_and_time_runs_back(name, undamped, method):
    model = Model(registry.load_model(name)).with_parameters(**undamped)
    start, p, none = model.initial_state({}), model.values(), np.zeros(0)
    n = len(model.coordinates)
    forward = model.kernels.integrate(np.linspace(0.0, 1000.0, 201), start, none, p, tolerance=1e-14, method=method)
    energies = [model.kernels.energy(0.0, y[:n], y[n:], p) for y in forward.states]
    np.testing.assert_allclose(energies, energies[0], rtol=1e-9)
    there = model.kernels.integrate(np.array([0.0, 100.0]), start, none, p, tolerance=1e-14, method=method)
    back = model.kernels.integrate(
        np.array([100.0, 50.0, 0.0]), there.states[-1], none, p, tolerance=1e-14, method=method
    )
    np.testing.assert_allclose(back.states[-1], start, rtol=0, atol=1e-8)
    half = there_and(model, start, 50.0, method)
    np.testing.assert_allclose(back.states[1], half, rtol=0, atol=1e-8)


def there_and(model, start, time, method):
    p = model.values()
    return model.kernels.integrate(np.array([0.0, time]), start, np.zeros(0), p, tolerance=1e-13, method=method).states[
        -1
    ]


def test_both_methods_agree_with_scipy():
    model = Model(registry.load_model("huygens"))
    p, y0, times = model.values(), model.initial_state({}), np.linspace(0.0, 100.0, 101)

    def derivative(t, y):
        dy = np.empty(6)
        model.kernels.derivative(t, y, np.zeros(0), p, dy)
        return dy

    truth = scipy.integrate.solve_ivp(derivative, (0.0, 100.0), y0, "DOP853", times, rtol=1e-12, atol=1e-14).y.T
    for method in ("taylor", "runge_kutta"):
        found = model.kernels.integrate(times, y0, np.zeros(0), p, tolerance=1e-12, method=method)
        np.testing.assert_allclose(found.states, truth, rtol=0, atol=1e-9)


def test_the_coefficients_are_those_of_scipy():
    for ours, name in (
        (dop853_coefficients.A, "A"),
        (dop853_coefficients.C, "C"),
        (dop853_coefficients.E3, "E3"),
        (dop853_coefficients.E5, "E5"),
        (dop853_coefficients.D, "D"),
    ):
        theirs_padded = np.zeros_like(ours)
        their = getattr(theirs, name)
        theirs_padded[tuple(slice(n) for n in their.shape)] = their
        np.testing.assert_allclose(ours, theirs_padded, rtol=1e-15, atol=0)


def test_the_coefficients_satisfy_the_order_conditions():
    # Hairer, Norsett and Wanner (1993): (II.1.9) c_i = sum_j a_ij, (II.5.20) sum_i b_i c_i^(k-1) = 1/k, (II.1.10).
    np.testing.assert_allclose(dop853_coefficients.A.sum(axis=1), dop853_coefficients.C, rtol=0, atol=1e-13)
    b, c = dop853_coefficients.A[12, :12], dop853_coefficients.C[:12]
    for k in range(1, 9):
        assert b @ c ** (k - 1) == pytest.approx(1 / k, abs=1e-14)
    a = dop853_coefficients.A[:12, :12]
    assert b @ a @ c == pytest.approx(1 / 6, abs=1e-14)
    assert b @ (c * (a @ c)) == pytest.approx(1 / 8, abs=1e-14)
    assert b @ a @ a @ a @ c == pytest.approx(1 / 120, abs=1e-14)
    # errors of exact polynomials vanish: of an estimate of order 3 up to c^2, of order 5 up to c^4
    for weights, order in ((dop853_coefficients.E3, 3), (dop853_coefficients.E5, 5)):
        for k in range(order):
            assert weights @ dop853_coefficients.C[:13] ** k == pytest.approx(0.0, abs=1e-13)


@pytest.mark.parametrize("method", ["taylor", "runge_kutta"])
class TestGivingUp:
    def test_a_solution_that_ends_in_finite_time_says_when(self, testbed, method):
        # the step vanishes, unless the series of sin(x), which the equation holds, overflows first
        with pytest.raises(
            IntegrationError, match=r"(ends in finite time or jumps|finite numbers), at t = 1 \(x = "
        ) as caught:
            self.integrate(testbed, method, [0.0, 2.0], [1.0, 1.0], parameters(c=1))
        assert not isinstance(caught.value, SingularityError)

    def test_a_mass_that_vanishes_on_the_way_says_where(self, testbed, method):
        # (1 - x) x'' = f from (0, 1): x' grows like the root of a logarithm and x reaches 1 before t = 1
        with pytest.raises(SingularityError, match=r"became singular at t = 0\.") as caught:
            self.integrate(testbed, method, [0.0, 5.0], [0.0, 1.0], parameters(m=1, f=0.5))
        assert caught.value.state["x"] == pytest.approx(1.0, abs=1e-6)
        assert 0.5 < caught.value.time < 1.0

    def test_a_mass_that_would_vanish_further_on_does_no_harm(self, testbed, method):
        # (1 - x) x'' = -1/4 keeps v^2/2 + ln(1/(1 - x))/4
        run = self.run(testbed, method, [0.0, 1.0], [0.0, 1.0], parameters(m=1, f=-0.25))
        x, v = run.states[-1]
        assert v**2 / 2 + math.log(1 / (1 - x)) / 4 == pytest.approx(0.5, rel=1e-9)

    def test_a_mass_that_is_zero_at_the_start_is_singular(self, testbed, method):
        with pytest.raises(SingularityError, match=r"at t = 0 \(x = 1, x' = 0\)"):
            self.integrate(testbed, method, [0.0, 1.0], [1.0, 0.0], parameters(m=1, f=1))

    @pytest.mark.parametrize("name", PARAMETERS)
    def test_a_parameter_that_is_no_number_is_not_called_singular(self, testbed, method, name):
        p = parameters(w=1)
        p[PARAMETERS.index(name)] = math.nan
        with pytest.raises(IntegrationError, match="no longer finite numbers, at t = 0"):
            self.integrate(testbed, method, [0.0, 1.0], [0.5, 0.0], p)

    def test_a_state_that_is_no_number_is_found_at_once(self, testbed, method):
        with pytest.raises(IntegrationError, match="no longer finite numbers, at t = 0"):
            self.integrate(testbed, method, [0.0, 1.0], [math.nan, 0.0], parameters(w=1))

    def test_fixed_steps_do_not_run_on_without_numbers(self, testbed, method):
        run = solve(testbed.methods[method], [math.nan, 0.0], [0.0, 1.0], parameters(w=1), fixed_step=0.1)
        assert run.status == NOT_FINITE

    def test_no_times_are_no_steps(self, testbed, method):
        run = solve(testbed.methods[method], [1.0, 0.0], [], parameters(w=1), start=0.0)
        assert (run.status, run.reached, run.steps) == (REACHED, 0.0, 0)

    def test_one_time_is_the_initial_state(self, testbed, method):
        run = solve(testbed.methods[method], [1.0, 0.0], [3.0], parameters(w=1))
        assert (run.status, run.reached, run.steps) == (REACHED, 3.0, 0)
        np.testing.assert_array_equal(run.states, [[1.0, 0.0]])

    def test_equal_times_get_equal_states(self, testbed, method):
        run = solve(testbed.methods[method], [1.0, 0.0], [0.0, 0.0, 1.0, 1.0, 2.0, 2.0], parameters(w=1))
        np.testing.assert_array_equal(run.states[::2], run.states[1::2])
        np.testing.assert_allclose(run.states[-1], [math.cos(2.0), -math.sin(2.0)], atol=1e-11)

    def test_a_state_at_rest_stays(self, testbed, method):
        run = solve(testbed.methods[method], [0.0, 0.0], [0.0, 1e6], parameters(w=1))
        np.testing.assert_array_equal(run.states[-1], [0.0, 0.0])

    def test_pieces_make_no_difference_beyond_the_tolerance(self, testbed, method):
        times, done = np.linspace(0.0, 10.0, 101), []
        whole = self.run(testbed, method, times, [2.0, 0.0], parameters(k=1))
        parts = self.run(testbed, method, times, [2.0, 0.0], parameters(k=1), pieces=InPieces(7, done.append))
        np.testing.assert_allclose(parts.states, whole.states, atol=1e-10)
        assert len(done) == 7
        assert done == sorted(done)
        assert done[-1] == 1.0

    @staticmethod
    def run(testbed, method, times, y0, p, **options):
        kernels = testbed.model.kernels
        return kernels.integrate(
            np.array(times), np.array(y0), np.zeros(0), p, tolerance=1e-12, method=method, **options
        )

    integrate = run
