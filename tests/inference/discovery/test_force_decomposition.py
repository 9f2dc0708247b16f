"""Where a model lacks something: forces in closed form along known motions, white and other noise, and a real rig."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate

from masking.control.rig.twin import Twin
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.discovery_result import Discovery, Named, SimulationError
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.force_decomposition import decompose, followed, harmonics, period
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.search import SearchResult
from masking.inference.discovery.smoothing import smooth
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.whiteness import autocorrelation, evenness, ljung_box, whiteness
from masking.reports import discovery_page, discovery_text, place_text
from masking.reports.discovery_files import Origin
from tests.app.workflows.test_discover import PLANT

RATE = 1000.0
LINES = np.arange(1, 60, 2)


def multisine(seconds, seed=0, lines=LINES, cycle=20.0):
    """Return a displacement and its rate: a few millimetres, up to 3 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    w, phase = 2.0 * np.pi * lines / cycle, rng.uniform(0.0, 2.0 * np.pi, len(lines))
    x, rate = np.zeros(len(t)), np.zeros(len(t))
    for one, start in zip(w, phase, strict=True):
        x += 4e-4 * np.sin(one * t + start)
        rate += 4e-4 * one * np.cos(one * t + start)
    return x, rate


X, V = multisine(60.0)


def jenkins(x, k, fc):
    """Return the force of a spring in line with a slider (m,)."""
    force = np.zeros(len(x))
    for i in range(1, len(x)):
        force[i] = np.clip(force[i - 1] + k * (x[i] - x[i - 1]), -fc, fc)
    return force


def dahl(x, fc, x0):
    """Return Dahl's friction (m,), exactly along straight pieces of the motion."""
    z = np.zeros(len(x))
    for i in range(1, len(x)):
        step = x[i] - x[i - 1]
        z[i] = np.sign(step) + (z[i - 1] - np.sign(step)) * np.exp(-abs(step) / x0)
    return fc * z


# force, parts that follow displacement, rate, both together and neither, and the odd part
FORCES = {
    "spring": (100.0 * X, (1, 0, 0, 0), 1.0),
    "damper": (3.0 * V, (0, 1, 0, 0), 1.0),
    "Coulomb": (0.05 * np.sign(V), (0, 1, 0, 0), 1.0),
    "cubic": (1e6 * X**3, (1, 0, 0, 0), 1.0),
    "quadratic": (1e4 * X**2, (1, 0, 0, 0), 0.0),
    "offset": (np.full(len(X), 0.01), (1, 0, 0, 0), 0.0),
    "drag": (100.0 * V * np.abs(V), (0, 1, 0, 0), 1.0),
    # max(x, 0) = x/2 + |x|/2
    "contact on one side": (100.0 * np.maximum(X, 0.0), (1, 0, 0, 0), 0.5),
    # 3/4 of the sign and 1/4 of its square: squares as 9 to 1
    "friction of two sizes": (np.where(V > 0.0, 1.0, -0.5), (1 / 10, 9 / 10, 0, 0), 0.9),
}


@pytest.mark.parametrize("name", FORCES)
def test_parts_of_the_energy(name):
    force, truth, odd = FORCES[name]
    parts = decompose(X, V, force).energy
    assert (parts.displacement, parts.rate, parts.both, parts.neither) == pytest.approx(truth, abs=0.03)
    assert parts.odd == pytest.approx(odd, abs=0.03)
    told = parts.as_dict()
    assert sum(told[n] for n in ("displacement", "rate", "both", "neither")) == pytest.approx(1.0)


def test_what_follows_displacement_and_rate_together():
    # x^2 v less its best function of the rate: a share that depends on neither alone
    force = X**2 * V
    parts = decompose(X, V, force).energy
    alone = np.mean(X**2 * V**2) ** 2 / np.mean(V**2) / np.mean(force**2)  # of a damper, the best straight one
    assert parts.rate == pytest.approx(alone, abs=0.1)
    assert parts.rate + parts.both > 0.97
    assert parts.odd > 0.99


@pytest.mark.parametrize("force", [jenkins(X, 100.0, 0.05), dahl(X, 0.05, 1e-3)], ids=["Jenkins", "Dahl"])
def test_a_memory_follows_neither(force):
    found = decompose(X, V, force)
    assert found.energy.neither > 0.12
    assert found.loss > 0.0
    assert found.energy.odd > 0.95


