"""Newton's third law: what acts between bodies leaves the momentum of all of them as it is.

The momentum of a translation s is P = s . dT/dv, with the kinetic energy T that the model declares (Noether). Inputs,
springs, dampers and effects between the oscillators and the beam cannot change it; the ground, and gravity, can.
"""

import numpy as np
import pytest
import sympy as sp

from masking.control.rig.twin import Twin
from masking.model.declaration import catalogue, registry
from masking.model.declaration.schema import EffectChange
from masking.model.effects import EFFECTS
from masking.model.modelling.model import Model, load_model

# What holds each model to the ground, or is gravity, and the coordinates that all move by the same.
LINE, ANGLE = ("x1", "x2", "x3"), ("th1", "th2", "th3")
GROUND = {
    "setup": (LINE, "w3 c3"), "setup_driven": (LINE, "w3 c3"), "setup_identical": (LINE, "w3 c3"),
    "setup_shapes": (LINE, "w3 c3"), "setup_undamped": (LINE, "w3 c3"), "setup_springs": (LINE, "z3 c3"),
    "setup_springs_table": (LINE, "z3 c3"),
    "setup_lagrangian": (LINE, "k3 b3 kv3"),
    "duffing": (LINE, "w3"), "duffing_driven": (LINE, "w3"), "duffing_si": (LINE, "w3"), "duffing_enoc": (LINE, "k b"),
    "discs": (ANGLE, "w3"), "discs_eccentric": (ANGLE, "w3 nu1 nu2 nu3"), "discs_driven": (ANGLE, "w3 nu1 nu2 nu3"),
    "discs_enoc": (ANGLE, "w3 nu1 nu2 nu3"),
    "two_masses": (("x1", "x2"), "w0"), "pendula": (("x",), "k b"), "cart_pendulum": (("x",), "k c kf"),
    "huygens": (("x",), "Om"), "huygens_lagrangian": (("x",), "Om"),
}  # fmt: skip
# One body, held by the ground; forces that are declared without a reaction; and models without an energy.
ALONE = {
    "setup_oscillator",
    "setup_controlled",
    "van_der_pol",
    "light_cart",
    "cart",
    "bouc_wen",
    "delayed_oscillators",
    "escapements",
    "bouncing_ball",
    "stopped_mass",
    "relaxing_mass",
    "bristled_mass",
    "building",
    "cart_by_voltage",
    "magnet",
    "storey",
}

BETWEEN = {"V1", "V2", "u1", "u2"}  # actuators between an oscillator and the beam
GROUNDED = {"V3", "u3"}  # actuators between the beam and the ground
# Rigs of another kind: a coil, a magnet or a cylinder between the ground and what it moves.
CARTS = {"cart", "cart_by_voltage", "cart_pendulum", "magnet", "storey"}


def test_every_packaged_model_is_examined():
    assert GROUND.keys() | ALONE == set(catalogue.names("model"))


def change_of_momentum(model, moving, state):
    """Return dP/dt, symbolic where `state` leaves symbols."""
    s = model.equations.symbols
    energy = model.equations.energy
    shift = [s.by_name[f"{name}'"] for name in moving]
    momentum = sum(sp.diff(energy, v) for v in shift)
    rate = sum(sp.diff(momentum, q) * v for q, v in zip(s.q, s.v, strict=True))
    rate += sum(sp.diff(momentum, v) * a for v, a in zip(s.v, model.equations.accelerations, strict=True))
    return rate.subs(state)


def any_state(model, rng, **changes):
    """Return random values of all symbols near those declared, some of them as given."""
    s = model.equations.symbols
    values = {symbol: value * rng.uniform(0.5, 1.5) for symbol, value in model_values(model).items()}
    values |= {x: rng.uniform(-1.0, 1.0) for x in (*s.q, *s.v, *s.u)}
    return values | {s.by_name[name]: value for name, value in changes.items()}


def model_values(model):
    return dict(zip(model.equations.symbols.p, map(float, model.values()), strict=True))


@pytest.mark.parametrize("name", GROUND)
def test_a_model_that_nothing_holds_keeps_its_momentum(name):
    moving, ground = GROUND[name]
    model, rng = load_model(name), np.random.default_rng(1)
    for _ in range(3):
        free = any_state(model, rng, **dict.fromkeys(ground.split(), 0.0))
        assert abs(change_of_momentum(model, moving, free)) < 1e-10
        held = any_state(model, rng)
        assert abs(change_of_momentum(model, moving, held)) > 1e-6  # the ground and gravity do change it


@pytest.mark.parametrize("effect", [name for name, entry in EFFECTS.items() if entry.where == "element"])
def test_an_effect_between_bodies_keeps_their_momentum(effect):
    given = {n: p.value if p.value is not None else p.tried[0] if p.tried else 0.01
             for n, p in EFFECTS[effect].parameters.items()}  # fmt: skip
    model = load_model("setup").attach(effect, "spring1", label="e", **given)
    s, state = model.equations.symbols, any_state(model, np.random.default_rng(2), w3=0.0, c3=0.0, e_on=1.0)
    state |= dict.fromkeys(s.s, 0.3) | {s.by_name["t"]: 0.7}
    assert abs(change_of_momentum(model, LINE, state).evalf()) < 1e-10


@pytest.mark.parametrize("plant", [name for name in catalogue.names("plant") if name not in CARTS])
def test_a_packaged_rig_pushes_no_body_without_another(plant):
    twin = Twin.load(plant)
    channels, elements = twin.actuators, twin.base.elements
    assert set(channels) <= BETWEEN | GROUNDED
    s, energy = twin.model.equations.symbols, Model(registry.load_model(twin.declaration.model)).equations.energy
    values = model_values(twin.model)
    masses = np.array([float(sp.diff(energy, s.by_name[f"{x}'"], 2).subs(values)) for x in LINE])

    def force(twin, state, command):
        """Return the sum of m_i x_i'', per mass of the beam."""
        rate = np.empty(len(state))
        twin.kernels.twin_derivative(0.0, state, command, twin.values(), rate)
        return float(masses @ rate[3:6])

    rng = np.random.default_rng(3)
    state = twin.rest(0.004 * rng.uniform(-1.0, 1.0, 3))
    state[3:6] = 0.05 * rng.uniform(-1.0, 1.0, 3)
    still = force(twin, state, np.zeros(len(channels)))
    for i, name in enumerate(channels):
        pushed = force(twin, state, 0.1 * np.eye(len(channels))[i])
        assert (abs(pushed - still) < 1e-9) == (name in BETWEEN), name
    internal = {e.path.removeprefix("effects.") for e in twin.effects if e.entry.where == "element"
                and e.at != "beam"}  # fmt: skip
    without = twin.changed({name: EffectChange(enabled=False) for name in internal})
    assert force(without, state, np.zeros(len(channels))) == pytest.approx(still, abs=1e-9)
    assert {"spring1", "spring2", "beam"} == set(elements)
