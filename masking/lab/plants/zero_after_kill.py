"""Zero after a kill: a process beside the one that drives a plant sets the outputs to zero where that one is killed.

    python -m masking.lab.plants.zero_after_kill ADDRESS HANDLE

It is there for plants whose outputs stay as they are without their process (`interface.Holding`). HANDLE is the end of
a pipe on which it hears when the plant is driven and when it is left; a process that was killed says neither.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from typing import Final, Self, final

from masking.errors import PlantError
from masking.lab.plants import adapters
from masking.lab.plants.group import PlantGroup
from masking.lab.plants.interface import Holding, Plant
from masking.lab.records.child_process import Child

_DRIVEN, _LEFT = b"d", b"l"
_READY: Final = "ready"
_LONGEST: Final = 10.0  # s that a driver may take until it gives up the outputs of a process that was killed
_AGAIN: Final = 0.01  # s between tries
_NAME: Final = "masking.lab.plants.zero_after_kill"


def main(arguments: list[str] | None = None) -> int:
    """Wait for the end of the process that drives a plant; return the exit status."""
    address, handle = sys.argv[1:3] if arguments is None else arguments
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    plant, said = adapters.connect(address), _LEFT
    if not isinstance(plant, Holding):
        return 1
    print(_READY, flush=True)
    while heard := os.read(int(handle), 64):
        said = heard[-1:]
    return 0 if said == _LEFT else _at_rest(plant)


def _at_rest(plant: Holding) -> int:
    until = time.monotonic() + _LONGEST
    while True:
        try:
            plant.rest()
        except Exception as error:  # whatever a driver raises while it still has the outputs of the other process
            if time.monotonic() > until:
                print(f"masking: {plant.address}: the outputs are not at zero: {error}", file=sys.stderr, flush=True)
                return 1
            time.sleep(_AGAIN)
        else:
            print(f"masking: {plant.address}: its process was killed; the outputs are at zero", file=sys.stderr)
            return 0


@final
class LastWord:
    """Processes beside this one for a plant, or those of a group, that need them; a context that ends them.

    A PlantError where one does not start.
    """

    def __init__(self, plant: Plant) -> None:
        self._children: list[tuple[str, Child, int]] = []
        for one in plant.plants.values() if isinstance(plant, PlantGroup) else (plant,):
            if isinstance(one, Holding):
                reading, writing = os.pipe()
                child = Child(_NAME, [one.address, str(reading)], handles=[reading])
                os.close(reading)
                self._children.append((one.address, child, writing))
        for address, child, _ in self._children:
            if child.line() != _READY:
                self.__exit__()
                raise PlantError(f"{address}: the process that would set its outputs to zero did not start")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for _address, child, writing in self._children:
            os.close(writing)
            child.wait()
        self._children = []

    @contextlib.contextmanager
    def driving(self) -> Iterator[None]:
        """Context in which the plant is driven; the outputs are at zero at its end."""
        for address, child, _ in self._children:
            if not child.is_alive:
                raise PlantError(f"{address}: the process that would set its outputs to zero has ended; start anew")
        self._say(_DRIVEN)
        try:
            yield
        finally:
            self._say(_LEFT)

    def _say(self, word: bytes) -> None:
        for _address, _child, writing in self._children:
            with contextlib.suppress(BrokenPipeError):  # it has ended
                os.write(writing, word)


if __name__ == "__main__":
    sys.exit(main())
