"""Physical effects that stand in series with an element that declares a force of its own, or in its place.

Of one in series, `expression` is the displacement that it takes up of the element's, and `takes_rate` how fast: the
element's force follows what remains.
"""

from __future__ import annotations

from masking.model.effects.entry import NOT_NEGATIVE, POSITIVE, Effect, EffectParameter, EffectState, Span, Start, Trial

_GAPS = (0.02, 0.05, 0.15, 0.3, 0.5, 0.8, 1.2)  # from a play that hardly shows up to one in which contact is rare
_GAP = EffectParameter("D", "width of the play", (0.0, 1e-2), 1e-3, None, NOT_NEGATIVE, _GAPS)
SOFT = 0.02  # of the largest displacement
_TIMES = (0.06, 0.2, 0.6, 2.0, 6.0, 20.0)  # of the time of the motion, half-decades
_REACH = "(d - z - min(max(d - z, -gap/2), gap/2))"  # how far a pin is beyond the gap of its slider
_BEYOND = f"({_REACH} - min(max({_REACH}, -x0), x0))"  # how far beyond that the slider is taken along
# It moves with the pin, and is held a little beyond: being held alone, it would be late at each reversal.
_DRAGGED = f"where({_BEYOND}*d_rate > 0, d_rate - hold*x0/1000*sign({_BEYOND}), 0) + hold*{_BEYOND}"


def _reaches(span: Span) -> list[Start]:
    return [{"gap": gap, "x0": SOFT * span.size} for gap in _GAP.starts(span)]


SERIES: tuple[Effect, ...] = (
    Effect(
        "play",
        "Play between an element and what it holds: it acts only beyond its gap, and damps only in contact.",
        "min(max(d, -gap/2), gap/2)",
        {"gap": _GAP},
        cause="a worn joint or coupling, a screw that came loose, a pin in a hole that is too wide",
        remedy="preload the joint or replace it by a flexure",
        source="Nordin and Gutman (2002), Automatica 38, section 2",
        family="backlash",
        attaches="in_series",
        takes_rate="where(abs(d) < gap/2, d_rate, 0)",
    ),
    Effect(
        "play_with_friction",
        "A slider under dry friction, dragged along with play: free after each reversal until the gap is crossed.",
        f"fc*min(max({_REACH}/x0, -1), 1)",
        {
            "fc": EffectParameter("F", "force while it is dragged", (1e-3, 2.0), 0.1, None, NOT_NEGATIVE),
            "gap": _GAP,
            "x0": EffectParameter("D", "displacement over which it builds up", (1e-6, 1e-2), 1e-4, None, POSITIVE),
            "hold": EffectParameter("1/s", "rate at which the slider follows", (1.0, 1e6), 1e3, 1e3, POSITIVE),
        },
        cause="a brush, seal or cable that is taken along by a worn pin, a carriage on a loose spindle nut",
        remedy="take up the play, or remove what rubs",
        source="Tao and Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 2",
        states={"z": EffectState(_DRAGGED, "D", "where the slider is", "gap/2")},
        family="friction",
        trials=(Trial(_reaches, ("gap",), ("fc",), True), Trial(_reaches, ("gap", "x0"), ("fc",), True)),
        nested=("dahl_friction",),
        by_step={"hold": "1/(1.75*step)"},
    ),
    Effect(
        "maxwell_element",
        "A spring behind a dashpot in the place of the element: what it holds at rest, it loses with time.",
        "k*z",
        {
            "k": EffectParameter("F/D", "stiffness of the spring", (1.0, 1e6), 1e3, None, POSITIVE),
            "tau": EffectParameter("s", "time in which the force relaxes", (1e-3, 100.0), 0.1, None, POSITIVE),
        },
        cause="a damper whose rod or mount yields, a viscous coupling, a polymer above its glass transition",
        remedy="stiffen the mount",
        source="Maxwell (1867), Phil. Trans. R. Soc. 157, 49-88",
        states={"z": EffectState("d_rate - z/tau", "D", "stretch of the spring", "1e3")},
        family="damping",
        label="Maxwell element",
        is_linear=True,
        attaches="instead",
        trials=(Trial(lambda span: [{"k": k, "tau": tau} for k in span.stiffnesses for tau in _TIMES], ("k", "tau")),),
    ),
    Effect(
        "relaxation",
        "A spring behind a dashpot beside the element: stiffer when it moves fast than when it rests.",
        "k*z",
        {
            "k": EffectParameter("F/D", "stiffness that relaxes", (0.0, 1e6), 100.0, None, NOT_NEGATIVE),
            "tau": EffectParameter("s", "time in which it relaxes", (1e-3, 100.0), 0.1, None, POSITIVE, _TIMES),
        },
        cause="rubber and other polymers, a damper whose rod yields, air in a closed volume",
        remedy="avoid rubber in what must be exact",
        source="Zener (1948), Elasticity and Anelasticity of Metals, ch. 5: the standard linear solid",
        states={"z": EffectState("d_rate - z/tau", "D", "stretch that has not relaxed", "1e3")},
        family="damping",
        nested=("constant_force", "linear_spring"),  # what does not relax in a record is a spring with its own zero
        is_linear=True,
    ),
    Effect(
        "bilinear_spring",
        "The stiffness is larger, by k, in one direction than in the other.",
        "k*max(d, 0)",
        {"k": EffectParameter("F/D", "what is added on the positive side", (-500.0, 500.0), 10.0)},
        cause="a crack that closes, a prestressed contact, a cable or membrane that goes slack",
        remedy="preload what opens",
        source="Shaw and Holmes (1983), J. Sound Vib. 90(1), 129-155",
        family="springs",
    ),
)
