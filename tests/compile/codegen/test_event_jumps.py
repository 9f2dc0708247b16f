"""Virtual systems with events, masked: scipy integrates clocks with escapements from event to event."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.masking_error import masking_error
from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.control.exports.rig_units import model_unit
from masking.errors import DeclarationError, ModelError
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from tests.control.exports.test_controller_units import EXACT, by_kernel
from tests.support.compiled_unit import GCC, CompiledUnit

W, W3, MU, ZETA, ZETA3, F, A, OM, B = np.array([1.0, 1.02]), 0.8, 0.05, 0.03, 0.1, 0.12, 0.15, 0.3, 0.2
SECOND = 18.3157  # units of virtual time in a second of the rig


def slope(t, y, d):
    """Return dy/dt of y = [x1, x2, x3, x1', x2', x3'] under the forces of the escapements."""
    stretch, speed = y[:2] - y[2], y[3:5] - y[5]
    force = W**2 * stretch + 2.0 * ZETA * W * speed - d
    beam = MU * force.sum() - W3**2 * y[2] - 2.0 * ZETA3 * W3 * y[5] + A * np.sin(OM * t)
    return np.concatenate([y[3:], -force, [beam]])


@cache
def truth(end, rows):
    """Return coordinates and forces by scipy, from event to event, at equal times, and the times of the events."""
    times, found, happened = np.linspace(0.0, end, rows), np.empty((5, rows)), []
    conditions = {}
    for i, sign, angle in product((0, 1), (1.0, -1.0), (0.0, B)):
        conditions[i, sign, angle] = lambda _, y, __, i=i, s=sign, a=angle: s * (y[i] - y[2]) - a
        conditions[i, sign, angle].terminal, conditions[i, sign, angle].direction = True, 1.0
    t, y, d, last = 0.0, np.array([-0.5, 0.4, 0.0, 0.0, 0.0, 0.0]), np.zeros(2), None
    while t < end:
        watched = {key: one for key, one in conditions.items() if key != last}  # scipy would find that at once
        run = solve_ivp(
            slope, (t, end), y, "DOP853", args=(d,), events=[*watched.values()], rtol=1e-12, atol=1e-14,
            dense_output=True,
        )  # fmt: skip
        at = (times >= t) & (times <= run.t[-1])
        if at.any():
            found[:3, at], found[3:, at] = run.sol(times[at])[:3], d[:, None]
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 1:
            last = next(key for key, hits in zip(watched, run.t_events, strict=True) if len(hits))
            d = d.copy()
            d[last[0]] = last[1] * F if last[2] == 0.0 else 0.0
            happened.append(t)
    return times, found, np.array(happened)


@cache
def recorded(name):
    return Experiment.load(name).changed(duration=60).run()


def test_the_ideal_motion_is_that_of_scipy():
    model, (times, expected, happened) = Experiment.load("escapements").virtual, truth(60.0, 3001)
    found = model.simulate(times, tolerance=1e-12)
    for i, name in enumerate(("x1", "x2", "x3", "d1", "d2")):
        assert np.max(np.abs(found[name] - expected[i])) <= 1e-9
    assert len(happened) > 70
    assert np.max(np.abs([t for t, _ in found.events] - happened)) <= 1e-9


def test_escapements_are_masked_on_the_ideal_rig_in_continuous_time():
    run = recorded("escapements")
    assert max(run.manifest["masking_error"].values()) <= 1e-6
    times, expected, _ = truth(60.0, len(run.t))
    assert np.allclose(times, run.t * SECOND, atol=1e-9)
    for i, name in enumerate(("x1", "x2", "x3")):
        assert np.max(np.abs(run[f"virtual.{name}"] - expected[i])) <= 1e-6
    for i in (1, 2):
        assert np.array_equal(run[f"virtual.d{i}"], expected[2 + i])
        assert np.array_equal(run[f"ideal.d{i}"], expected[2 + i])


def test_escapements_are_masked_by_a_sampled_controller_on_the_imperfect_rig():
    run = Experiment.load("escapements_rig").run()
    assert max(run.manifest["masking_error"].values()) <= 0.03
    for i in (1, 2):
        beats = [np.count_nonzero(np.diff(run[f"{which}.d{i}"])) for which in ("virtual", "ideal")]
        assert beats[0] == beats[1] > 70


def at_rate(rate):
    """Return the worst masking error on a rig that the controller knows, without noise, two samples late."""
    effects = {"noise": {"enabled": False}, "delay": {"parameters": {"samples": 2}}}
    controller = {"rate": f"{rate} Hz", "observer": {"kind": "kalman", "bandwidth": 20.0, "noise": 1e-4}}
    made = Experiment.load("escapements_rig").changed(
        plant="linear_rig", duration=60, record={"rate": "250 Hz"}, controller=controller, effects=effects
    )
    return max(made.run().manifest["masking_error"].values())


def test_events_between_samples_cost_an_error_of_second_order():
    errors = [at_rate(rate) for rate in (250, 500, 1000)]
    assert errors[1] <= 5e-4
    assert errors[0] / errors[2] >= 8.0


def test_a_controller_that_differences_positions_finds_the_events():
    made = Experiment.load("escapements_rig").changed(
        controller={"rate": "4 kHz", "observer": "differences"}, plant="ideal", effects={}, duration=20
    )
    run = made.run()
    assert max(run.manifest["masking_error"].values()) <= 0.02
    assert masking_error(run["virtual.d1"], run["ideal.d1"]) <= 0.2


def test_a_rig_in_lockstep_moves_as_the_loop_around_its_twin():
    experiment = Experiment.load("escapements_rig").changed(duration=20)
    offline = experiment.run()
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    for name in ("input.V1", "input.V2", "input.V3"):
        assert np.max(np.abs(found[name] - offline[name])) <= 1e-9 * np.max(np.abs(offline[name]))


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_exported_controllers_find_the_events(tmp_path):
    experiment = Experiment.load("escapements_rig").changed(controller={"rate": "500 Hz", "model": "setup_springs"})
    unit = sampled_unit(experiment.sampled, "clocks", 0.02)
    compiled = CompiledUnit(tmp_path, unit)
    samples = experiment.sampled.before + 400
    _, ours, (found,) = by_kernel(experiment, samples, others=[compiled], missed={300})
    assert np.max(np.abs(found - ours)) <= EXACT * np.max(np.abs(ours))


def test_a_control_law_that_is_given_the_states_says_who_makes_them_jump():
    unit = law_unit(Experiment.load("escapements").loop, "clocks", None)
    assert "the caller makes them jump" in " ".join(unit.notes)


BALL = """
name: ball
coordinates: {x: {meaning: height, initial: 1}}
parameters: {g: 1, e: 0.8}
equations: {x'': -g}
events: {impact: {when: -x, jumps: {x': -e*x'}}}
"""


def test_what_no_rig_can_do_is_refused_with_what_it_can(tmp_path):
    (tmp_path / "ball.yaml").write_text(BALL, encoding="utf-8")
    with pytest.raises(DeclarationError) as error:
        Experiment.load("bouncing_ball").changed(virtual=str(tmp_path / "ball.yaml"))
    said = str(error.value)
    assert "in the event 'impact' of ball, x' jumps, and no force makes a rig jump" in said
    assert "models/bouncing_ball.yaml" in said


def test_rigs_and_what_is_estimated_have_no_events(tmp_path):
    from masking.app.workflows import discovery_inputs

    (tmp_path / "ball.yaml").write_text(BALL.replace("-g}", "-g + F}\ninputs: {F: push}"), encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(f"name: rig\nmodel: {tmp_path}/ball.yaml\nsensors: {{s: x}}\n", encoding="utf-8")
    with pytest.raises(DeclarationError, match="the model ball has events; only models that are simulated"):
        Experiment.load("bouncing_ball").changed(plant=str(tmp_path / "rig.yaml"))
    with pytest.raises(DeclarationError, match="the model ball has events; take a model of the rig without"):
        Experiment.load("bouncing_ball").changed(
            controller={"rate": "continuous", "model": str(tmp_path / "ball.yaml")}
        )
    with pytest.raises(DeclarationError, match="the model ball has events, which are not estimated"):
        discovery_inputs.rig(tmp_path / "ball.yaml", None)


def test_what_takes_no_events_says_so():
    experiment = Experiment.load("escapements")
    with pytest.raises(ModelError, match="clocks with escapements has events, which an exported model does not take"):
        model_unit(experiment.virtual, "clocks", 100.0)
    with pytest.raises(ModelError, match=r"has events, which a controller with 'observer: exact' does not take"):
        experiment.changed(controller={"rate": "1 kHz", "observer": "exact"}).run()
    with pytest.raises(ModelError, match="has events, which python-control does not take"):
        experiment.loop.to_control()
