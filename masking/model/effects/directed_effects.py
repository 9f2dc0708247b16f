"""Physical effects at directed places, which act on one coordinate and follow something else than its motion alone.

`d` is what such a place follows: another coordinate, a command, or the coordinate itself, with a force that is
multiplied by the command that moves it, or by the load under which it slides.
"""

from __future__ import annotations

from masking.model.effects import starts
from masking.model.effects.entry import NOT_NEGATIVE, POSITIVE, Effect, EffectParameter, Trial

_SIDEWAYS = "a force that is not in line with the motion, a part that turns or bends as another moves, a tilted sensor"
_MODELLED = "align the parts"

DIRECTED: tuple[Effect, ...] = (
    Effect(
        "cross_stiffness",
        "A force on one coordinate in proportion to the displacement of another, which feels nothing of it.",
        "k*d",
        {"k": EffectParameter("F/D", "force per displacement of the other", (-500.0, 500.0), 10.0)},
        cause=f"{_SIDEWAYS}; fluid films and flutter",
        remedy=_MODELLED,
        source="Childs (1993), Turbomachinery Rotordynamics, section 2.2: cross-coupled stiffness",
        family="springs",
        is_linear=True,
        directed="coordinate",
    ),
    Effect(
        "cross_damping",
        "A force on one coordinate in proportion to the rate of another; gyroscopic if opposite the other way.",
        "c*d_rate",
        {"c": EffectParameter("F*s/D", "force per rate of the other", (-10.0, 10.0), 0.5)},
        cause="a spinning rotor between two axes, a frame that turns, eddy currents, fluid films",
        remedy="stop what spins",
        source="Childs (1993), Turbomachinery Rotordynamics, sections 1.5 and 2.2",
        family="damping",
        is_linear=True,
        directed="coordinate",
    ),
    Effect(
        "actuator_reaction",
        "An actuator also pushes a coordinate that the model does not let it act on.",
        "r*d",
        {"r": EffectParameter("F/D", "force per command", (-1.0, 1.0), 0.1)},
        cause="the housing of the actuator stands on that body; a force that is not in line with the motion",
        remedy="put the actuator on ground",
        source="Newton (1687), Principia, third law",
        family="actuator gains",
        is_linear=True,
        directed="command",
    ),
    Effect(
        "position_gain",
        "The gain of an actuator changes with the displacement that it moves.",
        "g*d",
        {"g": EffectParameter("F/D", "force per command and displacement", (-100.0, 100.0), 1.0)},
        cause="a voice coil off the middle of its field, a lever whose arm changes, a valve that overlaps unevenly",
        remedy="centre the actuator",
        source="Preumont (2011), Vibration Control of Active Structures, section 3.2",
        family="actuator gains",
        directed="gain",
    ),
    Effect(
        "load_friction",
        "Dry friction in proportion to a load that changes, such as the force of an actuator across the guide.",
        "mu*tanh(d_rate/vs)",
        {
            "mu": EffectParameter("F", "force per load", (0.0, 1.0), 0.1, None, NOT_NEGATIVE),
            "vs": EffectParameter("D/s", "rate at 76 % of the force", (1e-5, 1e-2), 1e-3, 1e-3, POSITIVE),
        },
        cause="a guide, gear or wedge that the load presses together, a leaf spring whose leaves rub",
        remedy="take the load off the guide, or use rollers",
        source="Coulomb (1785), Theorie des machines simples; Olsson et al. (1998), Eur. J. Control 4, 176-195",
        family="friction",
        trials=(Trial(starts.turn), Trial(starts.turns, ("vs",))),
        directed="load",
    ),
)
