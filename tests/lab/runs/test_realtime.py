"""Running a controller on a plant: limits, time, and the way out."""

import gc
import signal
import time

import numpy as np
import pytest

from masking.errors import CommandError, PlantLostError, PlantMismatchError
from masking.lab.plants.interface import Sample
from masking.lab.plants.safety_chain import Cause
from tests.lab.plants.test_wire import MassSpring, damped
from tests.support.rig_runs import run_rig

pytestmark = pytest.mark.realtime

RUN = {"rate": 1000.0, "samples": 50, "limits": np.array([0.2, 0.4]), "lockstep": True}


class Watched(MassSpring):
    """Notes what it was told, in order."""

    def __init__(self):
        super().__init__()
        self.calls, self.written = [], []

    def activate(self):
        super().activate()
        self.calls.append("activate")

    def write(self, index, command):
        self.written.append(np.array(command))
        super().write(index, command)

    def deactivate(self):
        super().deactivate()
        self.calls.append("deactivate")


class Owner(Watched):
    """Keeps its own clock, on which samples are missed; dies where it is told to."""

    owns_clock = True
    indices = (0, 1, 2, 5, 6, 8)

    def read(self):
        at = len(self.written)
        if at == len(self.indices):
            raise PlantLostError("the cable is off; plug it in")
        super().read()
        return Sample(self.indices[at], self.state[0].copy())


def test_the_loop_is_read_step_clamp_write():
    plant = Watched()
    run = run_rig(damped, plant, **RUN)
    assert run.reason == "finished"
    assert run.index.tolist() == list(range(50))
    assert run.times == pytest.approx(np.arange(50) / 1000.0, abs=0.0)
    assert run.demanded.tolist() == [damped(0, values).tolist() for values in run.sensors]
    assert run.applied.tolist() == np.clip(run.demanded, -RUN["limits"], RUN["limits"]).tolist()
    assert np.array(plant.written).tolist() == run.applied.tolist()
    assert run.counters["clamped"] == np.count_nonzero((run.applied != run.demanded).any(axis=1)) > 0
    assert (run.counters["late"], run.counters["missed"]) == (0, 0)
    assert plant.calls[0] == "activate"
    assert plant.calls[-1] == "deactivate"
    assert not plant.applied.any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_never_reaches_the_plant(value):
    plant, kept = Watched(), []

    def step(_, values):
        return np.array([0.1, value if len(plant.written) == 7 else 0.1])

    run = run_rig(step, plant, **RUN, on_end=kept.append)
    assert str(run.trip).startswith(
        f"tick 7: CONTROLLER_NONFINITE: the controller's command for u2 is {value}; look at"
    )
    assert np.isfinite(plant.written).all()
    assert plant.written[-1].tolist() == [0.0, 0.0]
    assert plant.calls[-1] == "deactivate"
    assert kept[0].reason == "tripped"
    assert (len(kept[0].index), kept[0].applied[-1].tolist()) == (8, [0.0, 0.0])


def test_a_huge_command_is_clamped():
    run = run_rig(lambda *_: np.array([1e300, -1e300]), MassSpring(), **RUN)
    assert np.unique(run.applied, axis=0).tolist() == [[0.2, -0.4]]


@pytest.mark.parametrize("command", [np.zeros(3), np.zeros((1, 2)), 0.0, [0.0]])
def test_a_command_of_another_shape_is_refused(command):
    plant = Watched()
    with pytest.raises(CommandError, match=r"tick 0: the controller returned shape .*; return \(2,\), one number for"):
        run_rig(lambda *_: command, plant, **RUN)
    assert np.array(plant.written).tolist() == [[0.0, 0.0]]


