"""Mismatch: which differences between the oscillators would make the final state that an experiment ended in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import fsolve

from masking.analysis.stability.modes import Mode, modes, pair_of, state_matrix
from masking.model.modelling.model import Model

STARTS: Final = (0.0, 0.005, -0.005, 0.02, -0.02, 0.05)  # of the difference in frequency
SUPPLIES: Final = (0.002, -0.002)  # of the difference in over-compensation
SUPPLY: Final = 0.003
EXACT: Final = 1e-6


@dataclass(frozen=True)
class Mismatch:
    """Two oscillators that differ so that their anti-phase mode neither grows nor decays, with a given shape.

    Args:
        model: the driven model with these differences.
        frequency: relative; w1 is so much higher and w2 so much lower.
        e1: over-compensated damping ratio of oscillator 1.
        e2: that of oscillator 2.
        decay: rate at which the in-phase mode decays, per unit of time.
        before: the same without differences and without supply.
    """

    model: Model
    frequency: float
    e1: float
    e2: float
    decay: float
    before: float

    @property
    def parameters(self) -> dict[str, float]:
        """Return the parameters that differ from the driven model's, in its declared units."""
        return {name: float(self.model.overrides[name]) for name in ("w1", "w2", "e1", "e2")}

    def __str__(self) -> str:
        return (
            f"frequencies {100 * self.frequency:+.2f} % and {-100 * self.frequency:+.2f} % off, over-compensations "
            f"{self.e1:+.4f} and {self.e2:+.4f}"
        )


def mismatch(model: Model, ratio: float, phase: float) -> Mismatch | None:
    """Find the difference in frequency, and the supply of energy, that end in a ratio and a phase.

    Three unknowns, the difference in frequency and e1 and e2, meet three conditions on the anti-phase mode of the
    linearised system: its real part is zero, |a/b| is the ratio, and arg(a/b) = phase or -phase. No other mode may
    grow; of several solutions, that in which the in-phase mode decays fastest is returned.

    Args:
        model: dimensionless, with parameters w1, w2, e1 and e2.
        ratio: of the amplitudes.
        phase: rad.

    Returns:
        the mismatch; None where none was found.
    """
    first, second = pair_of(model)
    values = model.parameter_values()
    si = replace(model, is_dimensionless=False).parameter_values()  # what is declared in rad/s stays so
    units = {n: values[n] / si[n] for n in ("w1", "w2")}

    def made(x: np.ndarray) -> Model:
        w1, w2 = values["w1"] * (1.0 + x[0]) / units["w1"], values["w2"] * (1.0 - x[0]) / units["w2"]
        return model.with_parameters(w1=w1, w2=w2, e1=float(x[1]), e2=float(x[2]))

    found: list[tuple[float, Mismatch]] = []
    before = min(-_in_phase(model.with_parameters(e1=0.0, e2=0.0)).eigenvalue.real, math.inf)
    for target in (ratio * np.exp(1j * phase), ratio * np.exp(-1j * phase)):

        def conditions(x: np.ndarray, target: complex = complex(target)) -> list[float]:
            mode = _anti_phase(made(x))
            off = mode.shape[first] / mode.shape[second] / target
            return [100.0 * mode.eigenvalue.real, float(np.log(abs(off))), float(np.angle(off))]

        for start in STARTS:
            for supply in SUPPLIES:
                x, _, status, _ = fsolve(conditions, [start, SUPPLY + supply, SUPPLY - supply], full_output=True)
                if status != 1 or max(map(abs, conditions(x))) > EXACT:
                    continue
                changed = made(x)
                slowest = modes(state_matrix(changed), changed.coordinates).modes[0].eigenvalue.real
                if slowest < EXACT:
                    decay = -_in_phase(changed).eigenvalue.real
                    found.append((decay, Mismatch(changed, float(x[0]), float(x[1]), float(x[2]), decay, before)))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _anti_phase(model: Model) -> Mode:
    return min(_oscillating(model), key=lambda mode: _alignment(mode, *pair_of(model)))


def _in_phase(model: Model) -> Mode:
    """Return the other one of the two modes in which the oscillators move most."""
    return max(_oscillating(model), key=lambda mode: _alignment(mode, *pair_of(model)))


def _oscillating(model: Model) -> tuple[Mode, ...]:
    """Return the two slowest modes: in the third the beam moves."""
    return modes(state_matrix(model), model.coordinates).modes[:2]


def _alignment(mode: Mode, first: str, second: str) -> float:
    a, b = mode.shape[first], mode.shape[second]
    return float((a * np.conj(b)).real / (abs(a) * abs(b)))
