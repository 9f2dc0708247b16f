"""Units of a model's quantities: conversion to SI, and to the scales that the model declares.

Equations that are dimensionally homogeneous keep their form when every quantity is measured in other coherent
units. A model becomes dimensionless, then, by measuring its parameters in its declared scales: a quantity whose
dimension is the product of scale_k to the power e_k is divided by that product.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

from masking.errors import DeclarationError, ModelError, Problem, nearest
from masking.lazy_imports import sympy as sp
from masking.model.declaration import schema
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import bounded
from masking.model.declaration.units import Conversion, combined, conversion

PLAIN = "1"
SECOND = "s"


class Shown(NamedTuple):
    """How a quantity is read, shown and recorded: its unit, and how much of what is computed with one of it is."""

    unit: str
    size: float

    def text(self, value: float, digits: int = 6) -> str:
        """Value that is computed, in words: 180 deg."""
        return f"{value / self.size:.{digits}g}{'' if self.unit == PLAIN else f' {self.unit}'}"


@dataclass(frozen=True)
class Units:
    """The conversions of a model's units, by the text of each that it uses, and its parameters converted."""

    declaration: schema.ModelDeclaration
    conversions: Mapping[str, Conversion]

    @classmethod
    def of(cls, declaration: schema.ModelDeclaration) -> Units:
        """Derive the conversions of all units of a model; a `ModelError` says which one its scales cannot express."""
        scales = {name: scale.unit for name, scale in declaration.scales.items()}
        found = {PLAIN: Conversion(1.0, {}, PLAIN)}
        with contextlib.suppress(DeclarationError):  # scales without a time leave it in seconds
            found[SECOND] = conversion(SECOND, scales)
        for what, unit in _units(declaration).items():
            if unit not in found:
                try:
                    found[unit] = conversion(unit, scales)
                except DeclarationError as error:
                    raise ModelError(f"{declaration.name}: {what} [{unit}]: {error}") from None
        return cls(declaration, found)

    @classmethod
    def from_meta(cls, declaration: schema.ModelDeclaration, meta: Mapping[str, Any]) -> Units:
        """Conversions that a generated module remembers."""
        return cls(declaration, {unit: Conversion(*parts) for unit, parts in meta.items()})

    def to_meta(self) -> dict[str, Any]:
        """Conversions in a form that a generated module can hold."""
        return {unit: (c.factor, dict(c.exponents), c.si) for unit, c in self.conversions.items()}

    @property
    def is_plain(self) -> bool:
        """Whether the model uses no units at all."""
        return all(unit == PLAIN for what, unit in _units(self.declaration).items() if not what.startswith("scales."))

    def parameter_values(self, overrides: Mapping[str, float], *, dimensionless: bool) -> dict[str, float]:
        """Every parameter, in SI units or in the declared scales, with overrides in the declared units.

        Raises a `DeclarationError` where an override names no parameter, or a value is out of its bounds.
        """
        parameters = self.declaration.parameters
        values = self._si_values(overrides)
        if not dimensionless:
            return {name: values[name] for name in parameters}
        scales = self.scale_values(overrides)
        return {name: values[name] / self.conversions[p.unit].scale(scales) for name, p in parameters.items()}

    def exact_values(self, overrides: Mapping[str, float], *, dimensionless: bool) -> dict[str, sp.Expr]:
        """Every parameter exactly: as the decimals that are written, and expressions of these."""
        parameters, found = self.declaration.parameters, dict[str, sp.Expr]()
        for name in self._si_values(overrides):
            parameter = parameters[name]
            found[name] = self._exact(overrides.get(name, parameter.value), parameter.unit, found)
        if dimensionless:
            scales = {n: self._exact(s.value, s.unit, found) for n, s in self.declaration.scales.items()}
            for name, parameter in parameters.items():
                powers = self.conversions[parameter.unit].exponents
                exact = {n: sp.Rational(Fraction(power).limit_denominator(60)) for n, power in powers.items()}
                found[name] /= math.prod(scales[n] ** power for n, power in exact.items())
        return {name: found[name] for name in parameters}

    def scale_values(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Declared scales in SI units; raises a `DeclarationError` where one is not positive."""
        values = self._si_values(overrides)
        found = {}
        for name, scale in self.declaration.scales.items():
            si = self._si(scale.value, scale.unit, values)
            if not si > 0.0:
                message = f"the scale is {si:g} {scale.unit}; a scale must be positive"
                raise DeclarationError(Problem(self.declaration.place(f"scales.{name}"), f"scales.{name}", message))
            found[name] = si
        return found

    def check_names(self, names: Iterable[str]) -> None:
        """Refuse names that are not parameters; a `DeclarationError` says which name was probably meant."""
        for name in names:
            if name not in self.declaration.parameters:
                message = f"{self.declaration.name} has no parameter '{name}'"
                raise DeclarationError(Problem(None, name, message, nearest(name, self.declaration.parameters)))

    def size(self, unit: str, overrides: Mapping[str, float]) -> float:
        """Return what the scales make of a unit's dimension, in SI units; 1 where there are no scales for it."""
        known = self.conversions.get(unit)
        return known.scale(self.scale_values(overrides)) if known is not None else 1.0

    def shown(self, unit: str, *, dimensionless: bool, is_rate: bool = False) -> Shown:
        """How a quantity with a declared unit is shown: in that unit, or as a multiple of the declared scales.

        What the scales leave as it is, such as an angle, keeps its unit. Its rate is per second, or per unit of time in
        scales and in a model without any unit.
        """
        found = self.conversions[unit]
        if dimensionless and any(found.exponents.values()):
            return Shown(PLAIN, 1.0)
        is_timed = is_rate and not dimensionless and not self.is_plain
        return Shown(combined("U/s", {"U": unit}) if is_timed else unit, found.factor)

    @cached_property
    def computed(self) -> Mapping[bool, Mapping[str, str]]:
        """Units of the states and of the time `t` as they are computed: SI (False), or what the scales leave (True)."""
        return {dimensionless: dict(self._computed(dimensionless)) for dimensionless in (False, True)}

    def _computed(self, dimensionless: bool) -> Iterator[tuple[str, str]]:
        d, is_timed = self.declaration, not dimensionless and not self.is_plain
        yield "t", SECOND if is_timed else ""
        units = {name: entry.unit for entries in (d.coordinates, d.states) for name, entry in entries.items()}
        for name, declared in units.items():
            known = self.conversions[declared]
            unit = PLAIN if dimensionless and any(known.exponents.values()) else known.si
            yield name, "" if unit == PLAIN else unit
            yield f"{name}'", combined("U/s", {"U": unit}) if is_timed else "" if unit == PLAIN else unit

    def _si_values(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Every parameter in SI units, each after those that its expression holds."""
        parameters = self.declaration.parameters
        self.check_names(overrides)
        found: dict[str, float] = {}
        pending = dict(parameters)
        while pending:  # the declaration has been checked for cycles
            for name, parameter in list(pending.items()):
                value = overrides.get(name, parameter.value)
                if isinstance(value, Expression) and value.names & pending.keys():
                    continue
                found[name] = self._si(value, parameter.unit, found)
                del pending[name]
                value = found[name] / self.conversions[parameter.unit].factor
                unit = "" if parameter.unit == PLAIN else f" {parameter.unit}"
                shown = f"{name} = {value:g}{unit}"
                if problems := [*bounded(self.declaration, f"parameters.{name}", shown, value, parameter.bounds)]:
                    raise DeclarationError(problems)
        return found

    def _exact(self, value: float | Expression, unit: str, values: Mapping[str, sp.Expr]) -> sp.Expr:
        """Declared value in SI units, exactly."""
        factor = sp.Rational(repr(float(self.conversions[unit].factor)))
        if isinstance(value, Expression):
            return value.to_sympy(values) * (1 if value.names else factor)
        return sp.Rational(repr(float(value))) * factor

    def _si(self, value: float | Expression, unit: str, values: Mapping[str, float]) -> float:
        """Declared value in SI units; an expression of parameters is one of their SI values."""
        if isinstance(value, Expression):
            computed = value.evaluate(values)
            return computed if value.names else computed * self.conversions[unit].factor
        return value * self.conversions[unit].factor


def _units(declaration: schema.ModelDeclaration) -> dict[str, str]:
    """Unit text of every quantity of a model, by its path in the declaration."""
    sections = ("coordinates", "states", "inputs", "parameters", "scales")
    return {f"{kind}.{n}": entry.unit for kind in sections for n, entry in getattr(declaration, kind).items()}
