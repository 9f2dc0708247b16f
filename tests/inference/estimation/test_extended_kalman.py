"""The extended Kalman filter: against filters and estimates made otherwise, and against the truth behind a record."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, stats
from scipy.optimize import least_squares

from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, ModelError, RecordError
from masking.inference.estimation.extended_kalman import FilterSettings, extended_kalman
from masking.inference.estimation.fit import fit
from masking.model.declaration import schema
from tests.inference.estimation.test_fit import ALL, measured, oscillator, recorded, sines  # noqa: F401 (fixtures)

TIME = 2.0 / (12.5521 + 14.0337)  # s, the scale of time; Table 4.1
LENGTH = 5e-3  # m, that of length, which every sensor reads as 1 V
STATES = LENGTH * np.array([1.0] * 3 + [1.0 / TIME] * 3)
# Scales of `ALL`: w in 1/time, c in length/time^2/(0.42 V); the others have no unit.
SCALES = np.array([1 / TIME, 1, 1 / TIME, 1, 1 / TIME, 1, *(LENGTH / TIME**2 / 0.42,) * 3, 1, 1])


def filtered(twin, record, names, *, start=None, progress=None, **settings):
    return extended_kalman(twin, record, names, FilterSettings(**settings), start=start, progress=progress)


@pytest.fixture(scope="module")
def linear():
    return Twin.load("linear_rig")


@pytest.fixture(scope="module")
def truth(linear):
    return np.array([linear.parameter_value(name) for name in ALL])


@pytest.fixture(scope="module")
def record(linear):
    return recorded(linear, sines(20.0))


def changed(twin, values):
    return twin.with_parameters(dict(zip(ALL, map(float, values), strict=True)))


@pytest.fixture(scope="module")
def far(linear, truth):
    """The same with every parameter off by up to 10 %."""
    return changed(linear, truth * (1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, len(ALL))))


@pytest.fixture(scope="module")
def found(far, record):
    return filtered(far, record, ALL)


@pytest.fixture(scope="module")
def again(found, record, linear):
    """A second pass, told the noise that there is."""
    settings = {"measurement": 1e-6, "process": 0.0, "parameters": 1e-4, "initial": 1e-8}
    return filtered(found.twin, record, ALL, start=linear.rest(np.zeros(3)), **settings)


# Against estimates made otherwise.


def matrices(truth):
    """Return A, B of the rig (4.1)-(4.3) and C of its sensors."""
    w1, z1, w2, z2, w3, z3, c1, c2, c3, mu1, mu2 = truth
    a, b = np.zeros((6, 6)), np.zeros((6, 3))
    a[:3, 3:] = np.eye(3)
    for i, (w, z, c, mu) in enumerate(((w1, z1, c1, mu1), (w2, z2, c2, mu2))):
        force = np.zeros(6)
        force[[i, 2, 3 + i, 5]] = w**2, -(w**2), 2 * z * w, -2 * z * w
        a[3 + i] -= force
        a[5] += mu * force
        b[3 + i, i] = c
    a[5] -= [0, 0, w3**2, 0, 0, 2 * z3 * w3]
    b[5] = -mu1 * c1, -mu2 * c2, c3
    return a, b, 200.0 * np.hstack([np.array([[1, 0, -1], [0, 1, -1], [0, 0, 1.0]]), np.zeros((3, 3))])


def plain(truth, record, start, p0, q):
    """Return states, deviations and innovations of a Kalman filter in the textbook's form, exactly discretised."""
    a, b, c = matrices(truth)
    dt = 1.0 / record.rate
    f = linalg.expm(a * dt)
    g = linalg.expm(np.block([[a, b], [np.zeros((3, 9))]]) * dt)[:6, 6:]
    loan = linalg.expm(np.block([[-a, np.diag(q)], [np.zeros((6, 6)), a.T]]) * dt)
    added = loan[6:, 6:].T @ loan[:6, 6:]
    x, p, out = start.copy(), np.diag(p0), []
    for u, z in zip(record.acting, record.readings, strict=True):
        s = c @ p @ c.T + 1e-6 * np.eye(3)
        gain = p @ c.T @ np.linalg.inv(s)
        e = z - c @ x
        x, p = x + gain @ e, p - gain @ c @ p
        out.append((x, e, e @ np.linalg.solve(s, e)))
        last = p
        x, p = f @ x + g @ u, f @ p @ f.T + added
    return (*map(np.array, zip(*out, strict=True)), last)


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize(("process", "exact"), [(0.0, 1e-8), (1e-4, 1e-4)])  # RK4; the trapezoidal rule for Q
def test_of_a_linear_rig_it_is_the_kalman_filter(linear, truth, square_root, process, exact):
    record = recorded(linear, sines(2.0))
    start = np.array([1e-3, -1e-3, 5e-4, 0.01, 0.0, -0.01])
    settings = {"measurement": 1e-6, "process": process, "initial": 1e-2, "start": start}
    found = filtered(linear, record, (), square_root=square_root, **settings)
    q = process * STATES**2 / TIME
    states, innovations, nis, last = plain(truth, record, start, 1e-2 * STATES**2, q)
    assert (np.abs(found.states - states) < exact * STATES).all()
    np.testing.assert_allclose(found.innovations, innovations, atol=exact)
    np.testing.assert_allclose(found.nis, nis, atol=1e3 * exact)
    assert (np.abs(found.final - last) < 10 * exact * np.sqrt(np.outer(np.diag(last), np.diag(last)))).all()


