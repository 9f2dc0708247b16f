"""The verb rig stop: the emergency stop of runs in other processes; loads no large package, since it is in a hurry."""

from __future__ import annotations

import time

from masking.errors import OperatorError
from masking.lab.records.stop_switch import Presser, Switch, switches


def stop(*processes: int, all: bool = False) -> list[int]:
    """Press the emergency stop of runs on this machine that this user started.

    Args:
        processes: numbers of those whose runs are stopped; by default the run is stopped where there is one alone.
        all: stop all of them, where there are several.

    Returns:
        the processes whose runs were stopped; none where there is no run.

    Raises:
        OperatorError: runs go on, but not those that were named; or none was named and there are several, which may be
            those of other people who share the account. The message lists them. What was named and is there is stopped.
    """
    running = list(switches())
    is_one = len({switch.process for switch in running}) == 1
    chosen = [s for s in running if s.process in processes or (not processes and (all or is_one))]
    for switch in chosen:
        switch.press(Presser.COMMAND_LINE)
    stopped = [switch.process for switch in chosen]
    unknown = sorted({*processes}.difference(stopped))
    if running and (unknown or not stopped):
        raise OperatorError(_refusal(running, stopped, unknown))
    return stopped


def _refusal(running: list[Switch], stopped: list[int], unknown: list[int]) -> str:
    """Say what was not stopped, and how each run is."""
    done = f"{_named(stopped)} stopped, but there" if stopped else "nothing was stopped: there"
    why = f"{done} is no run of {_named(unknown)}" if unknown else "nothing was stopped: several runs go on"
    lines = [f"{_line(s)}\n    masking rig stop {s.process}" for s in running if s.process not in stopped]
    lines += ["all of them:\n    masking rig stop --all"] if len(lines) > 1 else []
    return "\n".join([f"{why}; these go on, each with what stops it:" if lines else why, *lines])


def _named(processes: list[int]) -> str:
    return ", ".join(f"process {process}" for process in processes)


def _line(switch: Switch) -> str:
    """Say which run the switch is of; names come from files, so that they are kept from the terminal's own codes."""
    said = switch.published
    if "since" not in said:
        return f"process {switch.process}: about to begin"
    since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(said["since"]))
    line = f"process {switch.process}: {said['name']} on {said['plant']}, since {since}"
    return "".join(character if character.isprintable() else "?" for character in line)
