"""Calibration: the probability that none of the names is right, of which a law without a name is the rival.

    p = p0 + (1 - p0)/(1 + (l0/l)**s)

l is what the names leave and the law without a name explains, as part of the rms of the model error: a law whose shape
is off by a tenth leaves a tenth. A closed form is their rival by its score. The
numbers are chosen, not fitted; `python -m tests.benchmarks.problems` says how often answers of each probability are
right.
"""

from __future__ import annotations

import numpy as np
from scipy import special

LEAST = 0.01  # p0, where the names leave no more than noise; and of the names, where a closed form is better
HALF = 0.1  # l0: a law that is a tenth off is as likely another one
SHARPNESS = 3.0  # s
REFUSED = 0.6  # at least, where names are refused for what they leave: then it is likelier than not
SHARED = 0.3  # at least, where two forces of one place are named: together they imitate many a single law
ABOVE = 0.25  # at least, where unseen data are not at the noise floor; more where the error is above EXPLAINED times it
EXPLAINED = 1.5  # times the noise that a law without a name leaves at most, where it speaks against all names
LIKELIER = 0.5  # from which none of the names is likelier than all of them
CHANGE = 1e-3  # of a probability: a law that changes it by less is not fitted


def none_of_these(
    left: float,
    better: float = -np.inf,
    *,
    refused: bool = False,
    shared: bool = False,
    above: float = 0.0,
    explained: bool = True,
) -> float:
    """Probability that none of the names is right.

    Args:
        left: l.
        better: score by which a closed form is better than the names, beyond what is asked of an effect.
        refused: whether the names are refused for what they leave.
        shared: whether two of them are forces of one place.
        above: error that they leave on unseen data, over the noise; 0 where that is the noise floor. A name that leaves
            several times the noise is as likely wrong as right, since something else is missing.
        explained: whether a law without a name leaves no more than noise; where neither does, little is sure.
    """
    found = LEAST + (1.0 - LEAST) / (1.0 + (HALF / left) ** SHARPNESS) if left > 0.0 else LEAST
    found = max(found, (1.0 - LEAST) * float(special.expit(0.5 * float(better))))
    beyond = min(LIKELIER, 1.0 - (1.0 - ABOVE) * min(1.0, EXPLAINED / above)) if above else 0.0
    found = max(found, REFUSED if refused else 0.0, SHARED if shared else 0.0, beyond)
    return found if explained else min(found, REFUSED)


def matters(left: float) -> bool:
    """Whether a law without a name could change the probability where names leave so much.

    Args:
        left: part of the rms of the model error that they leave: no law explains more of it.
    """
    return none_of_these(left) > LEAST + CHANGE