@pytest.mark.parametrize("square_root", [False, True])
def test_measured_inputs_are_filtered_as_they_are_fitted(oscillator, measured, square_root):  # noqa: F811 (fixtures)
    """Begun at the optimum of least squares, without noise of the process, innovations are the noise of 1e-3."""
    least = fit(oscillator, measured, ("w", "z", "c"))
    settings = {"measurement": 1e-6, "process": 0.0, "parameters": 1e-4, "initial": 1.0, "square_root": square_root}
    found = filtered(least.twin, measured, ("w", "z", "c"), **settings)
    assert (np.abs(found.values - least.values) < least.std).all()
    assert found.innovations[10:].std() == pytest.approx(1e-3, rel=0.05)
    held = filtered(least.twin, replace(measured, hold="zero-order"), (), **settings)
    assert held.innovations[10:].std() > 0.1


def test_a_second_pass_agrees_with_least_squares(again, record):
    """With the noise as it is and no Q, filter and output error solve the same problem."""
    theirs = fit(again.twin, record, ALL)
    assert (np.abs(again.values - theirs.values) < 0.5 * theirs.std).all()
    np.testing.assert_allclose(again.std, theirs.std, rtol=0.05)
    for name, chi in theirs.chi.items():
        assert again.chi[name] == pytest.approx(chi, rel=1e-3)


def test_the_defaults_agree_with_least_squares_within_their_confidence(found, record):
    theirs = fit(found.twin, record, ALL)
    assert (np.abs(found.values - theirs.values) < 1.96 * np.hypot(found.std, theirs.std)).all()


