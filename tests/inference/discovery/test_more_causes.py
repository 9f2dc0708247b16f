"""Two laws at one place: dry friction and drag, of which either alone looks like the declared damping.

Records are integrated by scipy from one reversal to the next, with friction as a force of one sign in between.
"""

import json

import numpy as np
import pytest
from scipy import integrate

from masking.app import cli
from masking.app.workflows import discovery_inputs
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.candidates import candidates, spans
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.more_causes import pairs
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.screening import Screen
from masking.inference.discovery.smoothing import centred, smooth
from masking.inference.estimation.identification_data import Data

W2, FRICTION, DRAG = 63.5, 0.19, 0.005
RATE, NOISE = 50.0, 3e-4
UP = "name: swing\ncoordinates: {th: {unit: rad}}\n"  # the angle counts from straight up
SWING = """inputs: {u: {unit: 1/s**2}}
parameters:
  w2: {value: 64, unit: 1/s**2, std: 2}
  k: {value: 0.05, unit: 1/s, std: 0.05}
equations: {"th''": "w2*sin(th) - k*th' + u"}
elements: {joint: {displacement: th, unit: 1/s**2, acts: {th: -1}}}
"""


def swing(seconds, force, first=1.4):
    """Return the angle from straight down at the instants of a record, of a pendulum with dry friction and drag."""
    times = np.arange(round(seconds * RATE)) / RATE
    angle, now, state = np.zeros(len(times)), 0.0, np.array([first, 0.0])
    while now < times[-1]:
        pull = -W2 * np.sin(state[0]) + force(now)
        if abs(pull) <= FRICTION:  # it sticks until it is pulled loose
            later = times[times > now]
            loose = [t for t in later if abs(-W2 * np.sin(state[0]) + force(t)) > FRICTION]
            until = loose[0] if loose else times[-1]
            angle[(times >= now) & (times <= until)] = state[0]
            now, pull = until, -W2 * np.sin(state[0]) + force(until)
            continue
        sign = np.sign(pull)

        def rates(t, y, sign=sign):
            return [y[1], -W2 * np.sin(y[0]) - DRAG * y[1] * abs(y[1]) - FRICTION * sign + force(t)]

        def turns(t, y, begun=now, sign=sign):
            return y[1] if t > begun + 1e-6 else sign

        turns.terminal = True
        part = integrate.solve_ivp(
            rates, (now, times[-1]), state, "DOP853", events=turns, rtol=1e-9, atol=1e-12, dense_output=True
        )
        inside = (times >= now) & (times <= part.t[-1])
        angle[inside] = part.sol(times[inside])[0]
        now, state = part.t[-1], np.array([part.y[0, -1], 0.0])
    return times, angle


def multisine(t):
    """Return a force that keeps the pendulum moving at many amplitudes."""
    tones, phases = np.array([0.7, 1.05, 1.3, 1.45]), np.array([0.3, 4.0, 1.1, 2.6])
    return float(0.8 * np.sin(2.0 * np.pi * tones * t + phases).sum())


FORCES = {"free decay": lambda t: 0.0, "multisine": multisine}


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "swing.yaml"
    path.write_text(UP + SWING)
    twin = discovery_inputs.rig(path, None)
    return AugmentedModel(twin, twin.equation_parameters())


def problem(rig, which):
    """Return the estimation problem of a record."""
    times, angle = swing(30.0, FORCES[which])
    readings = np.pi + angle + NOISE * np.random.default_rng(3).standard_normal(len(times))
    commands = np.array([FORCES[which](t) for t in times])
    record = Data("made", RATE, commands[:, None], readings[:, None], hold="first-order")
    return EstimationProblem(rig, record, prior_of(rig.twin, rig, 0.01), np.array([NOISE]), 2)


def test_a_rig_is_linearised_around_its_motion_where_it_would_fall_from_zero(rig):
    found = centred(problem(rig, "free decay"))
    assert found.rig.rest == pytest.approx([np.pi, 0.0], abs=0.05)  # straight down, at 0 it stands upright
    assert centred(found) is found


@pytest.mark.parametrize("which", FORCES)
def test_friction_and_drag_score_together(rig, which):
    """To first order along the motion, both have their true size, and the declared damping goes."""
    whole = centred(problem(rig, which))
    base = fitting.fit(whole)
    motion = smooth(whole, base.theta, base.start)
    every = list(candidates(whole.rig, spans(whole, motion), whole.dt))
    screen = Screen(whole, base, motion)
    scores = screen.scores(every)
    best = pairs(screen, scores)[0]
    values = {one.candidate.effect: one.instance.estimated[0] for one in best.scores}
    assert values == pytest.approx({"dry_friction": FRICTION, "quadratic_damping": DRAG}, rel=0.1)
    noise = len(whole.record) / screen.every
    alone = {one.candidate.effect: screen.total - one.gain - noise for one in scores}
    left = screen.total - best.gain - noise
    assert left < 0.3 * min(alone["dry_friction"], alone["quadratic_damping"])


@pytest.mark.search
@pytest.mark.parametrize("which", FORCES)
def test_friction_and_drag_are_named_together(tmp_path, which):
    times, angle = swing(40.0, FORCES[which])
    readings = np.pi + angle + NOISE * np.random.default_rng(3).standard_normal(len(times))
    table = np.column_stack([times, np.array([FORCES[which](t) for t in times]), readings])
    np.savetxt(tmp_path / "swing.csv", table, delimiter=",", header="t,u,th", comments="")
    (tmp_path / "swing.yaml").write_text(UP + SWING)
    words = ["discover", str(tmp_path / "swing.csv"), "--model", str(tmp_path / "swing.yaml"), "--hold", "band-limited"]
    assert cli.main([*words, "--out", str(tmp_path / "found")]) == 0
    found = json.loads((tmp_path / "found" / "discovery.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "named"
    values = {one["name"]: next(iter(one["parameters"].values()))["value"] for one in found["effects"]}
    assert values == pytest.approx({"dry_friction": FRICTION, "quadratic_damping": DRAG}, rel=0.05)
    assert abs(found["parameters"]["k"]["value"]) < 0.01  # what was declared only stood for them