def test_what_does_not_follow_the_motion_follows_neither():
    t = np.arange(len(X)) / RATE
    parts = decompose(X, V, np.sin(2.0 * np.pi * 0.7123 * t)).energy
    assert parts.neither > 0.9
    assert parts.odd is None
    # of another multisine on other lines, which repeats itself as the motion does
    parts = decompose(X, V, multisine(60.0, seed=5, lines=np.arange(2, 60, 2))[0], cycle=20000).energy
    assert parts.neither > 0.9


def test_noise_is_no_energy():
    rng = np.random.default_rng(0)
    force = 100.0 * X
    noise = 0.5 * force.std() * rng.standard_normal(len(X))
    found = decompose(X, V, force + noise, 0.5 * force.std())
    assert found.energy.displacement == pytest.approx(1.0, abs=0.03)
    nothing = decompose(X, V, noise, 0.5 * force.std())
    assert nothing.energy is None
    assert nothing.regions == {}


def test_losses_are_those_of_the_laws():
    x, v = multisine(20.0)  # one whole period
    assert decompose(x, v, 100.0 * x).loss_part == pytest.approx(0.0, abs=1e-9)
    assert decompose(x, v, 1e6 * x**3).loss_part == pytest.approx(0.0, abs=1e-3)
    viscous = decompose(x, v, 3.0 * v)
    assert viscous.loss == pytest.approx(3.0 * np.mean(v**2), rel=1e-3)
    assert viscous.loss_part == pytest.approx(1.0)
    assert decompose(x, v, 0.05 * np.sign(v)).loss == pytest.approx(0.05 * np.mean(np.abs(v)), rel=1e-3)
    assert decompose(x, v, -3.0 * v).loss_part == pytest.approx(-1.0)


@pytest.mark.parametrize("unit", [1e-200, 1e-3, 1e200])
def test_a_force_looks_the_same_in_any_unit(unit):
    one, other = decompose(X, V, 3.0 * V + X**3), decompose(X, V, unit * (3.0 * V + X**3))
    assert other.rms == pytest.approx(unit * one.rms, rel=1e-12)
    assert other.loss_part == pytest.approx(one.loss_part, rel=1e-9)
    for name in ("displacement", "rate", "both", "neither"):
        assert getattr(other.energy, name) == pytest.approx(getattr(one.energy, name), abs=1e-9)


def test_the_area_of_a_loop():
    # a spring k in line with a slider fc under a sine of size a: 4 fc (a - fc/k) in a cycle
    t, k, fc, a, f = np.arange(10000) / RATE, 100.0, 0.05, 2e-3, 1.0
    x, v = a * np.sin(2.0 * np.pi * f * t), a * 2.0 * np.pi * f * np.cos(2.0 * np.pi * f * t)
    whole = slice(1000, None)  # it begins at rest
    assert decompose(x[whole], v[whole], jenkins(x, k, fc)[whole]).loss == pytest.approx(
        4.0 * fc * (a - fc / k) * f, rel=1e-2
    )


def test_regions():
    t = np.arange(30000) / RATE
    x, v = np.sin(2.0 * np.pi * t), 2.0 * np.pi * np.cos(2.0 * np.pi * t)
    of = decompose(x, v, x * t).regions
    # the integral of t^2 over each third
    assert [energy for energy, _ in of["record"].values()] == pytest.approx([1 / 27, 7 / 27, 19 / 27], abs=0.01)
    # |sin| < 1/3 for 2/pi asin(1/3) of the time, with (u - sin(u) cos(u)) 2/pi of its square, u = asin(1/3)
    u = np.arcsin(1.0 / 3.0)
    energy, time = of["displacement"]["middle"]
    assert time == pytest.approx(2.0 / np.pi * u, abs=0.005)
    assert energy == pytest.approx(2.0 / np.pi * (u - np.sin(u) * np.cos(u)), abs=0.005)
    # cos^2 above its median: 1/2 + 1/pi
    assert decompose(x, v, v).regions["speed"]["fast"] == pytest.approx((0.5 + 1.0 / np.pi, 0.5), abs=0.005)
    high = decompose(x, v, np.maximum(x - 0.5, 0.0)).regions["displacement"]["high"]
    assert high[0] > 0.99
    assert high[1] < 0.4


def test_a_motion_on_one_side_tells_no_symmetry():
    found = decompose(X + 5.0, V, 100.0 * (X + 5.0))
    assert found.energy.odd is None
    assert found.energy.displacement == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("still", ["displacement", "rate", "both"])
def test_a_place_that_does_not_move(still):
    x = X if still == "rate" else np.zeros(len(X))
    v = V if still == "displacement" else np.zeros(len(V))
    found = decompose(x, v, 1.0 + 0.0 * X)
    assert found.energy.displacement == pytest.approx(1.0)
    assert followed(x, 1.0 + 0.0 * X) == pytest.approx(1.0)