def test_iterated_readings_are_the_most_probable(linear):
    """A gain that is not known times a displacement that is not known: against a general minimiser."""
    use = schema.EffectUse(effect="sensor_gain", at=("s1",), parameters={"e": 0.0})
    plant = linear.declaration.model_copy(update={"effects": {**linear.declaration.effects, "scale": use}})
    twin = replace(linear, declaration=plant)
    record = recorded(twin, sines(0.1), start=np.array([4e-3, 1e-3, -1e-3, 0.0, 0.0, 0.0]))
    begun = twin.rest(np.array([2e-3, 1e-3, -1e-3]))
    settings = {"measurement": 1e-6, "initial": 0.04, "start": begun}

    def misfit(x):
        q1, q2, q3 = x[:3] * LENGTH
        expected = 200.0 * np.array([(1 + x[3]) * (q1 - q3), q2 - q3, q3])
        return np.concatenate([(record.readings[0] - expected) / 1e-3, (x[:3] - begun[:3] / LENGTH) / 0.2, x[3:] / 0.1])

    best = least_squares(misfit, [*(begun[:3] / LENGTH), 0.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x

    def off(**chosen):
        found = filtered(twin, record, ("scale_e",), **settings, **chosen)
        return np.abs(np.array([*found.states[0, :3] / LENGTH, found.trajectory[0, 0]]) - best).max()

    assert off() > 1e-2
    assert off(iterated=12) < 1e-8
    assert off(iterated=12, square_root=True) < 1e-8


def test_the_square_root_gives_the_same(found, far, record):
    root = filtered(far, record, ALL, square_root=True)
    np.testing.assert_allclose(root.trajectory, found.trajectory, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(root.deviations, found.deviations, rtol=1e-9)
    np.testing.assert_allclose(root.normalised, found.normalised, rtol=1e-9, atol=1e-9)
    scale = np.sqrt(np.outer(np.diag(found.final), np.diag(found.final)))
    assert (np.abs(root.final - found.final) < 1e-9 * scale).all()


# Against the truth.


def test_the_settings_of_the_document_find_eleven_parameters(found, truth):
    np.testing.assert_allclose(found.values, truth, rtol=1e-2)
    assert (np.abs(found.values - truth) < 2.0 * found.std).all()
    assert found.twin.parameter_value("w1") == found.values[0]


def test_the_scales_are_those_of_the_dimensionless_equations(far, found):
    """One sample tells parameters nothing yet: their deviations are those of P0."""
    scales = SCALES.copy()
    time = 2.0 / (far.parameter_value("w1") + far.parameter_value("w2"))
    scales[[0, 2, 4]], scales[6:9] = 1.0 / time, LENGTH / time**2 / 0.42
    np.testing.assert_allclose(found.deviations[0], 0.1 * scales, rtol=1e-12)


def test_deviations_shrink_and_the_covariance_stays_positive(found, again):
    for one in (found, again):
        assert (np.diff(one.deviations[::50], axis=0) <= 1e-12 * one.deviations[0]).all()
        assert (one.std < 0.5 * one.deviations[0]).all()
        np.testing.assert_array_equal(one.final, one.final.T)
        scale = np.sqrt(np.diag(one.final))
        # Without Q the state follows from the parameters, and the truth is a covariance that is singular.
        assert np.linalg.eigvalsh(one.final / np.outer(scale, scale)).min() > (0.0 if one is found else -1e-13)


def test_it_is_as_sure_as_it_may_be(linear, truth):
    """Parameters drawn from what the filter is told: 16 records, their innovations, and the errors of the values."""
    errors, nis = [], []
    for seed in range(16):
        drawn = truth + 3e-3 * SCALES * np.random.default_rng(100 + seed).standard_normal(len(ALL))
        record = recorded(linear, sines(4.0, seed=seed), seed=seed)
        settings = {"measurement": 1e-6, "process": 0.0, "parameters": 9e-6, "initial": 1e-10}
        one = filtered(changed(linear, drawn), record, ALL, start=linear.rest(np.zeros(3)), **settings)
        errors.append((one.values - truth) / one.std)
        nis.append(one.nis)
        assert min(one.whiteness.values()) > 1e-5
        assert one.notes == ()
    total, count = np.sum(nis), 3 * np.size(nis)
    assert stats.chi2.ppf(1e-4, count) < total < stats.chi2.ppf(1 - 1e-4, count)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.3


def test_what_a_parameter_depends_on_follows_it(linear, truth):
    """The damping of an effect is 0.1 z1 w1 in the twin: a product of two parameters, both off by 10 %."""
    twin = linear.changed({"damping1": schema.EffectChange(enabled=True)})
    record = recorded(twin, sines(20.0))
    begun = twin.with_parameters({"w1": 1.1 * truth[0], "z1": 0.9 * truth[1]})
    told = []
    found = filtered(begun, record, ("w1", "z1"), progress=told.append)
    np.testing.assert_allclose(found.values, truth[:2], rtol=3e-3)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_effects_of_the_full_twin_are_found():
    twin = Twin.load("tue_rig").changed({"weak_gain": schema.EffectChange(enabled=True)})
    truth = {"friction1_fc": 1.2 * twin.parameter_value("friction1_fc"), "weak_gain_e": -0.05, "offset_s3_e0": 0.02}
    record = recorded(twin.with_parameters(truth), sines(10.0, size=(0.1, 0.1, 0.3)))
    found = filtered(twin, record, tuple(truth), measurement=1e-6, process=1e-8, parameters=(1e-6, 1e-2, 1e-3))
    np.testing.assert_allclose(found.values, list(truth.values()), rtol=0.1, atol=2e-3)


# What it says.


def test_noise_that_is_not_as_told_is_noted(found, far, record):
    (note,) = found.notes
    assert note.startswith("the innovations are 9.") and "times as small" in note
    (mean, low, high), _ = found.consistency, found.whiteness
    assert mean < low < 3.0 < high


def test_a_model_that_lacks_something_is_noted(linear, record):
    wrong = linear.with_parameters({"w3": 12.0})
    notes = filtered(wrong, record, ("w1", "z1"), measurement=1e-6, process=1e-6).notes
    assert any("times as large as the filter expects" in note for note in notes)
    assert any("are not white" in note for note in notes)


def test_it_can_be_written_as_json(found):
    told = json.loads(json.dumps(found.as_dict()))
    assert told["parameters"]["w1"] == {"value": found.values[0], "std": found.std[0], "unit": "rad/s"}
    assert set(told["chi"]["train"]) == {"s1", "s2", "s3"}
    assert "NIS" in str(found)


@pytest.mark.parametrize(
    ("names", "settings", "said"),
    [
        (("w9",), {}, "linear rig has no parameter 'w9'; did you mean"),
        (("w1", "w1"), {}, "parameters are named twice: w1"),
        (("w1",), {"measurement": 0.0}, "measurement is 0: a variance must be positive"),
        (("w1",), {"parameters": -1.0}, "parameters is -1: a variance must be positive"),
        (("w1",), {"process": np.nan}, "process is nan: a variance must be 0 or positive"),
        (("w1",), {"measurement": (1.0, 1.0)}, r"measurement: one variance, or 3, are needed; got shape"),
        (("w1",), {"iterated": 0}, "iterated is 0: give the times"),
        (("w1",), {"start": np.zeros(2)}, r"start must be 6 finite numbers, x1, x2, x3, x1'"),
    ],
)
def test_settings_that_make_no_sense_are_refused(linear, record, names, settings, said):
    with pytest.raises(ModelError, match=said):
        filtered(linear, record, names, **settings)


def test_a_record_of_another_rig_or_with_holes_is_refused(linear, record):
    with pytest.raises(RecordError, match=r"readings have shape \(10000, 2\); they must be of s1, s2, s3"):
        filtered(linear, replace(record, readings=record.readings[:, :2]), ("w1",))
    holed = record.readings.copy()
    holed[77, 1] = np.nan
    with pytest.raises(RecordError, match="readings are not finite at sample 77, and at 1 samples in all"):
        filtered(linear, replace(record, readings=holed), ("w1",))


def test_divergence_says_when_and_what_to_lower(far, record):
    with pytest.raises(
        IntegrationError, match=r"the filter diverged at t = .* s, sample [0-9]+ of the record: .*lower"
    ):
        filtered(far, record, ALL, parameters=1e12, square_root=True)
    with pytest.raises(IntegrationError, match=r"not positive any more at t = .*; give square_root=True"):
        filtered(far, record, ALL, parameters=1e7)
