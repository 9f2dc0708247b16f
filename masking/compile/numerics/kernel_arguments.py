"""Structs that kernels take; the fields of each go through the C interface one by one, in this order."""

from __future__ import annotations

from typing import Any, NamedTuple

from masking.compile.numerics.arrays import IntMatrix, IntVector, Matrix, Vector


class Accuracy(NamedTuple):
    """Local relative error of an integration step, and the length of every step; 0 to control it."""

    tolerance: float
    fixed_step: float


class Samples(NamedTuple):
    """Samples of a run: index of the first, number, time between two, steps in between, one recorded of how many."""

    begin: int
    samples: int
    dt: float
    substeps: int
    every: int


class UnderWay(NamedTuple):
    """Commands under way (commands, actuators), the newest last, and how many samples later each actuator acts."""

    queue: Matrix
    late: Vector


class States(NamedTuple):
    """Recorded states and inputs, a row for each recorded sample."""

    states: Matrix
    inputs: Matrix


class Reached(NamedTuple):
    """Status, time reached and steps of each run (runs, 3), and its states at the times, m rows of (runs m, n)."""

    ends: Matrix
    states: Matrix


class Unit(NamedTuple):
    """Arrays of a sampled controller that last from sample to sample."""

    x: Vector  # its memory, as `Sizes.power` says
    p: Vector  # parameters of the control law
    gain: Matrix  # of the observer (estimate, sensors), or the coordinates that readings give (n, sensors)
    limits: Matrix  # of the actuators, a row each


class Rig(NamedTuple):
    """A simulated rig: state, parameters, and the fields of `UnderWay`."""

    y: Vector
    p: Vector
    queue: Matrix
    late: Vector


class Recorded(NamedTuple):
    """Recorded tables of a run, a row for each sample; `estimates` are the first columns of the controller's memory."""

    states: Matrix
    estimates: Matrix
    sensed: Matrix
    demanded: Matrix
    applied: Matrix


class Parts(NamedTuple):
    """Functions of a rig and of a control law that `sampled_loop.control_with_model` calls."""

    law: Any
    rate: Any
    measure: Any
    allocate: Any
    wire: Any
    virtual: Any
    momentum: Any
    remember: Any
    lagged: Any
    conditions: Any


class Steps(NamedTuple):
    """Samples of a record, time between two, integration steps in between, and whether commands are linear there."""

    samples: int
    dt: float
    substeps: int
    is_linear: int


class Shooting(NamedTuple):
    """Where the motion of a record begins, and its derivatives."""

    k: int  # columns of the basis
    free: IntVector  # states that may have any value at the beginning of each shooting interval
    starts: Matrix  # states there (intervals, n)
    y: Vector  # state, that at the end afterwards
    columns: Matrix  # derivatives of the state, then work space, `COLUMN_ROWS` rows for each state


class Readings(NamedTuple):
    """A record (m, actuators), (m, sensors), and the weight of squared residuals of each sensor (sensors,)."""

    commands: Matrix
    readings: Matrix
    weights: Vector


class Sums(NamedTuple):
    """Normal equations of each shooting interval, squared residuals (sensors,), and simulated readings (m, sensors)."""

    matrix: Matrix
    gradient: Vector
    squares: Vector
    simulated: Matrix


class TwinArrays(NamedTuple):
    """Arrays that a twin is simulated with."""

    p: Vector  # the parameter array
    moved: IntMatrix  # terms of (df/dp) B in the rates, for `motion_sensitivities.put_entries`
    moved_by: Vector  # their values
    read: IntMatrix  # terms in the readings
    read_by: Vector
    coordinates: int  # how many of the states are coordinates, whose rates are the states that follow them
    late: Vector  # samples after which each actuator acts
    commanded: int  # first of the columns of derivatives by entries that are by commands
    late_columns: IntVector  # column of each actuator's delay, or -1
    lead: Vector  # derivative of each command by its delay, work space


class FilterSteps(NamedTuple):
    """Samples that a filter follows: first, number, the fields of `Steps`, and how often each is linearised."""

    begin: int
    samples: int
    dt: float
    substeps: int
    is_linear: int
    updates: int


class FilteredTwin(NamedTuple):
    """State and parameters that a filter estimates, and how rates depend on these."""

    coordinates: int  # how many of the states are coordinates
    affected: IntVector  # indices of the entries of p that depend on the parameters
    y: Vector  # state (n,)
    theta: Vector  # parameters (k,)
    p: Vector  # the parameter array
    basis: Matrix  # its derivatives by the parameters (affected, k)
    moved: IntMatrix  # as those of `TwinArrays`
    moved_by: Vector


class FilterRecord(NamedTuple):
    """A record, variances of readings (sensors,) and of rates (n,) per second, and limits of parameters (3, k)."""

    commands: Matrix
    readings: Matrix
    r: Vector
    q: Vector
    limits: Matrix


class Filtered(NamedTuple):
    """States (m, n), parameters and deviations (m, 2 k), innovations, as they are and normalised (m, 2 sensors)."""

    states: Matrix
    estimates: Matrix
    innovations: Matrix


class LatentRig(NamedTuple):
    """A rig with latent forces, x = (y, forces), whose indices in the parameter array p are `ports`."""

    ports: IntVector  # of the forces
    x: Vector  # state, then forces (n + forces,)
    p: Vector  # the parameter array
    gain: Matrix  # of the filter (n + forces, sensors)
    kept: float  # part of the forces that goes on to the next sample


class KnownMotion(NamedTuple):
    """States (m, n), with forces of latent sources behind, and commands (m, actuators)."""

    states: Matrix
    commands: Matrix


class Pieces(NamedTuple):
    """Samples, the time between two, and the pieces of it in which an effect's state is integrated."""

    samples: int
    dt: float
    pieces: int


class Course(NamedTuple):
    """What an effect follows (m,), and its rate (m,)."""

    x: Vector
    rate: Vector


class Blocks(NamedTuple):
    """Samples, the time between two, samples of a mean, and those of a shooting interval."""

    samples: int
    dt: float
    every: int
    interval: int


class Sources(NamedTuple):
    """Of each response the affected entry that a force acts at, and the state that begins at 1, or -1."""

    entries: IntVector
    initial: IntVector


class Watched(NamedTuple):
    """Tables of `safety_kernels.watch`; columns are in `safety_tables`."""

    sensors: Matrix  # declared limits and noise
    seen: Matrix  # memory of each sensor
    model: Matrix  # accelerations by readings, then by commands
    past: Matrix  # latest readings
    sent: Matrix  # latest commands
    limits: Matrix  # of positions and speeds
    weights: Matrix  # of readings in these
    by_estimate: Matrix  # of the estimate in these
    reaction: Matrix  # of each actuator's response
    counts: IntVector  # of samples
    settings: IntVector  # in samples
    report: Vector  # channel, value and limit of a cause


class Guarded(NamedTuple):
    """Tables of `safety_kernels.guard`: limits and energy of the actuators, and four fields as those of `Watched`."""

    table: Matrix
    energy: Matrix
    sent: Matrix
    counts: IntVector
    settings: IntVector
    report: Vector
