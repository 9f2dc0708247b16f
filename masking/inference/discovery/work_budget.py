"""Work budget: the simulation that a search may do, counted in steps."""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Lock

MOST_STEPS = 5e8  # times states and columns: about 60 s on one core
FEWEST_RUNS = 500  # of a record, however long it is
WHOLE = 1.5  # times what one search may do that all searches of an answer may do together


@dataclass
class Work:
    """Simulation that a search has done, and how much it may do: steps of integration, times what each one moves.

    That are states, and columns of sensitivities. Steps are counted and no seconds, so that a search ends in the same
    place on any machine.
    """

    most: float  # steps, so weighted, after which a search begins nothing more
    whole: Work | None = None  # work that this is a part of; None where there is none
    done: float = 0.0  # those that have been done
    is_cut: bool = False  # whether a search has ended for that
    _lock: Lock = field(default_factory=Lock, repr=False)

    @classmethod
    def allowed(cls, samples: int, width: int) -> Work:
        """Work that a search of a record may do, the first one of an answer, by its samples.

        The width is that of states and columns of the rig alone.
        """
        most = max(MOST_STEPS, float(FEWEST_RUNS * samples * width))
        return cls(most, cls(WHOLE * most))

    def another(self, part: float = 1.0) -> Work:
        """Work of another search of the answer, which may do a part of what this one may."""
        return Work(part * self.most, self.whole)

    def kept(self, part: float) -> Work:
        """Budget reserved for the final stage, a part of that of one search, whatever the searches have done."""
        return Work(part * self.most)

    def again(self) -> Work:
        """Budget of a further stage: as much as all searches of the answer have done."""
        return Work(self.done if self.whole is None else self.whole.done)

    def add(self, steps: int, width: int) -> None:
        """Add a simulation, from any thread: steps of integration, and states and columns that each one moves."""
        with self._lock:
            self.done += steps * width
        if self.whole is not None:
            self.whole.add(steps, width)

    @property
    def is_over(self) -> bool:
        """Whether this is done, or what it is a part of."""
        return self.done > self.most or (self.whole is not None and self.whole.is_over)

    def ends(self) -> bool:
        """Whether a search is to begin nothing more; that it was so is noted.

        It is asked where no other fit runs, so that the answer is the same each time.
        """
        self.is_cut = self.is_over
        return self.is_cut
