"""Starts of fits that depend on several parameters or on more of a record than the size of the motion."""

from __future__ import annotations

import math

from masking.model.effects.entry import Span, Start, Starts

# Parts of the travel at which a contact is tried: denser towards the end, where a stop hides in fewer samples. A fit
# moves an edge by about half the distance to the next.
EDGES = (0.15, 0.3, 0.45, 0.6, 0.75, 0.85, 0.93)
EDGE_WIDTH = 0.04  # of the largest displacement: below half the distance of two edges, so that starts stay distinct
LOSS = 0.3  # of the force of a contact at the rms rate
# Displacements at which bristles let go, in parts of the travel: hardly seen, seen at reversals, and nearly a spring.
BRISTLES = (0.005, 0.02, 0.08)
BRISTLE_DAMPING = 3e-3  # s, per stiffness: less than the time in which they let go at the rms rate
# Rates below which a smooth sign is nearly linear, in parts of the rms rate: as a sign, and where a record shows them.
TURN, TURNS = 0.01, (0.1, 0.03, 0.01, 2e-3)
STRIBECK_RATE = 0.2  # of the rms rate: the force falls within the motion, not only at reversals
# Steps of a quantiser from the middle to the end of its range: from less than one, which is a dead zone, to as many as
# still show in averages of the readings.
FEWEST_LEVELS, MOST_LEVELS = 0.6, 24.0
LEVELS_APART, LEVELS_APART_RELATIVE = 0.15, 0.02  # near enough for the next look around each to overlap
# Frequencies over that of the motion, near enough that a damped resonance reaches from one to the next.
RESONANCES = tuple(0.3 * 1.3**i for i in range(15))
DAMPING_RATIOS = (0.02, 0.15)


def edges(span: Span) -> list[Start]:
    """Edges on both sides of the travel, of what lies beyond them; and at 0, for a contact at rest."""
    up = [{"side": 1.0, "edge": part * span.high} for part in EDGES if span.high > 0]
    down = [{"side": -1.0, "edge": part * span.low} for part in EDGES if span.low < 0]
    return [*up, *down, {"side": 1.0, "edge": 0.0}, {"side": -1.0, "edge": 0.0}]


def bounds(span: Span) -> list[Start]:
    """Bounds of a state, within what it covers where nothing holds it."""
    covered = span.high - span.low
    up = [{"side": 1.0, "edge": span.low + part * covered} for part in EDGES]
    return [*up, *({"side": -1.0, "edge": span.high - part * covered} for part in EDGES)]


def damped_edges(span: Span) -> list[Start]:
    """Same edges of a contact that loses energy."""
    return [{**edge, "c": LOSS / span.rate} for edge in edges(span)]


def local_edges(span: Span) -> list[Start]:
    """Edges of friction in one part of the stroke."""
    return [{**edge, "width": EDGE_WIDTH * span.size, **turn(span)[0]} for edge in edges(span)]


def bristles(static: float) -> Starts:
    """Starts of bristles whose breaking force is `static` times the sliding one; one factor scales both."""

    def starts(span: Span) -> list[Start]:
        found: list[Start] = []
        for part in BRISTLES:
            stiffness = 1.0 / (part * span.size)
            rates = {"vst": STRIBECK_RATE * span.rate, "s1": BRISTLE_DAMPING * stiffness}
            found.append({"fc": 1.0, "fs": static, "s0": stiffness, **rates})
        return found

    return starts


def turn(span: Span) -> list[Start]:
    """Return one width of a sign."""
    return [{"vs": TURN * span.rate}]


def turns(span: Span) -> list[Start]:
    """Widths of a sign that a record may show."""
    return [{"vs": part * span.rate} for part in TURNS]


def falls(span: Span) -> list[Start]:
    """Rates at which friction has fallen: from near reversals to nearly the rms rate."""
    return [{"vst": part * span.rate, **turn(span)[0]} for part in (0.05, 0.15, 0.4, 0.8)]


def tones(span: Span) -> list[Start]:
    """Strongest frequencies of the latent forces."""
    return [{"nu": tone} for tone in span.tones]


def resonances(span: Span) -> list[Start]:
    """Frequencies about that of the motion, and those of latent forces, of oscillators that ring and that do not."""
    own = [part / (2.0 * math.pi * span.time) for part in RESONANCES]
    return [{"nu": nu, "zeta": zeta} for zeta in DAMPING_RATIOS for nu in (*own, *span.tones)]


def pitch(number: int) -> Starts:
    """Displacement over which the latent forces repeat: those near to each other are fitted each by itself."""
    return lambda span: [{"pitch": one} for one in span.pitches[number : number + 1]]


def levels(span: Span) -> list[Start]:
    """Steps of a quantiser, near enough to each other: its effect has no slope that a fit could follow."""
    found: list[Start] = []
    number = FEWEST_LEVELS
    while number < MOST_LEVELS:
        found.append({"step": span.size / number})
        number += max(LEVELS_APART, LEVELS_APART_RELATIVE * number)
    return found