def test_a_short_record():
    x, v = X[::50][:400], V[::50][:400]
    assert decompose(x, v, 100.0 * x).energy.displacement == pytest.approx(1.0, abs=0.01)


def test_what_follows_a_command():
    command = multisine(60.0, seed=3)[0]
    limited = np.clip(command, -1.5e-3, 1.5e-3) - command
    assert followed(command, limited) == pytest.approx(np.mean(limited**2), rel=0.02)
    assert followed(command, X) < 0.05 * np.mean(X**2)


def harmonics_of(command):
    """Return a function of a force along a command: its harmonics."""
    return lambda force: harmonics(command[:, None], force, period(command[:, None]), RATE)


def test_periods_are_found():
    assert period(X[:, None]) == 20000
    two = np.column_stack([X, np.full(len(X), 0.3), multisine(60.0, seed=1, lines=np.arange(2, 60, 4))[0]])
    assert period(two) == 20000
    assert period(multisine(60.0, lines=np.array([4, 12]))[0][:, None]) == 5000
    rng = np.random.default_rng(0)
    assert period(rng.standard_normal((3000, 2))) is None
    assert harmonics_of(X[:50000])(X[:50000]) is None  # two and a half
    assert period(X[:24000, None]) is None
    assert period(np.ones((3000, 1))) is None
    assert period(np.zeros((3000, 0))) is None


def test_harmonics_of_a_sine():
    x = np.sin(2.0 * np.pi * np.arange(10000) / 1000.0)
    found = harmonics_of(x)
    # sin^3 = 3/4 sin - 1/4 sin 3: squares as 9 to 1. sin^2 = 1/2 - 1/2 cos 2
    cubic, quadratic = found(x**3), found(x**2)
    assert (cubic.excited, cubic.even, cubic.odd) == pytest.approx((0.9, 0.0, 0.1), abs=1e-9)
    assert (quadratic.excited, quadratic.even, quadratic.odd) == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    # an offset and a sine: 1 to 1/2
    both = found(1.0 + x)
    assert (both.excited, both.even) == pytest.approx((1 / 3, 2 / 3), abs=1e-9)
    assert (cubic.base, cubic.periods, cubic.only_odd) == (1.0, 9, True)
    assert json.loads(json.dumps(cubic.as_dict()))["odd"] == pytest.approx(0.1)


def test_harmonics_of_odd_multisines():
    found = harmonics_of(X)
    assert found(1e6 * X**3).even == pytest.approx(0.0, abs=1e-6)
    assert found(np.sign(V)).even == pytest.approx(0.0, abs=1e-3)
    assert found(jenkins(X, 100.0, 0.05)).even == pytest.approx(0.0, abs=1e-3)  # settled after a period
    assert found(X**2).even == pytest.approx(1.0, abs=1e-6)
    every = multisine(60.0, lines=np.arange(1, 30))[0]
    assert not harmonics_of(every)(every**3).only_odd
    rng = np.random.default_rng(0)
    noisy = found(1e6 * X**3 + 0.5 * (1e6 * X**3).std() * rng.standard_normal(len(X)))
    assert noisy.even == pytest.approx(0.0, abs=0.05)


def test_the_statistic_of_ljung_and_box():
    rng = np.random.default_rng(1)
    e = rng.standard_normal(500)
    rho = [float(e[lag:] @ e[:-lag] / (e @ e)) for lag in range(1, 21)]
    np.testing.assert_allclose(autocorrelation(e, 20), rho, atol=1e-12)
    q = 500 * 502 * sum(r**2 / (500 - lag) for lag, r in enumerate(rho, 1))
    # the density of chi-squared with 20 degrees of freedom, integrated
    tail = integrate.quad(lambda s: s**9 * np.exp(-s / 2.0) / (2.0**10 * 362880.0), q, np.inf)[0]
    assert float(ljung_box(np.array(rho), 500)) == pytest.approx(tail, rel=1e-6)