def test_what_the_controller_raises_comes_through_once_the_plant_is_at_zero():
    plant, kept = Watched(), []

    def step(_, values):
        if len(plant.written) == 3:
            raise ZeroDivisionError("mine")
        return np.ones(2)

    def on_end(run):
        assert plant.calls[-1] == "deactivate"
        kept.append(run)

    with pytest.raises(ZeroDivisionError, match="mine"):
        run_rig(step, plant, **RUN, on_end=on_end)
    assert not plant.applied.any()
    assert (kept[0].reason, kept[0].index.tolist()) == ("tripped", [0, 1, 2, 3])
    assert kept[0].trip.cause is Cause.CONTROLLER_EXCEPTION
    assert "ZeroDivisionError: mine" in kept[0].trip.detail
    assert kept[0].applied[-1].tolist() == [0.0, 0.0]


def test_the_plant_is_deactivated_also_where_it_was_never_activated():
    plant = Watched()
    with pytest.raises(PlantMismatchError, match=r"limits are \[1.0\]; give one positive number for each of u1, u2"):
        run_rig(damped, plant, **{**RUN, "limits": np.ones(1)})
    assert plant.calls == ["deactivate"]


@pytest.mark.parametrize("limits", [[1.0, 0.0], [1.0, -1.0], [1.0, np.nan], [1.0, np.inf]])
def test_limits_are_positive_numbers(limits):
    with pytest.raises(PlantMismatchError, match="give one positive number for each of u1, u2"):
        run_rig(damped, MassSpring(), **{**RUN, "limits": np.array(limits)})


def test_missed_samples_are_late_and_a_lost_plant_leaves_the_run():
    plant, kept = Owner(), []
    with pytest.raises(PlantLostError, match="the cable is off; plug it in"):
        run_rig(damped, plant, **{**RUN, "lockstep": False}, on_end=kept.append)
    run = kept[0]
    assert run.reason == "plant lost"
    assert run.index.tolist() == [0, 1, 2, 5, 6, 8]
    assert run.late.tolist() == [False, False, False, True, False, True]
    assert (run.counters["late"], run.counters["missed"]) == (2, 3)
    assert plant.calls[-1] == "deactivate"


def test_the_clock_is_kept_for_a_plant_that_has_none():
    done = []

    def step(_, values):
        if len(done) == 31:  # one stall of many periods
            time.sleep(0.02)
        return np.zeros(2)

    run = run_rig(step, MassSpring(), **{**RUN, "lockstep": False, "samples": 100}, on_tick=done.append)
    assert done == run.index.tolist() == list(range(100))
    assert run.durations[31] >= 0.019
    assert run.late[32]
    assert run.counters["missed"] >= 18
    assert run.counters["late"] == np.count_nonzero(run.late)
    slack = 9e-3  # of one tick that was held up after it began
    assert run.wall[-1] >= (99 + run.counters["missed"]) / 1000.0 - slack
    assert run.wall[-1] - run.wall[32] >= 67 / 1000.0 - slack  # what was left out is not made up for


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_run_in_order_and_handlers_come_back(number):
    before = {n: signal.signal(n, signal.SIG_DFL) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        plant = Watched()
        run = run_rig(damped, plant, **RUN, on_tick=lambda row: signal.raise_signal(number) if row == 9 else None)
        assert (run.reason, len(run.index)) == ("interrupted", 10)
        assert plant.calls[-1] == "deactivate"
        assert {signal.getsignal(n) for n in before} == {signal.SIG_DFL}
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)


def test_an_ignored_signal_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        run = run_rig(
            damped, MassSpring(), **RUN, on_tick=lambda row: signal.raise_signal(signal.SIGHUP) if row == 9 else None
        )
        assert run.reason == "finished"
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_stop_is_looked_at_before_each_tick():
    plant = Watched()
    run = run_rig(damped, plant, **RUN, stop=lambda: len(plant.written) == 4)
    assert (run.reason, len(run.index)) == ("stopped", 4)


def test_garbage_is_collected_outside_the_run_only():
    inside = []
    assert gc.isenabled()
    run_rig(lambda *_: inside.append(gc.isenabled()) or np.zeros(2), MassSpring(), **RUN)
    assert not any(inside)
    assert gc.isenabled()
