"""Work: how much a search simulates, and when it ends for that."""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Lock

MOST_STEPS = 6e8  # times states and columns: about 40 s on one core
FEWEST_RUNS = 2000  # of a record, however long it is


@dataclass
class Work:
    """Simulation that a search has done, and how much it may do: steps of integration, times what each one moves.

    That are states, and columns of sensitivities. Steps are counted and no seconds, so that a search ends in the same
    place on any machine.

    Args:
        most: steps, so weighted, after which a search begins nothing more.
        done: those that have been done.
        is_cut: whether a search has ended for that.
    """

    most: float
    done: float = 0.0
    is_cut: bool = False
    _lock: Lock = field(default_factory=Lock, repr=False)

    @classmethod
    def allowed(cls, samples: int, width: int) -> Work:
        """Return the work that a search of a record may do.

        Args:
            samples: of the record.
            width: states and columns of the rig alone.
        """
        return cls(max(MOST_STEPS, float(FEWEST_RUNS * samples * width)))

    def add(self, steps: int, width: int) -> None:
        """Add a simulation, from any thread.

        Args:
            steps: of integration.
            width: states and columns that each one moves.
        """
        with self._lock:
            self.done += steps * width

    def ends(self) -> bool:
        """Return whether a search is to begin nothing more; that it was so is noted."""
        self.is_cut = self.is_cut or self.done > self.most
        return self.is_cut