def test_white_noise_is_called_white_as_often_as_it_should():
    rng = np.random.default_rng(2)
    reading = X[:4000]
    p = np.array([whiteness(rng.standard_normal(4000), reading, 1.0, RATE).p for _ in range(400)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.035)
    assert np.mean(p < 0.3) == pytest.approx(0.3, abs=0.1)
    assert whiteness(rng.standard_normal(60000), X, 1.0, RATE).white


@pytest.mark.parametrize("length", [999, 4000])
def test_a_spectrum_is_called_uneven_as_often_as_it_should(length):
    rng = np.random.default_rng(5)
    p = np.array([evenness(rng.standard_normal(length)) for _ in range(2000)])
    for level in (0.01, 0.1):
        assert 0.5 * level < np.mean(p < level) < 1.5 * level


def test_a_little_power_in_a_few_lines_is_seen_where_correlations_show_none():
    """Twenty lines with 0.3 % of the variance together: each 4.5 times the noise there, 0.003 of correlation."""
    rng, t = np.random.default_rng(6), np.arange(60000) / RATE
    lines = np.cos(2.0 * np.pi * (np.linspace(2.05, 2.8, 20) * t[:, None] + rng.random(20))).sum(axis=1)
    values = rng.standard_normal(60000) + np.sqrt(2.0 * 0.003 / 20) * lines
    assert float(ljung_box(autocorrelation(values, 100), 60000)) > 0.001
    assert evenness(values) < 1e-6


@pytest.mark.parametrize(("frequency", "slow"), [(0.0, True), (0.1, True), (2.0, False), (37.0, False), (220.0, False)])
def test_what_is_not_white_is_told_with_its_frequency(frequency, slow):
    rng, t = np.random.default_rng(3), np.arange(60000) / RATE
    size = 0.1
    found = whiteness(rng.standard_normal(60000) + size * np.cos(2.0 * np.pi * frequency * t), X, 1.0, RATE)
    assert not found.white
    assert found.frequency == pytest.approx(frequency, abs=0.05)
    assert found.slow is slow
    assert found.beyond == pytest.approx(size**2 / (2.0 if frequency else 1.0), abs=0.02)
    assert found.as_dict().keys() == {"p", "white", "beyond", "frequency", "slow"}
    assert place_text.white(found).startswith("not white (")


def test_residuals_that_are_zero_are_white():
    assert whiteness(np.zeros(1000), X[:1000], 1.0, RATE).white


NOISE = 1e-3
INSTANCES = {
    "friction": EffectInstance("dry_friction", "spring1", (0.0055, 1e-3), (0,)),
    "square": EffectInstance("polynomial_spring", "spring2", (0.0, 0.0, 3e3, 0.0, 0.0, 0.0), (2,)),
    "limit": EffectInstance("saturation", "V3", (0.08,), (0,)),
    "bent": EffectInstance("sensor_cubic", "s1", (0.1,), (0,)),
}


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("plant") / "plant.yaml"
    path.write_text(PLANT)
    twin = Twin.load(path)
    return AugmentedModel(twin, twin.equation_parameters())


@pytest.fixture(scope="module")
def discoveries(rig):
    """Return what a discovery finds that knows the cause: one record, three periods of odd multisines."""
    odd = np.arange(1, 32, 2)
    commands = np.array([multisine(24.0, i, odd[i::3], cycle=8.0)[0] for i in range(3)]).T
    commands = np.ascontiguousarray(commands / commands.std(axis=0) * np.array([0.004, 0.004, 0.05]))
    empty = Data("a record", RATE, commands, np.zeros((len(commands), 3)))
    plain = EstimationProblem(rig, empty, prior_of(rig.twin, rig, 0.01), np.full(3, NOISE), 2)

    def find(instance):
        told = plain.equations(rig.start, np.zeros((1, 6)), (instance,), np.array(instance.estimated)).simulated
        noise = NOISE * np.random.default_rng(1).standard_normal(told.shape)
        problem = replace(plain, record=replace(empty, readings=told + noise))
        base, known = fitting.fit(problem), fitting.fit(problem, (instance,))
        first = Explanation("none", (), base)
        chosen = Explanation("effects", ((instance.effect, instance.at),), known)
        motion = smooth(problem, base.theta, base.start)
        found = SearchResult(first, (chosen, first), motion, problem)
        parameters = {n: (instance.values[i], 0.0) for n, i in zip(instance.names, instance.free, strict=True)}
        named = (Named(instance.effect, instance.at, parameters, 1.0),)
        each = dict.fromkeys(rig.twin.sensors, 0.1)
        gap = SimulationError((each, each), (each, each), each, each, each)
        return Discovery(
            verdict="named", twin=rig.twin, problem=problem, explanation=chosen, search=found, effects=named,
            simulation_error=gap, unexplained_fraction=0.0, rivals=(chosen,), weights=(1.0,), validation=problem,
            before=base, after=known, adjusted=base,
        )  # fmt: skip

    known = {}
    return lambda name: known.setdefault(name, known.get(name) or find(INSTANCES[name]))


@pytest.mark.parametrize("record", ["explained", "judging"])
def test_what_is_left_is_closed_where_it_is_white_on_both_records(discoveries, record):
    found = discoveries("friction")
    assert found.closed
    known = found.after
    tone = 0.1 * NOISE * np.sin(2.0 * np.pi * 2.0 * np.arange(len(known.residuals)) / RATE)
    slow = replace(known, residuals=known.residuals + tone[:, None])
    chosen = replace(found.explanation, hypothesis=slow)
    found = replace(found, explanation=chosen) if record == "explained" else replace(found, after=slow)
    assert found.is_at_noise_floor
    assert not found.closed
    assert found.as_dict()["closed"] is False
    assert discovery_text.unexplained(found).startswith(
        "This does not explain all, or the noise is not white: the residual is near"
    )
    assert discovery_text.unexplained(replace(found, verdict="unknown")) == ""
    many = replace(known, start=np.zeros((len(known.residuals) // 100, 6)))  # windows of a tenth of a second
    assert replace(found, explanation=replace(chosen, hypothesis=many)).closed


def test_friction_is_where_it_is(discoveries):
    found = discoveries("friction")
    seen = found.localisation
    assert found.localisation is seen
    assert seen.latent.coordinates["x1"] > 0.95
    assert sum(seen.latent.coordinates.values()) == pytest.approx(1.0)
    best = seen.latent.best
    assert best.name == "spring1"
    assert best.share > 0.95
    assert best.decomposition.energy.rate > 0.9
    assert best.decomposition.energy.odd > 0.95
    assert best.harmonics.only_odd
    assert best.harmonics.even < 0.02
    rate = found.search.motion.rate[:, 0]
    assert best.decomposition.loss == pytest.approx(0.0055 * np.mean(np.abs(rate)), rel=0.05)
    assert best.units == ("m/s**2", "m", "m/s")
    assert max(seen.latent.actuators.values()) < 0.5
    assert max(seen.residual.coordinates.values()) == 0.0
    assert [after.white for _, after in seen.whiteness.values()] == [True] * 3
    assert not seen.whiteness["s1"][0].white


def test_what_is_said_of_friction(discoveries):
    found = discoveries("friction")
    (told,) = discovery_text.location(found)
    assert told.startswith("All of the model error is at spring1: 9")
    assert "of its energy follows the rate, equal and opposite in both directions; it takes " in told
    assert told.endswith("µW/kg out of the motion")
    lost = replace(found, verdict="unknown")
    assert discovery_text.location(lost) == []


def test_a_quadratic_spring_is_even(discoveries):
    best = discoveries("square").localisation.latent.best
    assert best.name == "spring2"
    assert best.decomposition.energy.displacement > 0.9
    assert best.decomposition.energy.odd < 0.05
    assert best.harmonics.even > 0.95
    assert "the same on both sides" in place_text.portrayed(best)


def test_a_gap_on_the_side_of_actuators_follows_a_command(discoveries):
    found = discoveries("limit")
    latent = found.localisation.latent
    assert latent.actuators["V3"] > 0.9 > 2.0 * latent.best.explained
    assert "follows the command of V3" in discovery_text.location(found)[0]
    assert "follows the command of V3" in discovery_text.resemblance(replace(found, verdict="unknown", effects=()))


def test_a_gap_on_the_side_of_sensors_follows_a_reading(discoveries):
    found = discoveries("bent")
    latent = found.localisation.latent
    assert latent.sensors["s1"] > 0.95
    assert max(latent.sensors["s2"], latent.sensors["s3"]) < 0.1
    assert discovery_text.location(found)[0].endswith("of the model error in s1 follows its reading")


def test_it_goes_into_json(discoveries):
    told = json.loads(json.dumps(discoveries("square").localisation.as_dict(), allow_nan=False))
    assert told.keys() == {"latent_force", "residual_force", "whiteness"}
    spring = told["latent_force"]["places"]["spring2"]
    assert spring["energy"]["even"] > 0.95
    assert spring["units"] == {"force": "m/s**2", "displacement": "m", "rate": "m/s"}
    assert told["whiteness"]["s1"]["before"].keys() >= {"p", "white", "beyond"}


def test_the_page_tabulates_it(discoveries):
    figures = [SimpleNamespace(name=name, title=name, caption="", png=None) for name in ("map", "residual")]
    page = discovery_page.page(discoveries("square"), figures, Origin({}), Path("found"))
    assert "Ljung and Box" in page
    assert "<td>spring2</td>" in page
    assert "odd multiples of 0.125 Hz only" in page
