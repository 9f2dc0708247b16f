"""Bench of a fault: twins served in processes of their own, controllers in this process or in another, and records."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from masking.errors import MaskingError, RecordError
from masking.lab.plants.interface import Plant, Settings
from masking.lab.plants.safety_chain import Rules
from masking.lab.plants.udp import UdpPlant
from masking.lab.records.recording import Recording
from masking.lab.runs.realtime import UNKNOWN, Hooks, Known, RigRun, Step, run_rig
from tests.campaigns import children
from tests.campaigns.twins import PLANT, RATE, WATCHDOG, rules, small

if sys.platform != "win32":
    import resource

Chosen = str | int | float | bool
"""What is chosen of a fault, as JSON can hold it."""

BUSY: Final = 3  # times that a fault in real time is tried: other programs may keep a process waiting for a watchdog
_UDP: Final = "udp://127.0.0.1:0"
_SAVED: Final = 20.0  # s at most until a server has saved a session


@dataclass(frozen=True, eq=False)
class Ended:
    """How a run ended: what the controller kept, the plant's own record, and the error if it ended in one."""

    run: RigRun
    own: Recording
    error: BaseException | None = None

    @property
    def cause(self) -> str:
        """Return the name of the cause for which the controller tripped; empty where it did not."""
        return self.run.trip.cause.name if self.run.trip is not None else ""

    @property
    def tick(self) -> int:
        """Return the tick of the trip; -1 where there is none."""
        return self.run.trip.tick if self.run.trip is not None else -1


@final
class Child:
    """A process that runs a function of `tests.campaigns.children`, and says things on a pipe.

    It is forked off one in which all is loaded and compiled, so that it begins at once.

    Args:
        function: of that module.
        given, named: its arguments, behind the pipe on which it sends.
    """

    def __init__(self, function: Callable[..., None], *given: object, **named: object) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([children.__name__])
        self._ours, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=function, args=(theirs, *given), kwargs=named, daemon=True)
        self.process.start()
        theirs.close()

    def hear(self) -> object:
        """Wait for what it says next; None where it has ended."""
        try:
            return self._ours.recv()
        except (EOFError, ConnectionResetError):
            return None

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.join()
        self._ours.close()


@final
class Served:
    """A twin that is served in a process of its own, and the folder of its records."""

    def __init__(self, folder: Path, plant: str, *, lockstep: bool, line: str = _UDP, steps: bool = False) -> None:
        self.folder, self.plant, self.lockstep = folder, plant, lockstep
        folder.mkdir(parents=True)
        self._child = Child(children.serve, plant, str(folder), line, lockstep=lockstep, steps=steps)
        self.process = self._child.process
        said = self._child.hear()
        if not said:
            self.close()
            raise MaskingError(f"the twin of {plant} cannot be served in a process of its own")
        self.address = str(said)
        self._count = 0

    def damage(self, **chosen: Chosen) -> None:
        """Choose what is damaged in the sessions that follow; nothing without arguments."""
        (self.folder / "damage.json").write_text(json.dumps(chosen), encoding="utf-8")

    def record(self) -> Recording:
        """Return the plant's own record of the session that ended, once it is saved.

        Raises:
            RecordError: it is not saved in time.
        """
        self._count += 1
        folder, until = self.folder / f"session-{self._count}", time.monotonic() + _SAVED
        while True:
            try:
                return Recording.load(folder)
            except RecordError:
                if time.monotonic() > until:
                    self._count -= 1
                    raise
                time.sleep(0.005)

    def close(self) -> None:
        """End the process."""
        self._child.close()


