"""The verb rig stop: the emergency stop of runs in other processes; loads no large package, since it is in a hurry."""

from __future__ import annotations

from masking.lab.records.stop_switch import Presser, switches


def stop(*processes: int) -> list[int]:
    """Press the emergency stop of runs on this machine that this user started.

    Args:
        processes: numbers of those whose runs are stopped; by default all.

    Returns:
        the processes whose runs were stopped.
    """
    stopped = []
    for switch in switches():
        if not processes or switch.process in processes:
            switch.press(Presser.COMMAND_LINE)
            stopped.append(switch.process)
    return stopped
