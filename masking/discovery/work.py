"""Work: how much a search simulates, and when it ends for that."""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Lock

MOST_STEPS = 5e7  # times states: about a minute on one core
FEWEST_RUNS = 2000  # of a record, however long it is
STIFF = 4.0  # steps within a step, where a contact sticks


@dataclass
class Work:
    """Simulation that a search has done, in steps of integration times states, and how much it may do.

    Steps are counted and no seconds, so that a search ends in the same place on any machine.

    Args:
        most: steps times states after which a search begins nothing more.
        done: those that have been done.
        is_cut: whether a search has ended for that.
    """

    most: float
    done: float = 0.0
    is_cut: bool = False
    _lock: Lock = field(default_factory=Lock, repr=False)

    @classmethod
    def allowed(cls, samples: int, states: int) -> Work:
        """Return the work that a search of a record may do.

        Args:
            samples: of the record.
            states: of the rig.
        """
        return cls(max(MOST_STEPS, float(FEWEST_RUNS * samples * states)))

    def add(self, steps: int, states: int, *, sticks: bool) -> None:
        """Add a simulation, from any thread.

        Args:
            steps: of integration.
            states: that are integrated.
            sticks: whether a contact in it sticks.
        """
        with self._lock:
            self.done += steps * states * (STIFF if sticks else 1.0)

    def ends(self) -> bool:
        """Return whether a search is to begin nothing more; that it was so is noted."""
        self.is_cut = self.is_cut or self.done > self.most
        return self.is_cut
