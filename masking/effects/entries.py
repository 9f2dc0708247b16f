"""The dictionary of physical effects.

Expressions are in the language of declarations, over the effect's own parameters and states and

* in an element: `d`, its displacement, and `d_rate`, the rate of that; they give the force f;
* in a sensor: `s`, the value that it should give, and for noise `xi`, a sample of the standard normal distribution;
* in an actuator: `u`, the value that it is told.

Units are written with the units of the place: `F` of force and `D` of displacement of an element, `S` of a sensor, `U`
of an actuator, and `s` of time; `prior` and `nominal` are in coherent SI units for a rig the size of a hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Where = Literal["element", "sensor", "actuator", "loop"]
Bounds = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect.

    `value` is taken where none is given, and None where one must be; `prior` is the range in which values are expected,
    `nominal` a usual one; `bounds` are the least and the largest that make sense.
    """

    unit: str
    meaning: str
    prior: tuple[float, float]
    nominal: float
    value: float | None = None
    bounds: Bounds = (None, None)


@dataclass(frozen=True, slots=True)
class EffectState:
    """An internal state of an effect, 0 at first, with the expression of its rate."""

    rate: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical effect: the expression of what it does, where it may sit, what causes it and what helps."""

    name: str
    meaning: str
    where: Where
    expression: str
    parameters: Mapping[str, EffectParameter]
    cause: str
    remedy: str
    source: str
    states: Mapping[str, EffectState] = field(default_factory=dict)


_POSITIVE: Bounds = (1e-12, None)
_NOT_NEGATIVE: Bounds = (0.0, None)
_SLIDING = EffectParameter(
    "D/s", "rate of displacement at which the force has 76 % of its size", (1e-5, 1e-2), 1e-3, 1e-3, _POSITIVE
)
_COULOMB = EffectParameter("F", "force while sliding", (1e-3, 2.0), 0.1, None, _NOT_NEGATIVE)
_STATIC = EffectParameter("F", "force that breaks it loose", (1e-3, 3.0), 0.15, None, _NOT_NEGATIVE)
_STRIBECK = EffectParameter(
    "D/s", "rate at which the force has fallen most of the way", (1e-3, 0.1), 1e-2, 1e-2, _POSITIVE
)
_CONTACT = EffectParameter("F/D", "stiffness of the contact", (1e3, 1e6), 2e4, None, _NOT_NEGATIVE)
_SIDE = EffectParameter("1", "1: it is beyond the edge upwards, -1: downwards", (-1.0, 1.0), 1.0, 1.0, (-1.0, 1.0))
_SAMPLED = "raise the resolution of the converter or amplify the signal to fill its range; the observer smooths it"

EFFECTS: dict[str, Effect] = {
    "constant_force": Effect(
        "constant_force",
        "A force that is always there.",
        "element",
        "f0",
        {"f0": EffectParameter("F", "force", (-5.0, 5.0), 0.1)},
        cause="weight on a rig that is not level, a spring at rest elsewhere than assumed, an offset of an amplifier",
        remedy="level the rig or move the zero of the sensor; the model needs only its value, which is cancelled",
        source="Rijlaarsdam (2008), (4.14), rho_i0 of Table B.4",
    ),
    "linear_spring": Effect(
        "linear_spring",
        "The stiffness is larger than declared, by k.",
        "element",
        "k*d",
        {"k": EffectParameter("F/D", "additional stiffness", (-500.0, 500.0), 10.0)},
        cause="a wrong spring constant or mass, a cable that pulls, a leaf spring clamped at another length",
        remedy="correct the eigenfrequency in the model",
        source="Rao (2011), Mechanical Vibrations, section 1.7",
    ),
    "polynomial_spring": Effect(
        "polynomial_spring",
        "The force of a spring as a polynomial of its displacement, in addition to what is declared.",
        "element",
        "k0 + d*(k1 + d*(k2 + d*(k3 + d*(k4 + d*k5))))",
        {
            "k0": EffectParameter("F", "force at rest", (-5.0, 5.0), 0.1, 0.0),
            "k1": EffectParameter("F/D", "linear coefficient", (-500.0, 500.0), 10.0, 0.0),
            "k2": EffectParameter("F/D**2", "quadratic coefficient", (-1e5, 1e5), -1e3, 0.0),
            "k3": EffectParameter("F/D**3", "cubic coefficient", (-1e7, 1e7), 1e5, 0.0),
            "k4": EffectParameter("F/D**4", "coefficient of the fourth power", (-1e10, 1e10), 1e7, 0.0),
            "k5": EffectParameter("F/D**5", "coefficient of the fifth power", (-1e12, 1e12), 1e9, 0.0),
        },
        cause="large deflection of leaf springs, a clamp that lets go, asymmetric mounting, forces of magnets",
        remedy="measure the force over the whole stroke and let the controller cancel it",
        source="Rijlaarsdam (2008), (4.14) and Table B.4",
    ),
    "hardening_spring": Effect(
        "hardening_spring",
        "A cubic spring: stiffer the further it is stretched, or softer where k3 is negative.",
        "element",
        "k3*d**3",
        {"k3": EffectParameter("F/D**3", "cubic coefficient", (-1e7, 1e7), 1e5)},
        cause="leaf springs that are stretched when they bend, large rotations",
        remedy="give the ends of the springs room to move, or let the controller cancel the force",
        source="Kovacic and Brennan (2011), The Duffing Equation, (1.1)",
    ),
    "viscous_damping": Effect(
        "viscous_damping",
        "A force in proportion to the rate of displacement, in addition to what is declared.",
        "element",
        "c*d_rate",
        {"c": EffectParameter("F*s/D", "additional damping", (-10.0, 10.0), 0.5)},
        cause="eddy currents in the voice coil, air, lubricated bearings; a wrong damping ratio",
        remedy="correct the damping ratio in the model",
        source="Rayleigh (1877), The Theory of Sound, volume 1, section 81",
    ),
    "quadratic_damping": Effect(
        "quadratic_damping",
        "A resistance that grows with the square of the rate of displacement.",
        "element",
        "c*d_rate*abs(d_rate)",
        {"c": EffectParameter("F*s**2/D**2", "coefficient", (0.0, 100.0), 1.0, None, _NOT_NEGATIVE)},
        cause="drag of air or of a liquid on plates and arms, flow through an orifice",
        remedy="make the moving surfaces smaller, or add it to the model",
        source="Nayfeh and Mook (1979), Nonlinear Oscillations, section 3.3.2",
    ),
    "dry_friction": Effect(
        "dry_friction",
        "Coulomb's friction: a force of one size against the motion; the smooth sign lets it creep at rest.",
        "element",
        "fc*tanh(d_rate/vs)",
        {"fc": _COULOMB, "vs": _SLIDING},
        cause="sliding bearings, a coil that touches its magnet, cables that rub",
        remedy="align the coil and its guide, use leaf springs or air bearings; a disturbance observer follows it",
        source="Olsson, Astrom, Canudas de Wit, Gafvert and Lischinsky (1998), Eur. J. Control 4, section 2",
    ),
    "stribeck_friction": Effect(
        "stribeck_friction",
        "Dry friction that is larger at small rates, where the lubricant does not carry yet.",
        "element",
        "(fc + (fs - fc)*exp(-(d_rate/vst)**2))*tanh(d_rate/vs)",
        {"fc": _COULOMB, "fs": _STATIC, "vst": _STRIBECK, "vs": _SLIDING},
        cause="lubricated sliding contacts and ball bearings at low speed",
        remedy="a lubricant with friction modifiers, a dither on the input, or a guide without contact",
        source="Armstrong-Helouvry, Dupont and Canudas de Wit (1994), Automatica 30, (2)",
    ),
    "lugre_friction": Effect(
        "lugre_friction",
        "Friction of bristles that bend before they slip: stiction, presliding displacement and hysteresis.",
        "element",
        "s0*z + s1*(d_rate - s0*abs(d_rate)*z/(fc + (fs - fc)*exp(-(d_rate/vst)**2))) + s2*d_rate",
        {
            "fc": EffectParameter("F", _COULOMB.meaning, _COULOMB.prior, _COULOMB.nominal, None, _POSITIVE),
            "fs": EffectParameter("F", _STATIC.meaning, _STATIC.prior, _STATIC.nominal, None, _POSITIVE),
            "vst": _STRIBECK,
            "s0": EffectParameter("F/D", "stiffness of the bristles", (1e2, 1e6), 1e4, None, _NOT_NEGATIVE),
            "s1": EffectParameter("F*s/D", "damping of the bristles", (0.0, 1e3), 10.0, 0.0, _NOT_NEGATIVE),
            "s2": EffectParameter("F*s/D", "viscous friction", (0.0, 10.0), 0.1, 0.0, _NOT_NEGATIVE),
        },
        cause="dry contacts that stick between reversals, such as a guide or a rubbing cable",
        remedy="remove the contact; small motions need this model, large ones only dry friction",
        source="Canudas de Wit, Olsson, Astrom and Lischinsky (1995), IEEE Trans. Autom. Control 40(3), (1)-(4)",
        states={
            "z": EffectState(
                "d_rate - s0*abs(d_rate)*z/(fc + (fs - fc)*exp(-(d_rate/vst)**2))", "D", "deflection of the bristles"
            )
        },
    ),
    "hysteresis": Effect(
        "hysteresis",
        "A spring that remembers: its force follows another path back, in the normalised form of Bouc and Wen.",
        "element",
        "k*z",
        {
            "k": EffectParameter("F/D", "stiffness where the motion turns", (0.0, 1e4), 100.0, None, _NOT_NEGATIVE),
            "zmax": EffectParameter("D", "displacement at which it yields", (1e-5, 1e-2), 1e-3, None, _POSITIVE),
            "beta": EffectParameter("1", "shape: 1/2 unloads in a straight line", (0.5, 2.0), 0.5, 0.5, (0.5, None)),
            "n": EffectParameter("1", "sharpness of yielding", (1.0, 10.0), 2.0, 2.0, (1.0, None)),
        },
        cause="joints that slip a little, material damping of rubber or bonded springs, magnetic materials",
        remedy="clamp joints tighter and avoid rubber; the force can be cancelled once the model holds it",
        source="Wen (1976), J. Eng. Mech. Div. 102; Ikhouane and Rodellar (2007), Systems with Hysteresis, (2.15)",
        states={
            "z": EffectState(
                "d_rate - beta*abs(d_rate)*(z/zmax)*abs(z/zmax)**(n - 1) - (1 - beta)*d_rate*abs(z/zmax)**n",
                "D",
                "elastic part of the displacement",
            )
        },
    ),
    "backlash": Effect(
        "backlash",
        "A spring behind play: no force within the gap, linear beyond it on both sides.",
        "element",
        "k*(d - min(max(d, -gap/2), gap/2))",
        {
            "k": EffectParameter("F/D", "stiffness beyond the gap", (1.0, 1e6), 1e3, None, _NOT_NEGATIVE),
            "gap": EffectParameter("D", "width of the play", (0.0, 1e-2), 1e-3, None, _NOT_NEGATIVE),
        },
        cause="gears, couplings, loose screws, pins in slotted holes",
        remedy="preload the joint or replace it by a flexure",
        source="Nordin and Gutman (2002), Automatica 38, section 2",
    ),
    "stop": Effect(
        "stop",
        "An end stop: a contact that pushes back beyond an edge and never pulls.",
        "element",
        "side*k*max(side*(d - edge), 0)*max(1 + c*side*d_rate, 0)",
        {
            "k": _CONTACT,
            "edge": EffectParameter("D", "displacement at which the contact begins", (-0.02, 0.02), 5e-3),
            "c": EffectParameter(
                "s/D", "damping of the contact per force and rate", (0.0, 50.0), 1.0, 0.0, _NOT_NEGATIVE
            ),
            "side": _SIDE,
        },
        cause="the end of the stroke: a bumper, the housing of the coil",
        remedy="stay within the stroke: smaller amplitudes, or the limits of the plant",
        source="Hunt and Crossley (1975), J. Appl. Mech. 42, 440-445",
    ),
    "local_friction": Effect(
        "local_friction",
        "Dry friction in one part of the stroke only, beyond an edge.",
        "element",
        "fc*tanh(d_rate/vs)*(1 + tanh(side*(d - edge)/width))/2",
        {
            "fc": _COULOMB,
            "edge": EffectParameter("D", "displacement at which it begins", (-0.02, 0.02), 5.8e-3),
            "width": EffectParameter("D", "over which it begins", (1e-5, 1e-3), 2e-4, 2e-4, _POSITIVE),
            "vs": _SLIDING,
            "side": _SIDE,
        },
        cause="a coil that touches its magnet in one part of the stroke, a burr, a cable that is caught",
        remedy="align the coil and look for marks at that position; otherwise keep the motion on the free side",
        source="Olsson, Astrom, Canudas de Wit, Gafvert and Lischinsky (1998), Eur. J. Control 4, position dependence",
    ),
    "sensor_offset": Effect(
        "sensor_offset",
        "The sensor gives a value where there is none.",
        "sensor",
        "s + e0",
        {"e0": EffectParameter("S", "offset", (-0.5, 0.5), 0.01)},
        cause="a zero that was not adjusted, drift of an amplifier with temperature",
        remedy="adjust the zero at rest before each run",
        source="Doebelin (2003), Measurement Systems, section 3.2",
    ),
    "sensor_gain": Effect(
        "sensor_gain",
        "The sensor's gain is not the declared one.",
        "sensor",
        "s*(1 + e)",
        {"e": EffectParameter("1", "relative error of the gain", (-0.3, 0.3), 0.02)},
        cause="a calibration at another distance, temperature or supply voltage",
        remedy="calibrate against a gauge over the whole stroke",
        source="Doebelin (2003), Measurement Systems, section 3.2",
    ),
    "sensor_saturation": Effect(
        "sensor_saturation",
        "The sensor gives no more than its limit.",
        "sensor",
        "min(max(s, -limit), limit)",
        {"limit": EffectParameter("S", "largest magnitude", (0.1, 20.0), 10.0, None, _NOT_NEGATIVE)},
        cause="the end of the range of a sensor, amplifier or converter",
        remedy="lower the gain or stay within the range; beyond it the state cannot be known",
        source="Tao and Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 1",
    ),
    "sensor_lag": Effect(
        "sensor_lag",
        "The sensor follows with a delay of first order.",
        "sensor",
        "m",
        {"tau": EffectParameter("s", "time constant", (1e-5, 0.1), 1e-3, None, _POSITIVE)},
        cause="a filter in the amplifier, a slow sensor",
        remedy="raise the cut-off of the filter, or put it into the observer's model",
        source="Doebelin (2003), Measurement Systems, section 3.3",
        states={"m": EffectState("(s - m)/tau", "S", "filtered value")},
    ),
    "quantisation": Effect(
        "quantisation",
        "The sensor gives multiples of a step; a step of 0 leaves the value as it is.",
        "sensor",
        "where(step > 0, step*floor(s/step + 1/2), s)",
        {"step": EffectParameter("S", "step", (0.0, 0.1), 3e-4, None, _NOT_NEGATIVE)},
        cause="a converter of finite resolution, an encoder",
        remedy=_SAMPLED,
        source="Widrow and Kollar (2008), Quantization Noise, ch. 1",
    ),
    "noise": Effect(
        "noise",
        "White noise on what the sensor gives, fresh in each sample.",
        "sensor",
        "s + sigma*xi",
        {"sigma": EffectParameter("S", "standard deviation of a sample", (0.0, 0.1), 1e-3, None, _NOT_NEGATIVE)},
        cause="thermal noise of the electronics, stray fields, vibration of the sensor's mount",
        remedy="shield and shorten cables, filter before sampling; the observer trades it against speed",
        source="Astrom (1970), Introduction to Stochastic Control Theory, ch. 2",
    ),
    "actuator_gain": Effect(
        "actuator_gain",
        "The actuator's gain is not the declared one.",
        "actuator",
        "(1 + e)*u",
        {"e": EffectParameter("1", "relative error of the gain", (-0.5, 0.5), 0.05)},
        cause="a wrong motor constant, a weaker magnet, a coil outside its homogeneous field",
        remedy="identify the gain anew with the rig as it is",
        source="Rijlaarsdam (2008), Table 4.2, c_i",
    ),
    "actuator_offset": Effect(
        "actuator_offset",
        "The actuator acts where it is told nothing.",
        "actuator",
        "u + u0",
        {"u0": EffectParameter("U", "offset", (-0.5, 0.5), 0.01)},
        cause="an amplifier or converter whose zero was not adjusted",
        remedy="adjust the zero, or add its negative to the input",
        source="Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, ch. 10",
    ),
    "saturation": Effect(
        "saturation",
        "The actuator gives no more than its limit.",
        "actuator",
        "min(max(u, -limit), limit)",
        {"limit": EffectParameter("U", "largest magnitude", (0.01, 50.0), 0.42, None, _NOT_NEGATIVE)},
        cause="the supply of the amplifier, a fuse, a limit in software",
        remedy="ask for less: smaller amplitude, slower time scale, a virtual system nearer to the rig",
        source="Tao and Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 1",
    ),
    "dead_zone": Effect(
        "dead_zone",
        "The actuator does nothing for small values.",
        "actuator",
        "u - min(max(u, -width), width)",
        {"width": EffectParameter("U", "largest value without an answer", (0.0, 1.0), 0.01, None, _NOT_NEGATIVE)},
        cause="the crossover of an amplifier, a valve that overlaps",
        remedy="a bias current, or add the width in the direction of the command",
        source="Tao and Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 1",
    ),
    "dac_quantisation": Effect(
        "dac_quantisation",
        "The actuator takes multiples of a step; a step of 0 leaves the value as it is.",
        "actuator",
        "where(step > 0, step*floor(u/step + 1/2), u)",
        {"step": EffectParameter("U", "step", (0.0, 0.1), 3e-4, None, _NOT_NEGATIVE)},
        cause="a converter of finite resolution",
        remedy=_SAMPLED,
        source="Widrow and Kollar (2008), Quantization Noise, ch. 1",
    ),
    "actuator_lag": Effect(
        "actuator_lag",
        "The actuator follows with a delay of first order.",
        "actuator",
        "a",
        {"tau": EffectParameter("s", "time constant", (1e-5, 0.1), 1e-3, None, _POSITIVE)},
        cause="the inductance of the coil under voltage, the bandwidth of the amplifier",
        remedy="drive the coil by a current amplifier, or lead the command by the time constant",
        source="Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, ch. 2",
        states={"a": EffectState("(u - a)/tau", "U", "value that acts")},
    ),
    "thermal": Effect(
        "thermal",
        "The coil warms up; its driver lets no more through than keeps its mean power at a limit.",
        "actuator",
        "where(P < limit, u, min(max(u, -sqrt(limit/r)), sqrt(limit/r)))",
        {
            "r": EffectParameter("W/U**2", "power per squared value", (1e-3, 1e3), 10.0, None, _NOT_NEGATIVE),
            "tau": EffectParameter("s", "thermal time constant", (1.0, 1e3), 10.0, 10.0, _POSITIVE),
            "limit": EffectParameter("W", "largest mean power", (0.1, 100.0), 8.0, 8.0, _NOT_NEGATIVE),
        },
        cause="the resistance of the coil turns current into heat faster than it is carried away",
        remedy="run for shorter or at smaller amplitude, cool the coil",
        source="Incropera and DeWitt (2002), Fundamentals of Heat and Mass Transfer, section 5.1",
        states={
            "P": EffectState("(where(P < limit, r*u**2, min(r*u**2, limit)) - P)/tau", "W", "mean power of the coil")
        },
    ),
    "delay": Effect(
        "delay",
        "What the controller commands acts some samples late.",
        "loop",
        "",
        {"samples": EffectParameter("1", "whole samples", (0.0, 20.0), 1.0, None, _NOT_NEGATIVE)},
        cause="the time of computing, buffers of converters and drivers, a network",
        remedy="predict the state by the delay before computing the command, or raise the rate",
        source="Astrom and Wittenmark (1997), Computer-Controlled Systems, section 3.5",
    ),
}
