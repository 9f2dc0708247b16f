"""Stepwise: parameters found one group after the other, each from the records that tell it, then all together.

On the rig, each oscillator is identified by itself while the others are held, and then the coupling from the free
motion of all of them. A step of the fit is the same: some records, and the parameters that are free in it; the others
stay as the steps before left them. The deviations of a step are too small, as they take the fixed values for true; a
last fit of all parameters to all records gives the covariance of them together.
Source: Rijlaarsdam (2008), section 4.2.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from masking.control.rig.twin import Twin
from masking.errors import ModelError, RecordError
from masking.inference.estimation.fit import Fit, fit, part_of, several
from masking.inference.estimation.identification_data import Data

Progress = Callable[[float], None]


@dataclass(frozen=True)
class SteppedFit:
    """A fit in steps.

    Args:
        steps: the fit of each step; its deviations hold if what it left fixed is true.
        joint: the fit of all parameters to all records; that of the last step where none was asked for.
    """

    steps: tuple[Fit, ...]
    joint: Fit

    @property
    def twin(self) -> Twin:
        """Plant with the values that were found."""
        return self.joint.twin


def fit_in_steps(
    twin: Twin,
    steps: Sequence[tuple[Data | Sequence[Data], Sequence[str]]],
    *,
    validation: Data | Sequence[Data] = (),
    joint: bool = True,
    progress: Progress | None = None,
) -> SteppedFit:
    """Fit parameters of a twin in steps, each beginning with the values that the steps before found.

    Free motion is a record with constant commands, which begins away from rest. Where the other parts were clamped for
    a step, as on the rig of the source, begin from a twin whose coupling is 0, and leave the joint fit out: records of
    a rig that was changed in between cannot be fitted together.

    Args:
        twin: the plant, with the values to begin from.
        steps: records and names of the parameters that are free, in turn; a name may appear in several steps.
        validation: records that the last fit is validated on.
        joint: fit all parameters to all records in the end, beginning from what the steps found.
        progress: called with the part done.

    Raises:
        ModelError: there is no step, a step has no parameter, or one is not known or named twice.
        RecordError: a step has no record, or records are too short; says in which step.
        IntegrationError: the motion is not finite with the values to begin from.
    """
    wanted = [(several(records), tuple(names)) for records, names in steps]
    if not wanted:
        raise ModelError("there is no step; give pairs of records and names, such as [(record, ['w1', 'z1'])]")
    for number, (records, free) in enumerate(wanted, start=1):
        if not free:
            raise ModelError(f"step {number} has no parameter; give the names of those that are free in it")
        if not records:
            raise RecordError(f"step {number}, {', '.join(free)}, has no record; give at least one")
    together = joint and len(wanted) > 1
    names = tuple(dict.fromkeys(name for _, free in wanted for name in free))
    tell: Progress = progress or (lambda part: None)
    count, found, unseen = len(wanted) + together, list[Fit](), validation
    for number, (records, free) in enumerate(wanted):
        last = not together and number == len(wanted) - 1
        begin = found[-1].twin if found else twin
        try:
            made = fit(begin, records, free, validation=unseen if last else (), shared=names,
                       progress=part_of(tell, number, count))  # fmt: skip
        except RecordError as error:
            raise RecordError(f"step {number + 1}, {', '.join(free)}: {error}") from None
        found.append(made)
    if not together:
        return SteppedFit(tuple(found), found[-1])
    records = tuple({id(record): record for each, _ in wanted for record in each}.values())
    whole = fit(found[-1].twin, records, names, validation=unseen, progress=part_of(tell, count - 1, count))
    return SteppedFit(tuple(found), whole)
