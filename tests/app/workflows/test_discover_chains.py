"""Chains of first order: two tanks in a row, of which the second is read, from unknown levels; records by scipy."""

import numpy as np
import pytest
from scipy import integrate, optimize

import masking

TRUE = {"k1": 0.06, "k2": 0.055, "k3": 0.05, "k4": 0.045}
MODEL = """
name: two tanks
states: {{x1: {{unit: V, initial: 5}}, x2: {{unit: V, initial: 5}}}}
inputs: {{u: {{unit: V}}}}
parameters:
  k1: {{value: {k1}, unit: V**0.5/s, std: 0.02}}
  k2: {{value: {k2}, unit: V**0.5/s, std: 0.02}}
  k3: {{value: {k3}, unit: V**0.5/s, std: 0.02}}
  k4: {{value: {k4}, unit: 1/s, std: 0.02}}
equations: {{"x1'": -k1*sqrt(x1) + k4*u, "x2'": k2*sqrt(x1) - k3*sqrt(x2)}}
outputs: {{y: {{expression: x2, unit: V}}}}
"""


def test_parameters_of_a_chain_with_an_unmeasured_state_are_found(tmp_path):
    """The first level in other units makes the same second one, and the two lags may change places."""
    rng, t = np.random.default_rng(0), 4.0 * np.arange(700)
    u = np.repeat(rng.uniform(1.5, 4.0, 70), 10)

    def rates(at, x):
        flow = TRUE["k2"] * np.sqrt(x[0])
        return [
            -TRUE["k1"] * np.sqrt(x[0]) + TRUE["k4"] * u[min(int(at / 4.0), 699)],
            flow - TRUE["k3"] * np.sqrt(x[1]),
        ]

    y = integrate.solve_ivp(rates, (0.0, t[-1]), [4.0, 7.0], t_eval=t, max_step=4.0, rtol=1e-8).y[1]
    np.savez(tmp_path / "record.npz", t=t, u=u, y=y + 0.01 * rng.standard_normal(len(t)))
    (tmp_path / "model.yaml").write_text(MODEL.format(**dict.fromkeys(TRUE, 0.05)))
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    before, after = found.simulation_error.validation
    assert found.verdict == "none"
    assert after["y"] < 0.1 * before["y"]
    values = dict(zip(found.rig.names, found.explanation.hypothesis.theta, strict=True))
    assert gain(values) == pytest.approx(gain(TRUE), rel=0.01)
    assert min(values.values()) > 0.0


def gain(p):
    """Return the root of the second level at rest over the input, which other units of the first do not change."""
    return p["k2"] * p["k4"] / p["k1"] / p["k3"]


FULL = 8.0
PLACES = """elements:
  upper: {displacement: x1, unit: V/s, acts: {x1: -1}}
  between: {displacement: x1, unit: V/s, acts: {x1: -1, x2: 1}}
  lower: {displacement: x2, unit: V/s, acts: {x2: -1}}
"""


def overflowing(u, period, share):
    """Return both levels of two tanks (m, 2), from event to event: the upper one is full, and later no longer so.

    Args:
        u: the input, held (m,).
        period: between samples, s.
        share: of what the upper tank cannot hold that runs into the lower one.
    """

    def net(level, command):
        return TRUE["k4"] * command - TRUE["k1"] * np.sqrt(level)

    def full(at, x, command):
        return x[0] - FULL

    full.terminal, full.direction = True, 1
    x, is_full, levels = np.array([4.0, 7.0]), False, np.empty((len(u), 2))
    for i, command in enumerate(u):
        levels[i], now, end = x, i * period, (i + 1) * period
        while now < end:
            is_full = is_full and net(FULL, command) > 0.0
            excess = net(FULL, command) if is_full else 0.0

            def rates(at, x, command, is_full=is_full, excess=excess):
                through = TRUE["k2"] * np.sqrt(x[0]) + share * excess - TRUE["k3"] * np.sqrt(x[1])
                return [0.0 if is_full else net(x[0], command), through]

            events = None if is_full else full
            part = integrate.solve_ivp(rates, (now, end), x, args=(command,), events=events, rtol=1e-9, atol=1e-10)
            x, now = part.y[:, -1].copy(), part.t[-1]
            if part.status == 1:
                x[0], is_full = FULL, True
    return levels


@pytest.mark.search
@pytest.mark.parametrize(("share", "at"), [(0.0, "upper"), (1.0, "between")])
def test_a_tank_that_is_full_is_found_with_where_the_rest_flows(tmp_path, share, at):
    """Only the level below is read, and the first levels are not those declared."""
    rng, t = np.random.default_rng(0), 4.0 * np.arange(700)
    u = np.repeat(rng.uniform(1.5, 4.6, 70), 10)
    levels = overflowing(u, 4.0, share)
    assert 0.01 < (levels[:, 0] > FULL - 1e-6).mean() < 0.2
    np.savez(tmp_path / "record.npz", t=t, u=u, y=levels[:, 1] + 0.01 * rng.standard_normal(len(t)))
    near = dict(zip(TRUE, (1.01, 0.99, 1.005, 0.995), strict=True))
    text = MODEL.format(**{name: value * near[name] for name, value in TRUE.items()}).replace("0.02}", "0.002}")
    (tmp_path / "model.yaml").write_text(text + PLACES)
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    (cause,) = found.effects
    # An overflow as stiff as nobody could measure is the same: alternatives are of this family and place, too.
    named = {(cause.name, cause.on), *((name, on) for name, on, _ in cause.alternatives)}
    assert {(masking.model.effects.EFFECTS[name].family, on) for name, on in named} == {("overflow", at)}
    assert cause.parameters["edge"][0] == pytest.approx(FULL, rel=0.03)
    before, after = found.simulation_error.validation
    assert after["y"] < 0.1 * before["y"]


def test_a_state_that_a_bound_holds_stays_as_far_beyond_it_as_the_flow_that_is_lost_needs(tmp_path):
    """At rest k (x - edge) is the inflow less the outflow; below the bound, nothing has changed."""
    (tmp_path / "model.yaml").write_text(MODEL.format(**TRUE) + PLACES)
    free = masking.load_model(tmp_path / "model.yaml")
    held, k, u = free.attach("state_saturation", at="upper", edge=FULL, k=50.0), 50.0, 4.0
    times = np.linspace(0.0, 1000.0, 201)
    ends = [model.simulate(times, {"x1": 4.0}, [u]).states[:, 0] for model in (free, held)]
    rest = optimize.brentq(lambda x: TRUE["k4"] * u - TRUE["k1"] * np.sqrt(x) - k * (x - FULL), FULL, FULL + 0.1)
    assert ends[0][-1] > 1.05 * FULL
    assert ends[1][-1] == pytest.approx(rest, abs=1e-9)
    below = ends[0] < FULL
    np.testing.assert_allclose(ends[1][below], ends[0][below], rtol=1e-8)
