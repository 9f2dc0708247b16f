"""Design of a sweep: what varies, over which grids, lists and distributions, and the values of each run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal, NoReturn, Protocol, TypeAlias, runtime_checkable

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import DeclarationError, Problem, RecordError
from masking.lab.records import foreign_json
from masking.lazy_imports import stats

Sampling = Literal["random", "latin", "sobol"]
MOST_VALUES: Final = 10_000_000  # of what varies, in all runs
FACTOR: Final = "x:"  # before values that the declared one is multiplied by
FIT: Final = "fit:"  # before the file of a fit
_FORMS: Final = (
    "write LOW:HIGH:NUMBER, LOW:HIGH:NUMBER:log, A,B,C, normal:MEAN:DEVIATION, uniform:LOW:HIGH or "
    "loguniform:LOW:HIGH, with x: in front for multiples of the declared value"
)


@runtime_checkable
class Distribution(Protocol):
    """A distribution, such as a frozen one of `scipy.stats`."""

    def ppf(self, q: Array) -> Array:
        """Values below which the parts q of it lie."""


Values: TypeAlias = str | Distribution | Sequence[float] | Array


@dataclass(frozen=True)
class Axis:
    """What varies along one direction of a sweep."""

    names: tuple[str, ...]  # of what gets the value; all of them the same
    values: Array | None = None  # of a grid or list (k,); None where they are drawn
    distribution: Distribution | None = None  # that values are drawn from; None where there are values
    is_factor: bool = False  # whether declared values are multiplied by it

    @property
    def label(self) -> str:
        """Name of its column."""
        return ",".join(self.names)


@dataclass(frozen=True)
class _Value:
    """What a fit says of a parameter."""

    value: float


@dataclass(frozen=True)
class _Fit:
    """What a fit has to say, by the keys of its file."""

    parameters: dict[str, _Value]
    covariance: list[list[float]]


@dataclass(frozen=True)
class Joint:
    """Values that are drawn together: mean + root z, z independent and standard normal."""

    first: int  # place of the first of their axes
    mean: Array  # (k,)
    root: Array  # of their covariance (k, k)


@dataclass(frozen=True)
class Design:
    """The runs of a sweep: at each point of the grid, the same values that are drawn."""

    axes: tuple[Axis, ...]  # what varies
    runs: int = 1  # drawn at each point of the grid
    seed: int = 0  # of what is drawn
    sampling: Sampling = "random"  # independent draws, a Latin hypercube, or Sobol's sequence with Owen's scrambling
    joint: tuple[Joint, ...] = ()  # axes that are drawn together

    @property
    def grid(self) -> tuple[Axis, ...]:
        """Axes that have a grid or a list."""
        return tuple(axis for axis in self.axes if axis.values is not None)

    @cached_property
    def points(self) -> Array:
        """Values of each run (rows, axes): the last axis of the grid first, then what is drawn."""
        lists = [axis.values for axis in self.axes if axis.values is not None]
        meshes = np.meshgrid(*lists, indexing="ij")
        grid = np.stack([one.ravel() for one in meshes], axis=-1) if lists else np.empty((1, 0))
        drawn = self._drawn()
        found = np.empty((len(grid) * self.runs, len(self.axes)))
        at = np.array([axis.values is not None for axis in self.axes], dtype=bool)
        found[:, at] = np.repeat(grid, self.runs, axis=0)
        found[:, ~at] = np.tile(drawn, (len(grid), 1))
        return found

    def _drawn(self) -> Array:
        """Random values (runs, axes that are drawn)."""
        axes = [(i, axis) for i, axis in enumerate(self.axes) if axis.distribution is not None]
        if not axes:
            return np.empty((self.runs, 0))
        parts, found = self._unit(len(axes)), dict[int, Array]()
        for column, (i, axis) in enumerate(axes):
            assert axis.distribution is not None  # noqa: S101  # chosen above
            found[i] = np.asarray(axis.distribution.ppf(parts[:, column]), dtype=float)
        for joint in self.joint:
            places = range(joint.first, joint.first + len(joint.mean))
            together = joint.mean + np.column_stack([found[i] for i in places]) @ joint.root.T
            found |= dict(zip(places, together.T, strict=True))
        return np.column_stack([found[i] for i, _ in axes])

    def _unit(self, dimensions: int) -> Array:
        """Points of the unit cube (runs, dimensions)."""
        generator = np.random.default_rng(self.seed)
        if self.sampling == "latin":
            return np.asarray(stats.qmc.LatinHypercube(dimensions, seed=generator).random(self.runs))
        if self.sampling == "sobol":  # balanced for powers of two, the first of which are taken
            sobol = stats.qmc.Sobol(dimensions, seed=generator)
            return np.asarray(sobol.random_base2(max(0, math.ceil(math.log2(self.runs)))))[: self.runs]
        return generator.random((self.runs, dimensions))

    @classmethod
    def of(cls, over: Mapping[str, Values], runs: int | None, seed: int, sampling: Sampling) -> Design:
        """Design of what a sweep is given: values by what varies, and the runs drawn at each point of the grid.

        Several names with commas between them get the same value. A DeclarationError where values cannot be read, or
        what is drawn has no number of runs.
        """
        axes, joint = list[Axis](), list[Joint]()
        for key, given in over.items():
            if isinstance(given, str) and given.startswith(FIT):
                fitted, mean, root = _fit(key, given.removeprefix(FIT))
                joint.append(Joint(len(axes), mean, root))
                axes += [Axis((f"{key}.{name}",), distribution=stats.norm()) for name in fitted]
            else:
                axes.append(_axis(key, given))
        drawn = [axis.label for axis in axes if axis.distribution is not None]
        if drawn and runs is None:
            _refuse(drawn[0], "is drawn from a distribution", "say how many runs, such as --runs 1000 (runs=1000)")
        if not axes and runs is None:
            _refuse("over", "nothing varies", "name something, such as --over z=0.1:0.3:20, or give --runs")
        if runs is not None and runs < 1:
            _refuse("runs", f"must be at least 1, not {runs}")
        if seed < 0:
            _refuse("seed", f"must be at least 0, not {seed}")
        rows = math.prod(len(axis.values) for axis in axes if axis.values is not None) * (runs or 1)
        if rows * max(1, len(axes)) > MOST_VALUES:
            remedy = f"take coarser grids or fewer runs, {MOST_VALUES} values in all at most"
            _refuse("over", f"asks for {rows:.3g} runs of {len(axes)} values each", remedy)
        if sampling not in {"random", "latin", "sobol"}:
            _refuse("sampling", f"there is no '{sampling}'", "give random, latin or sobol")
        return cls(tuple(axes), runs or 1, seed, sampling, tuple(joint))


def _axis(key: str, given: Values) -> Axis:
    names = tuple(name.strip() for name in key.split(","))
    is_factor = isinstance(given, str) and given.startswith(FACTOR)
    if isinstance(given, str):
        given = _read(key, given.removeprefix(FACTOR))
    if isinstance(given, Distribution):
        return Axis(names, distribution=given, is_factor=is_factor)
    values = np.atleast_1d(np.asarray(given, dtype=float))
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        _refuse(key, "needs finite values in one row", _FORMS)
    return Axis(names, values=values, is_factor=is_factor)


def _read(key: str, text: str) -> Distribution | Array:
    """Read values as the command line has them."""
    kind, *rest = text.split(":")
    try:
        if kind in {"normal", "uniform", "loguniform"}:
            a, b = map(float, rest)
            is_wide = b > 0.0 if kind == "normal" else b > a and (a > 0.0 or kind == "uniform")
            if not (is_wide and math.isfinite(b - a)):
                raise ValueError(text)
            made: dict[str, Any] = {"normal": stats.norm, "loguniform": stats.loguniform}
            found: Distribution = stats.uniform(a, b - a) if kind == "uniform" else made[kind](a, b)
            return found
        if not rest:
            return np.array([float(x) for x in kind.split(",")])
        low, high, count = float(kind), float(rest[0]), int(rest[1])
        if (
            rest[2:] not in ([], ["log"])
            or count < 1
            or not math.isfinite(high - low)
            or (rest[2:] and low * high <= 0.0)
        ):
            raise ValueError(text)
        if count > MOST_VALUES:
            _refuse(key, f"'{text}' has {count} values", f"take {MOST_VALUES} at most")
        return np.geomspace(low, high, count) if rest[2:] else np.linspace(low, high, count)
    except (ValueError, IndexError):
        _refuse(key, f"'{text}' cannot be read", _FORMS)


def _fit(key: str, path: str) -> tuple[list[str], Array, Array]:
    """Names, values and root of the covariance of a fit."""
    remedy = "name the fit.json that 'masking identify' writes"
    try:
        content = foreign_json.load(path, _Fit)
    except RecordError as error:
        _refuse(key, f"no fit with a covariance: {error}", remedy)
    values = {name: entry["value"] for name, entry in content["parameters"].items()}
    try:
        covariance = np.array(content["covariance"], dtype=float).reshape(len(values), len(values))
        return [*values], np.array([*values.values()]), np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except ValueError as error:  # of its shape, or as one that is of no positive covariance
        _refuse(key, f"no fit with a covariance: {path}: {error}", remedy)


def _refuse(name: str, message: str, remedy: str = "") -> NoReturn:
    raise DeclarationError(Problem(None, name, message, remedy))
