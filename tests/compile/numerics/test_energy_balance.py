"""The energy balance of a masked motion, and offsets of sensors that are measured at rest."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from numba import njit

from masking.compile.numerics.controller_sizes import Sizes
from masking.compile.numerics.energy_balance import energy_balance
from masking.errors import DeclarationError
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from tests.support.kernels import called

BALANCED = {"rate": "1 kHz", "model": "setup_springs", "observer": "disturbance", "homing": 3, "energy_balance": 0.3}


@njit
def virtual(t, y, p, out):
    """eta'' = -eta, with one per second as the bandwidth and the rate p[0]."""
    out[0], out[1], out[2], out[3], out[4] = y[0], y[1], -y[0], 1.0, p[0]


@njit
def momentum(t, e, p, g):
    g[0] = e[1]


@pytest.mark.parametrize("ratio", [-1e-3, 1e-3])
def test_surplus_is_the_energy_that_the_virtual_system_does_not_give(ratio):
    """eta'' = -eta - 2 z eta' has the energy exp(-2 z t)/2; a filter with the motion's frequency halves each power."""
    balance = called(energy_balance(virtual, momentum, Sizes(1, 2, 1, 1, 2, balanced=1)))
    h, memory, o, g, p = 1e-3, np.zeros(8), np.empty(5), np.empty(1), np.array([0.3])
    turning = np.sqrt(1.0 - ratio**2)
    for t in h * np.arange(100_000):
        size, phase = np.exp(-ratio * t), turning * t
        eta = size * (np.cos(phase) + ratio / turning * np.sin(phase))
        damping = balance(t, h, np.array([eta, -size / turning * np.sin(phase)]), memory, p, o, g)
    gained = 0.5 * (np.exp(-2.0 * ratio * t) - 1.0)
    assert memory[6] == pytest.approx(0.5 * gained, rel=0.03)
    assert damping == pytest.approx(0.3 * memory[6] / memory[7])
    assert memory[7] == pytest.approx(0.25 * np.exp(-2.0 * ratio * t), rel=0.2)


def clocks(controller, effects, duration=500):
    """Return |th1 + th2| over the amplitude, and the amplitude over the ideal one, in the last 10 units of time."""
    changes = {"effects": effects, "duration": duration, "record": {"rate": "200 Hz"}}
    found = Experiment.load("huygens_rig").changed(controller=controller, **changes).run()
    last = found.t > found.t[-1] - 10.0 * found.manifest["time_scale"]
    th1, th2, ideal = (found[name][last] for name in ("virtual.th1", "virtual.th2", "ideal.th1"))
    amplitude = np.abs(th1).max()
    return np.abs(th1 + th2).max() / amplitude, amplitude / np.abs(ideal).max()


def test_clocks_keep_their_amplitude_where_friction_is_twice_what_it_was():
    """The observer lags behind friction at each reversal, and what it makes up too late drives the motion."""
    friction = {f"friction{i}": {"fc": "0.01*l*(w1 + w2)**2/4"} for i in (1, 2, 3)}
    _, held = clocks(BALANCED, friction)
    _, free = clocks({**BALANCED, "energy_balance": None}, friction)
    assert held == pytest.approx(1.0, abs=0.05)
    assert free > 1.2


def test_balance_of_a_system_in_si_units_is_that_of_the_system_in_scales(tmp_path):
    """With 10 rad/s as 1, and its rate in the same proportion, what is filtered and taken out is the same."""
    packaged = Experiment.load("two_carts")
    fastest = float(np.sqrt(10.0**2 + 2.0 * 3.0**2))
    scaled = {
        "name": "two masses in scales",
        "source": "the packaged two masses, with time in units of that of the fastest mode over two pi",
        "coordinates": {"x1": {"meaning": "first"}, "x2": {"meaning": "second"}},
        "parameters": {"w0": {"value": 10.0 / fastest}, "wc": {"value": 3.0 / fastest}},
        "equations": {"x1''": "-w0**2*x1 - wc**2*(x1 - x2)", "x2''": "-w0**2*x2 - wc**2*(x2 - x1)"},
        "energy": "(x1'**2 + x2'**2 + w0**2*(x1**2 + x2**2) + wc**2*(x1 - x2)**2)/2",
    }
    (tmp_path / "scaled.yaml").write_text(yaml.safe_dump(scaled), encoding="utf-8")
    controller = {"rate": "500 Hz", "observer": "disturbance", "homing": 2}
    runs = [
        packaged.changed(duration=3, controller={**controller, "energy_balance": 0.3 * fastest}).run(),
        packaged.changed(
            virtual=str(tmp_path / "scaled.yaml"),
            transform={"expressions": {"x1": "100*a_x", "x2": "100*b_x"}},
            time_scale=1.0 / fastest,
            initial={"x1": 1, "x2": 0},
            duration=3 * fastest,
            controller={**controller, "energy_balance": 0.3},
        ).run(),
    ]
    first, second = (run["rig.a_x"][:1500] for run in runs)
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-9)


def test_offsets_are_measured_at_rest():
    """Homing ends where the sensors say, which is the initial state only as far as their offsets are known."""
    found = []
    for rest, offset in ((None, False), (None, {"e0": 0.002}), (10, {"e0": 0.002})):
        changes = {"effects": {"offset": offset, "noise": False}, "duration": 1}
        controller = {**BALANCED, "rest": rest, "observer": {"kind": "disturbance", "noise": 1e-4}}
        start = Experiment.load("huygens_rig").changed(controller=controller, **changes).run()
        reached, wanted = (start.manifest["start"][name] for name in ("reached", "wanted"))
        found.append(max(abs(reached[name] - wanted[name]) for name in reached))
    none, unknown, measured = found
    assert unknown > 5.0 * none
    assert measured < 0.2 * unknown


@pytest.mark.parametrize(
    ("controller", "said"),
    [
        ({"energy_balance": 0.3}, "controller.energy_balance: energy_balance is for a controller that runs at a rate"),
        ({"rate": "1 kHz", "rest": 5}, "controller.rest: offsets are measured before homing, and there is none"),
        (
            {"rate": "1 kHz", "observer": "differences", "energy_balance": 0.3},
            "controller.energy_balance: energy_balance needs an observer that follows a model",
        ),
    ],
)
def test_what_cannot_be_held_is_refused(controller, said):
    with pytest.raises(DeclarationError) as error:
        Experiment.load("huygens_rig").changed(controller=controller)
    assert said in str(error.value)


def test_a_virtual_system_without_energy_has_no_balance(tmp_path):
    (packaged,) = registry.load_model("huygens").files
    content = yaml.safe_load(Path(packaged).read_text(encoding="utf-8"))
    del content["energy"]
    (tmp_path / "clocks.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(DeclarationError) as error:
        Experiment.load("huygens_rig").changed(virtual=str(tmp_path / "clocks.yaml"))
    assert "has no energy to balance" in str(error.value)
