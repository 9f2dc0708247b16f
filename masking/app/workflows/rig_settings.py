"""Settings of the verbs of `masking rig`: those that the command line puts together itself, and of learning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Final

from masking.inference.discovery.search_state import Tell
from masking.inference.procedures.calibration_findings import PERIOD
from masking.lab.plants.conformance import AMPLITUDE, RATE
from masking.lab.plants.controller_session import LONGEST_WATCHDOG, RATES
from masking.lab.runs.self_test import SIZE

TOLERANCE: Final = 0.05  # prior uncertainty of a parameter of a rig that nobody has calibrated


@dataclass(frozen=True)
class CheckSettings:
    """How a plant is checked.

    Args:
        address: such as udp://127.0.0.1:5005, serial:///dev/ttyACM0, mujoco:rig.xml or fmu:rig.fmu; the outputs move.
        lockstep: each side waits for the other; no clock.
        key: file of mode 0600 with a key that the server has, too.
        acknowledge: why the plant tripped in the last run was looked at; it is refused without.
        rate: samples per second.
        amplitude: largest command, in the actuators' units.
        plant: the rig's plant file, or a packaged plant: also pulse each actuator, and compare the answer with the
            twin's.
        pulse: size of a pulse, as a part of the largest command.
    """

    address: str
    lockstep: bool = False
    key: str | None = None
    acknowledge: bool = False
    rate: float = RATE
    amplitude: float = AMPLITUDE
    plant: str | None = None
    pulse: float = SIZE


@dataclass(frozen=True)
class ServeSettings:
    """How a plant, or the twin of one, is served.

    Args:
        plant: a packaged plant or a plant file, whose twin is served; or the address of a plant without a clock.
        address: udp://host:port, where port 0 takes a free one; serial:pty, a pseudo terminal; or a serial port.
        lockstep: wait for each command, instead of a clock of its own.
        record: folder for the plant's own record of each session.
        seed: of the noise of a twin's sensors.
        sessions: end after this number of them.
        limits: a packaged plant or a plant file, whose limits every command is brought within; by default those of the
            plant, and none for an address.
        watchdog: the longest that a controller may ask for, s.
        rates: the lowest and the highest that it may ask for, Hz.
        key: file of mode 0600 with a key that controllers must have; needed where other machines reach the address.
    """

    plant: str
    _: KW_ONLY
    address: str = "udp://127.0.0.1:5005"
    lockstep: bool = False
    record: str | None = None
    seed: int = 0
    sessions: int | None = None
    limits: str | None = None
    watchdog: float = LONGEST_WATCHDOG
    rates: tuple[float, float] = RATES
    key: str | None = None


@dataclass(frozen=True)
class RunSettings:
    """How an experiment runs on a rig.

    Args:
        experiment: a YAML file, or a name that 'masking list' shows.
        plant: address, such as udp://127.0.0.1:5005, serial:///dev/ttyACM0, mujoco:rig.xml or fmu:rig.fmu; a=ADDRESS
            for each plant of an experiment with several.
        lockstep: each side waits for the other; no clock.
        key: file of mode 0600 with a key that the server has, too.
        acknowledge: why the plant tripped in the last run was looked at; it is refused without.
        self_test: pulse each actuator first, and refuse a rig that does not answer as its twin does.
        spare: folder for the rest of the rows where that of the results is full; by default that for temporary files.
        page: show the run on a page on this machine, which can stop it, at this port; by default a free one.
        stream: send the rows to HOST:PORT as JSON over UDP, as PlotJuggler takes them.
        attended: with --page: the run waits until the page is open, and trips where it is not heard of for 2 s.
        stop_file: the run trips as soon as there is this file.
        out: folder to save the recording and its report in.
        overwrite: replace an earlier result in that folder.
    """

    experiment: str
    _: KW_ONLY
    plant: Sequence[str | Path]
    lockstep: bool = False
    key: str | None = None
    acknowledge: bool = False
    self_test: bool = False
    spare: str | None = None
    page: int | None = None
    stream: str | None = None
    attended: bool = False
    stop_file: str | None = None
    out: str | None = None
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class RigLearning:
    """How a rig learns what it is.

    Args:
        at: address of the rig, such as udp://127.0.0.1:5005 or serial:///dev/ttyACM0; by default the plant's twin.
        key: file of mode 0600 with a key that the server has, too.
        experiment: an experiment to run on the rig before and after, a YAML file or a name that 'masking list' shows.
        hours: that the rig may be driven or waited for.
        seconds: length of each record.
        tolerance: relative standard deviation of a parameter that declares none, before anything is recorded.
        lockstep: each side waits for the other; no clock.
        acknowledge: why the plant tripped before was looked at; a first start is refused without.
        out: folder of the records and of the result; one that holds the same, not yet finished, is gone on with.
        say: called with a sentence for each step.
        tell: called with the step under way, and the fraction done.
    """

    at: str | None = None
    key: str | None = None
    experiment: str | None = None
    hours: float = 1.0
    seconds: float = 2.0 * PERIOD
    tolerance: float = TOLERANCE
    lockstep: bool = False
    acknowledge: bool = False
    out: str | Path
    say: Callable[[str], None] | None = None
    tell: Tell | None = None