@final
class Bench:
    """What faults share: twins that are served, started once they are asked for.

    Args:
        folder: an empty one, for records.
        is_quick: leave out what takes longer than a minute.
    """

    def __init__(self, folder: Path, *, is_quick: bool = True) -> None:
        self.folder, self.is_quick = folder, is_quick
        self._served: dict[tuple[str, bool], Served] = {}
        self._number = 0

    def place(self) -> Path:
        """Return a folder that is not there yet."""
        self._number += 1
        return self.folder / str(self._number)

    def served(self, *, lockstep: bool = True, plant: str = PLANT) -> Served:
        """Return a twin that is served, sound, and the same as before if its process still runs."""
        found = self._served.get((plant, lockstep))
        if found is None or not found.process.is_alive():
            found = self._served[plant, lockstep] = Served(self.place(), plant, lockstep=lockstep)
        found.damage()
        return found

    def anew(self, *, line: str = _UDP, lockstep: bool = False, steps: bool = False) -> Served:
        """Return a twin that is served in a process that only one fault uses; `steps` lets its wall clock step."""
        found = Served(self.place(), PLANT, lockstep=lockstep, line=line, steps=steps)
        self._served[str(self._number), lockstep] = found
        return found

    def run(
        self,
        step: Step = small,
        *,
        lockstep: bool = True,
        samples: int = 400,
        held: Rules | None = None,
        plant: str = PLANT,
        made: Callable[[str], Plant] | None = None,
        damage: Mapping[str, Any] | None = None,
        known: Known = UNKNOWN,
        **more: Any,
    ) -> Ended:
        """Run a controller in this process on a served twin.

        Args:
            step: of the controller.
            lockstep: whether both sides wait for each other.
            samples: ticks.
            held: what the chain holds the rig to; by default what the plant file says.
            plant: a packaged plant.
            made: makes the plant of the address; by default an undamaged line.
            damage: of the plant, as `tests.campaigns.damage.Damaged` takes it.
            known: state of the controller that the run looks at.
            more: other hooks of `run_rig`.
        """
        served = self.served(lockstep=lockstep, plant=plant)
        served.damage(**(damage or {}))
        ended: list[RigRun] = []
        error: BaseException | None = None
        try:
            run_rig(
                step,
                made(served.address) if made is not None else UdpPlant(served.address, patience=20.0),
                Settings(RATE, WATCHDOG, lockstep, acknowledge=True),
                samples=samples,
                limits=held or rules(plant),
                hooks=Hooks(**more, on_end=ended.append),
                known=known,
            )
        except Exception as raised:  # whatever the fault is, its record is evaluated
            error = raised
            if not ended:
                raise
        return Ended(ended[0], served.record(), error)

    @contextlib.contextmanager
    def controller(self, address: str, **chosen: Chosen) -> Iterator[Controller]:
        """Run a controller in a process of its own; give it once it runs."""
        made = Controller(address, chosen)
        try:
            yield made
        finally:
            made.close()

    def close(self) -> None:
        """End all processes; others are started once they are asked for."""
        for served in self._served.values():
            served.close()
        self._served.clear()


@final
class Waits:
    """What calls within a loop cost it: of which it waited for anybody, or computed for a period of time.

    Both are counted by the system for the loop's thread alone, whatever else the machine does.

    Attributes:
        calls: how many there were.
        held: instants of those that made the loop wait, s of the monotonic clock.
    """

    def __init__(self) -> None:
        self.calls, self.held = 0, list[float]()

    def watched(self, call: Callable[..., None]) -> Callable[..., None]:
        """Return a function that makes a call and watches it."""

        def watching(*given: object) -> None:
            waits, used = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw, time.thread_time()
            call(*given)
            is_long = time.thread_time() - used > 1.0 / RATE
            self.calls += 1
            if is_long or resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw > waits:
                self.held.append(time.monotonic())

        return watching


@final
class Controller:
    """A controller in a process of its own, which says `running` after 200 ticks, and at its end how it went."""

    def __init__(self, address: str, chosen: Mapping[str, Any]) -> None:
        self._child = Child(children.control, address, dict(chosen))
        self.process = self._child.process
        self.said = self._child.hear()

    def end(self) -> dict[str, Any]:
        """Wait for what it says at its end; nothing where it was killed."""
        said = self.said if isinstance(self.said, dict) else self._child.hear()
        self.process.join(20.0)
        return said if isinstance(said, dict) else {}

    def send(self, number: int) -> None:
        """Send it a signal."""
        os.kill(self.process.pid or 0, number)

    def close(self) -> None:
        """End the process."""
        self._child.close()
