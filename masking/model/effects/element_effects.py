"""Physical effects in an element of a model: forces of its displacement `d`, its rate `d_rate`, and time `t`.

One is a force of the acceleration of the displacement, `d_acc`: an inertia.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from masking.model.effects import starts
from masking.model.effects.entry import NOT_NEGATIVE, POSITIVE, Effect, EffectParameter, EffectState, Trial

_SLIDING = EffectParameter(
    "D/s", "rate of displacement at which the force has 76 % of its size", (1e-5, 1e-2), 1e-3, 1e-3, POSITIVE
)
_COULOMB = EffectParameter("F", "force while sliding", (1e-3, 2.0), 0.1, None, NOT_NEGATIVE)
_STATIC = EffectParameter("F", "force that breaks it loose", (1e-3, 3.0), 0.15, None, NOT_NEGATIVE)
_STRIBECK = EffectParameter(
    "D/s", "rate at which the force has fallen most of the way", (1e-3, 0.1), 1e-2, 1e-2, POSITIVE
)
_DRAG = EffectParameter("D/s", "rate at which the drag is largest", (1e-2, 10.0), 1.0, None, POSITIVE, (0.3, 0.7, 1.5))
_CONTACT = EffectParameter("F/D", "stiffness of the contact", (1e3, 1e6), 2e4, None, NOT_NEGATIVE)
_REVERSAL = EffectParameter("F/D", "stiffness at reversals", (0.0, 1e4), 100.0, None, NOT_NEGATIVE)
_REACHES = (0.003, 0.01, 0.03, 0.1, 0.3)  # from nearly dry friction to nearly a spring, in half-decades
_YIELDS = (0.01, 0.03, 0.08, 0.2, 0.4, 0.8)  # beyond 1 it never yields and is a spring
_LOOPS = (-1.3, 0.0)  # one that opens, one that yields
_BENDS = (0.15, 0.6, 2.4)  # bends soon, within the motion, or hardly
_GAPS = (0.05, 0.15, 0.3, 0.5, 0.8, 1.2)  # from a play that hardly shows up to one in which contact is rare
_TURNS = (0.12, 0.2, 0.35, 0.6, 1.2, 3.0)  # from several turns within the travel to nearly a cubic spring
_REACH = EffectParameter("D", "displacement over which it builds up", (1e-6, 1e-2), 1e-4, None, POSITIVE, _REACHES)
_YIELD = EffectParameter("D", "displacement at which it yields", (1e-5, 1e-2), 1e-3, None, POSITIVE, _YIELDS)
_SHAPE = EffectParameter("1", "shape: above -1 it yields, below it opens", (-2.0, 2.0), 1.0, 1.0, tried=_LOOPS)
_SLIPPING = "joints that slip a little, material damping of rubber or bonded springs, magnetic materials"
_CLAMPED = "clamp joints tighter and avoid rubber"
_SIDE = EffectParameter("1", "1: it is beyond the edge upwards, -1: downwards", (-1.0, 1.0), 1.0, 1.0, (-1.0, 1.0))
# The square alone, with the cube, and all powers: the fewer are estimated, the weaker a force is still found.
_POWERS = (Trial(factors=("k2",)), Trial(factors=("k2", "k3")), Trial(factors=("k2", "k3", "k4", "k5")))
# First a contact that sticks; then a smooth sign, where the record shows its width.
_STUCK, _SMOOTH = Trial(starts.turn, sticks=True), Trial(starts.turns, ("vs",))
# Breaking loose takes a little more than sliding, or twice as much.
_BRISTLES = tuple(Trial(starts.bristles(static), ("fc", "fs", "vst", "s1")) for static in (1.2, 2.0))

# While a contact sticks, resistance and memory hold it, as stiff as a step of integration bears; the memory of one that
# slides leads a little, so that it turns round neither late nor early on average.
_HELD = {
    "c": EffectParameter("F*s/D", "resistance while it sticks; 0 lets it creep", (0.0, 1e6), 1e3, 0.0, NOT_NEGATIVE),
    "hold": EffectParameter("1/s", "rate at which its memory follows", (0.0, 1e5), 1e3, 0.0, NOT_NEGATIVE),
}
_FALLING = "fc + (fs - fc)*exp(-(d_rate/vst)**2)"
_BENDING = f"d_rate - s0*abs(d_rate)*z/({_FALLING})"  # rate of a bristle
_WEN = "d_rate - (beta*abs(d_rate)*sign(z) + (1 - beta)*d_rate)*abs(z/zmax)**n"
_BOUC_WEN = "d_rate - (abs(d_rate)*sign(z) + delta*d_rate)*abs(z/x0)**n"
_CARRIED = "-(2*pi*nu)**2*z - 2*zeta*2*pi*nu*(w - d_rate)"  # acceleration of a mass that is carried
_BEYOND = "(1 + tanh(side*(d - edge)/width))"
_HOLDING = "0.55*mobility*step"  # inverse of the resistance
_BY_STEP = {"c": f"1/({_HOLDING})", "hold": "1/(1.75*step)"}


def _sliding(level: str, smooth: str, first: str) -> dict[str, Any]:
    """Law of friction of a `level` of the force while it slides, as fields of its entry.

    `smooth` is the law with a smooth sign, which lets it creep; `first`, how large the force may be where a record
    begins.
    """
    s, level = "(z + c*d_rate)", f"({level})"
    target = f"min(min(max({s}, -2*{level} - {s}), max(2*{level} - {s}, -{level})), {level})"
    state = EffectState(f"hold*({target} - z)", "F", "force that it remembers", f"where(c > 0, {first}, 0)")
    expression = f"where(c > 0, min(max({s}, -{level}), {level}), {smooth})"
    least = {"vs": f"{_HOLDING}*{first}"}  # a sign as steep as what holds a contact that sticks
    law = {"expression": expression, "states": {"z": state}, "at_zero": {"c": smooth}}
    return {**law, "by_step": _BY_STEP, "least": least}


_spring, _damping, _friction, _hysteresis, _overflow = (
    partial(Effect, family=family) for family in ("springs", "damping", "friction", "hysteresis", "overflow")
)

ELEMENTS: tuple[Effect, ...] = (
    _spring(
        "constant_force",
        "A constant force.",
        "f0",
        {"f0": EffectParameter("F", "force", (-5.0, 5.0), 0.1)},
        cause="weight on a rig that is not level, a spring at rest elsewhere than assumed, an offset of an amplifier",
        remedy="level the rig or move the zero of the sensor",
        source="Rijlaarsdam (2008), (4.14), rho_i0 of Table B.4",
        absorbed_by="force at rest",
        is_linear=True,
    ),
    _spring(
        "linear_spring",
        "The stiffness is larger than declared, by k.",
        "k*d",
        {"k": EffectParameter("F/D", "additional stiffness", (-500.0, 500.0), 10.0)},
        cause="a wrong spring constant or mass, a cable that pulls, a leaf spring clamped at another length",
        remedy="measure the stiffness anew, with the rig as it is",
        source="Rao (2011), Mechanical Vibrations, section 1.7",
        absorbed_by="stiffness",
        is_linear=True,
        joins=True,
    ),
    _spring(
        "polynomial_spring",
        "A polynomial of the displacement, in addition to the declared force of the spring.",
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
        remedy="measure the force over the whole stroke, or stay near its middle",
        source="Rijlaarsdam (2008), (4.14) and Table B.4",
        trials=_POWERS,
        nested=("hardening_spring",),
        is_sum=True,
    ),
    _spring(
        "hardening_spring",
        "A cubic spring: stiffer the further it is stretched, or softer if k3 is negative.",
        "k3*d**3",
        {"k3": EffectParameter("F/D**3", "cubic coefficient", (-1e7, 1e7), 1e5)},
        cause="leaf springs that are stretched when they bend, large rotations",
        remedy="give the ends of the springs room to move, or stay near the middle of the stroke",
        source="Kovacic and Brennan (2011), The Duffing Equation, (1.1)",
        joins=True,
        calibrated=("k3",),
    ),
    _damping(
        "viscous_damping",
        "A force in proportion to the rate of displacement, in addition to the declared damping.",
        "c*d_rate",
        {"c": EffectParameter("F*s/D", "additional damping", (-10.0, 10.0), 0.5)},
        cause="eddy currents in the voice coil, air, lubricated bearings; a wrong damping ratio",
        remedy="measure the decay anew, with the rig as it is",
        source="Rayleigh (1877), The Theory of Sound, volume 1, section 81",
        absorbed_by="damping",
        is_linear=True,
        joins=True,
    ),
    _damping(
        "asymmetric_damping",
        "The damping is larger, by c, in one direction than in the other.",
        "c*max(d_rate, 0)",
        {"c": EffectParameter("F*s/D", "what is added while the displacement grows", (-10.0, 10.0), 0.5)},
        cause="a shock absorber with valves for compression and rebound, a check valve, a leaf that opens one way",
        remedy="replace what damps in one direction only",
        source="Wallaschek (1990), Int. J. Non-Linear Mech. 25(2-3), 299-308",
    ),
    _damping(
        "quadratic_damping",
        "A resistance that grows with the square of the rate of displacement.",
        "c*d_rate*abs(d_rate)",
        {"c": EffectParameter("F*s**2/D**2", "coefficient", (0.0, 100.0), 1.0, None, NOT_NEGATIVE)},
        cause="drag of air or of a liquid on plates and arms, flow through an orifice",
        remedy="make the moving surfaces smaller",
        source="Nayfeh and Mook (1979), Nonlinear Oscillations, section 3.3.2",
    ),
    _damping(
        "eddy_current_drag",
        "A drag that is proportional to small rates, has its largest value at the rate vc, and falls beyond it.",
        "c*d_rate/(1 + (d_rate/vc)**2)",
        {"c": EffectParameter("F*s/D", "damping at small rates", (0.0, 10.0), 0.5, None, NOT_NEGATIVE), "vc": _DRAG},
        cause="a conductor that moves through the field of a magnet, an eddy current brake",
        remedy="remove conductors from the field",
        source="Wouterse (1991), IEE Proc. B 138(4), 153-158",
        nested=("viscous_damping",),
    ),
    _damping(
        "displacement_damping",
        "A damping that grows with the square of the displacement.",
        "c*d**2*d_rate",
        {"c": EffectParameter("F*s/D**3", "coefficient", (-1e6, 1e6), 1e3)},
        cause="squeezed films, joints that are loaded more when they are bent, large rotations",
        remedy="measure the decay at several amplitudes",
        source="Nayfeh and Mook (1979), Nonlinear Oscillations, section 3.3.4",
    ),
    _overflow(
        "overflow",
        "A flow that begins where a level exceeds an edge.",
        "k*max(d - edge, 0)",
        {
            "k": EffectParameter("F/D", "flow per level beyond the edge", (1e-3, 1e3), 1.0, None, NOT_NEGATIVE),
            "edge": EffectParameter("D", "level at which it begins", (0.0, 1.0), 0.5, tried=(0.5, 0.7, 0.85, 0.95)),
        },
        cause="a tank that is full, a relief valve, a bypass",
        remedy="stay below the edge",
        source="Schoukens, Mattson, Wigren and Noel (2016), Cascaded tanks benchmark, Workshop NSI Benchmarks",
        nested=("state_saturation",),
        is_flow=True,
    ),
    _overflow(
        "state_saturation",
        "A state of first order that a bound holds: what would take it further is lost.",
        "side*k*max(side*(d - edge), 0)",
        {
            "edge": EffectParameter("D", "the bound", (0.0, 1.0), 0.5),
            "side": _SIDE,
            "k": EffectParameter("F/D", "what holds it, per distance beyond the bound", (1.0, 1e5), 1e3, 1e3, POSITIVE),
        },
        cause="a tank that is full, a supply that limits a speed, a ramp that ends",
        remedy="stay within the bound",
        source="Schoukens, Mattson, Wigren and Noel (2016), Cascaded tanks benchmark, Workshop NSI Benchmarks",
        trials=(Trial(starts.bounds, ("edge",), sticks=True),),
        is_flow=True,
        by_step={"k": "1/(1.75*mobility*step)"},
    ),
    Effect(
        "added_mass",
        "More inertia than declared, by m; between two coordinates, an inerter.",
        "m*d_acc",
        {"m": EffectParameter("F*s**2/D", "additional mass", (-10.0, 10.0), 0.05)},
        cause="a coil, a bracket, a target or glue that was not weighed, cables that move along, a liquid around it",
        remedy="weigh what moves",
        source="Smith (2002), IEEE Trans. Autom. Control 47(10), 1648-1662; to the ground it is a mass",
        family="mass",
        absorbed_by="mass",
        is_linear=True,
    ),
    Effect(
        "attached_oscillator",
        "A mass m on a spring of its own that is carried along: a resonance that the model has no coordinate for.",
        f"m*({_CARRIED})",
        {
            "m": EffectParameter("F*s**2/D", "mass that is carried", (0.0, 10.0), 0.05, None, NOT_NEGATIVE),
            "nu": EffectParameter("1/s", "its own frequency where it is carried", (0.1, 400.0), 10.0, None, POSITIVE),
            "zeta": EffectParameter("1", "its damping ratio", (0.0, 1.0), 0.02, None, NOT_NEGATIVE),
        },
        cause="a cable, a bracket or a sensor that sways, a floor or a table that yields, a liquid that sloshes",
        remedy="clamp what sways",
        source="Den Hartog (1985), Mechanical Vibrations, section 3.2",
        states={
            "z": EffectState("w - d_rate", "D", "stretch of its spring", "1e3"),
            "w": EffectState(_CARRIED, "D/s", "rate of the mass", "1e3"),
        },
        trials=(Trial(starts.resonances, ("nu", "zeta")),),
        nested=("added_mass", "linear_spring", "viscous_damping"),
        is_linear=True,
        is_carried=True,
        positive="duration*nu - 2",
        family="resonance",
    ),
    _friction(
        "dry_friction",
        "Coulomb friction: a force of constant size against the motion, and up to that size at rest.",
        **_sliding("fc", "fc*tanh(d_rate/vs)", "fc"),
        parameters={"fc": _COULOMB, "vs": _SLIDING, **_HELD},
        cause="sliding bearings, a coil that touches its magnet, cables that rub",
        remedy="align the guide, or use leaf springs or air bearings",
        source="Olsson, Astrom, Canudas de Wit, Gafvert and Lischinsky (1998), Eur. J. Control 4, section 2",
        trials=(_STUCK, _SMOOTH),
        joins=True,
        calibrated=("fc",),
    ),
    _friction(
        "asymmetric_friction",
        "Dry friction of different size in each direction.",
        **_sliding("where(z + c*d_rate > 0, fp, fm)", "where(d_rate > 0, fp, fm)*tanh(d_rate/vs)", "max(fp, fm)"),
        parameters={
            "fp": EffectParameter("F", "force while the displacement grows", (1e-3, 2.0), 0.1, None, NOT_NEGATIVE),
            "fm": EffectParameter("F", "force while it shrinks", (1e-3, 2.0), 0.05, None, NOT_NEGATIVE),
            "vs": _SLIDING,
            **_HELD,
        },
        cause="a guide that is loaded in one direction, wear, a cable that pulls along",
        remedy="look for what touches in one direction only",
        source="Armstrong-Helouvry, Dupont and Canudas de Wit (1994), Automatica 30, section 2.1",
        trials=(_STUCK, _SMOOTH),
        nested=("dry_friction", "constant_force"),
        is_sum=True,
    ),
    _friction(
        "stribeck_friction",
        "Dry friction that is larger at small rates, at which the lubricant does not carry yet.",
        **_sliding(_FALLING, f"({_FALLING})*tanh(d_rate/vs)", "max(fc, fs)"),
        parameters={"fc": _COULOMB, "fs": _STATIC, "vst": _STRIBECK, "vs": _SLIDING, **_HELD},
        cause="lubricated sliding contacts and ball bearings at low speed",
        remedy="a lubricant with friction modifiers, or a guide without contact",
        source="Armstrong-Helouvry, Dupont and Canudas de Wit (1994), Automatica 30, (2)",
        label="Stribeck friction",
        trials=(Trial(starts.falls, ("vst",), sticks=True), Trial(starts.falls, ("vst", "vs"))),
        positive="fs - fc",
        nested=("dry_friction",),
        calibrated=("fc",),
    ),
    _friction(
        "lugre_friction",
        "Friction of bristles that bend before they slip: stiction, presliding displacement and hysteresis.",
        f"s0*z + s1*({_BENDING}) + s2*d_rate",
        {
            "fc": replace(_COULOMB, bounds=POSITIVE),
            "fs": replace(_STATIC, bounds=POSITIVE),
            "vst": _STRIBECK,
            "s0": EffectParameter("F/D", "stiffness of the bristles", (1e2, 1e6), 1e4, None, NOT_NEGATIVE),
            "s1": EffectParameter("F*s/D", "damping of the bristles", (0.0, 1e3), 10.0, 0.0, NOT_NEGATIVE),
            "s2": EffectParameter("F*s/D", "viscous friction", (0.0, 10.0), 0.1, 0.0, NOT_NEGATIVE),
        },
        cause="dry contacts that stick between reversals, such as a guide or a rubbing cable",
        remedy="remove the contact; small motions need this model, large ones only dry friction",
        source="Canudas de Wit, Olsson, Astrom and Lischinsky (1995), IEEE Trans. Autom. Control 40(3), (1)-(4)",
        states={"z": EffectState(_BENDING, "D", "deflection of the bristles", "max(fc, fs)/s0")},
        label="LuGre friction",
        trials=_BRISTLES,
        nested=("dry_friction", "stribeck_friction"),
        scaled=("fc", "fs", "s0", "s1"),
    ),
    _friction(
        "dahl_friction",
        "Dry friction that builds up over a short displacement after each reversal.",
        "fc*z",
        {"fc": _COULOMB, "x0": _REACH},
        cause="rolling bearings, preloaded contacts, cables that bend",
        remedy="a guide without contact; small motions need this model, large ones only dry friction",
        source="Dahl (1976), AIAA Journal 14(12), 1675-1682, with exponent 1",
        states={"z": EffectState("(d_rate - abs(d_rate)*z)/x0", "1", "part of the friction that has built up", "1")},
        label="Dahl friction",
    ),
    _hysteresis(
        "hysteresis",
        "A spring that remembers: its force follows another path back, in the normalised form of Bouc and Wen.",
        "k*z",
        {
            "k": _REVERSAL,
            "zmax": _YIELD,
            "beta": EffectParameter("1", "shape: 1/2 unloads in a straight line", (0.5, 2.0), 0.5, 0.5, (0.5, None)),
            "n": EffectParameter("1", "sharpness of yielding", (1.0, 10.0), 2.0, 2.0, (1.0, None)),
        },
        cause=_SLIPPING,
        remedy=_CLAMPED,
        source="Wen (1976), J. Eng. Mech. Div. 102; Ikhouane and Rodellar (2007), Systems with Hysteresis, (2.15)",
        states={"z": EffectState(_WEN, "D", "elastic part of the displacement", "zmax")},
        calibrated=("k", "zmax"),
    ),
    _hysteresis(
        "bouc_wen_hysteresis",
        "A spring that remembers, in the general form of Bouc and Wen: loops that yield, or that open like a wedge.",
        "k*z",
        {
            "k": _REVERSAL,
            "x0": EffectParameter("D", "displacement over which it bends", (1e-5, 1e-1), 1e-3, None, POSITIVE, _BENDS),
            "delta": _SHAPE,
            "n": EffectParameter("1", "sharpness of the bend", (1.0, 4.0), 1.0, 1.0, (1.0, None)),
        },
        cause=_SLIPPING,
        remedy=_CLAMPED,
        source="Wen (1976), J. Eng. Mech. Div. 102; Ismail et al. (2009), Arch. Comput. Methods Eng. 16",
        states={"z": EffectState(_BOUC_WEN, "D", "elastic part of the displacement", "x0")},
        label="Bouc-Wen hysteresis",
        nested=("hysteresis", "dahl_friction"),
    ),
    Effect(
        "backlash",
        "A spring with play: no force within the gap, linear beyond it on both sides.",
        "k*(d - min(max(d, -gap/2), gap/2))",
        {
            "k": EffectParameter("F/D", "stiffness beyond the gap", (1.0, 1e6), 1e3, None, NOT_NEGATIVE),
            "gap": EffectParameter("D", "width of the play", (0.0, 1e-2), 1e-3, None, NOT_NEGATIVE, _GAPS),
        },
        cause="gears, couplings, loose screws, pins in slotted holes",
        remedy="preload the joint or replace it by a flexure",
        source="Nordin and Gutman (2002), Automatica 38, section 2",
        family="backlash",
    ),
    Effect(
        "stop",
        "An end stop: a contact that pushes back beyond an edge and never pulls.",
        "side*k*max(side*(d - edge), 0)*max(1 + c*side*d_rate, 0)",
        {
            "k": _CONTACT,
            "edge": EffectParameter("D", "displacement at which the contact begins", (-0.02, 0.02), 5e-3),
            "c": EffectParameter("s/D", "damping per force and rate", (0.0, 50.0), 1.0, 0.0, NOT_NEGATIVE),
            "side": _SIDE,
        },
        cause="the end of the stroke: a bumper, the housing of the coil",
        remedy="stay within the stroke: smaller amplitudes, or the limits of the plant",
        source="Hunt and Crossley (1975), J. Appl. Mech. 42, 440-445",
        family="end stop",
        trials=(Trial(starts.edges, ("edge",)), Trial(starts.damped_edges, ("edge", "c"))),
        nested=("constant_force", "bilinear_spring"),
    ),
    _friction(
        "local_friction",
        "Dry friction in one part of the stroke only, beyond an edge.",
        **_sliding(f"fc*{_BEYOND}/2", f"fc*tanh(d_rate/vs)*{_BEYOND}/2", "fc"),
        parameters={
            "fc": _COULOMB,
            "edge": EffectParameter("D", "displacement at which it begins", (-0.02, 0.02), 5.8e-3),
            "width": EffectParameter("D", "over which it begins", (1e-5, 1e-3), 2e-4, 2e-4, POSITIVE),
            "vs": _SLIDING,
            "side": _SIDE,
            **_HELD,
        },
        cause="a coil that touches its magnet in one part of the stroke, a burr, a cable that is caught",
        remedy="look for marks at that position, or keep the motion on the free side",
        source="Olsson, Astrom, Canudas de Wit, Gafvert and Lischinsky (1998), Eur. J. Control 4, position dependence",
        trials=(
            Trial(starts.local_edges, ("edge", "width"), sticks=True),
            Trial(starts.local_edges, ("edge", "width", "vs")),
        ),
        nested=("dry_friction",),
    ),
    _spring(
        "gravity_force",
        "The torque of a weight on an arm, and of anything that repeats once a turn: a sine of the displacement.",
        "a*sin(d/r)",
        {
            "a": EffectParameter("F", "largest force", (-20.0, 20.0), 0.1),
            "r": EffectParameter("D", "displacement per radian", (1e-4, 1.0), 1e-2, None, POSITIVE, _TURNS),
        },
        cause="a mass off the axis, magnets that cog, a thread that runs out",
        remedy="balance what turns",
        source="Rijlaarsdam (2008), (8.4): nu^2 sin(theta)",
        nested=("hardening_spring",),
    ),
    Effect(
        "cogging",
        "A force that repeats with the displacement: a sine of any phase.",
        "a*sin(2*pi*d/pitch) + b*cos(2*pi*d/pitch)",
        {
            "a": EffectParameter("F", "sine part", (-5.0, 5.0), 0.1),
            "b": EffectParameter("F", "cosine part", (-5.0, 5.0), 0.1, 0.0),
            "pitch": EffectParameter("D", "displacement after which it repeats", (1e-4, 10.0), 1e-2, None, POSITIVE),
        },
        cause="magnets and iron of a motor, teeth of a gear or a belt, the thread of a screw, a shaft that is bent",
        remedy="a motor without iron, a straight shaft, a better thread",
        source="Hanselman (2006), Brushless Permanent Magnet Motor Design, 2nd ed., ch. 6",
        family="periodic force",
        trials=tuple(Trial(starts.pitch(number), ("pitch",), ("a", "b")) for number in range(4)),
        nested=("gravity_force",),
        positive="travel - 2*pitch",
        is_sum=True,
    ),
    Effect(
        "periodic_force",
        "A sinusoidal force that does not depend on the motion.",
        "a*sin(2*pi*nu*t) + b*cos(2*pi*nu*t)",
        {
            "a": EffectParameter("F", "sine part", (-5.0, 5.0), 0.1),
            "b": EffectParameter("F", "cosine part", (-5.0, 5.0), 0.1, 0.0),
            "nu": EffectParameter("1/s", "frequency", (1e-2, 400.0), 1.0, None, POSITIVE),
        },
        cause="a machine, a pump or a fan nearby, the mains in an amplifier",
        remedy="switch it off or isolate the rig from it",
        source="Den Hartog (1985), Mechanical Vibrations, section 2.8",
        family="periodic force",
        trials=(Trial(starts.tones, ("nu",), ("a", "b")),),
        positive="duration*nu - 2",
        is_sum=True,
    ),
    _spring(
        "stiffness_drift",
        "The stiffness changes steadily with time.",
        "k*d*t",
        {"k": EffectParameter("F/D/s", "change of the stiffness in a second", (-5.0, 5.0), 0.1)},
        cause="a spring that warms up or creeps, a magnet that weakens, a clamp that settles",
        remedy="let the rig warm up before it is used, calibrate again",
        source="Ljung (1999), System Identification, section 11.1",
    ),
)
