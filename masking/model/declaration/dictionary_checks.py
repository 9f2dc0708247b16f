"""Checks of a user's dictionary of effects beyond its schema: names, symbols, units, and starts of fits.

A discovery solves for the parameters that are factors, starts from values that are `tried`, and holds those with a
`value`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from masking.errors import DeclarationError, Problem
from masking.lazy_imports import sympy as sp
from masking.model.declaration.dimensions import dimension_in, unit_problem
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import bounded, problem_at
from masking.model.declaration.operations import Step
from masking.model.declaration.schema import DictionaryDeclaration, OwnEffect
from masking.model.declaration.units import NONE, Dimension, describe, dimension_of

MOST_PARAMETERS = 7
MOST_STATES = 2  # as the kernels of discovery hold
MOST_STARTS = 60
SYMBOLS = {"element": ("d", "d_rate", "t"), "sensor": ("s",), "actuator": ("u",)}
# Names that would clash in a model with the effect, or in Python.
TAKEN = frozenset({"d", "d_rate", "v", "f", "s", "u", "xi", "on", "at", "effect", "label"})
# The units of a place, each with one that no template holds, so that dimensions tell them apart.
_UNITS = {
    "element": {"F": "cd", "D": "mol", "s": "s"},
    "sensor": {"S": "cd", "s": "s"},
    "actuator": {"U": "cd", "s": "s"},
}


def check_dictionary(declaration: DictionaryDeclaration, whole: bool, lost: Collection[str]) -> list[Problem]:
    """List everything that is wrong with a dictionary; of one that is not whole, only names and symbols.

    It is whole if the schema refused nothing of it; `lost` is not needed, since a dictionary has one section.
    """
    problems: list[Problem] = []
    if not declaration.dictionary:
        problems.append(problem_at(declaration, "dictionary", "the dictionary is empty", "declare an effect in it"))
    for name, effect in declaration.dictionary.items():
        checker = _Checker(declaration, f"dictionary.{name}", effect)
        unknown = [*checker.symbols()]
        problems += [*checker.names(), *unknown]
        problems += [*checker.units()] if whole else []
        problems += [*checker.numbers()] if whole and not unknown else []
    return problems


def factors(effect: OwnEffect) -> tuple[str, ...]:
    """Parameters that are factors of an effect: its force is a sum of terms with one of them each.

    Of a sensor or actuator the sum is added to the value. Rates of states hold no factor. Parameters with a `value` or
    with values to try are none.
    """
    held = set().union(*(state.rate.names for state in effect.states.values()))
    found: list[str] = []
    for name, parameter in effect.parameters.items():
        if parameter.value is None and not parameter.tried and name not in held:
            degree, _ = effect.expression.walk(_Factors({*found, name}))
            found += [name] if degree <= 1.0 else []
    _, rest = effect.expression.walk(_Factors(found))
    subject: object = {"sensor": "s", "actuator": "u"}.get(effect.where, 0.0)
    return tuple(found) if rest == subject else ()


_Rest = float | str | None  # a number, a symbol, or anything else


@dataclass(frozen=True, slots=True)
class _Factors:
    """Reads an expression as written: its degree in some symbols, infinite if no polynomial, and its rest at 0."""

    factors: Collection[str]

    def number(self, step: Step) -> tuple[float, _Rest]:
        return 0.0, None if step.value == "pi" else float(step.value)

    def symbol(self, step: Step) -> tuple[float, _Rest]:
        return (1.0, 0.0) if step.value in self.factors else (0.0, step.value)

    def apply(self, step: Step, args: Sequence[tuple[float, _Rest]]) -> tuple[float, _Rest]:
        degrees, (_, a), (_, b) = [degree for degree, _ in args], args[0], args[-1]
        degree, rest = 0.0 if max(degrees) == 0.0 else math.inf, None
        match step.operation:
            case "+" | "-" | "negative" as sign:
                degree, rest = max(degrees), _sum(a, b, sign)
            case "*":
                degree, rest = sum(degrees), _product(a, b)
            case "/":
                degree = degrees[0] if degrees[1] == 0.0 else math.inf
                rest = a if a == 0.0 or b == 1.0 else None
            case "where":
                degree = max(degrees) if degrees[0] == 0.0 else math.inf
                rest = b if args[1][1] == b else None
        return degree, rest


def _sum(a: _Rest, b: _Rest, sign: str) -> _Rest:
    if b == 0.0:
        return a  # of a negative, too: a is b
    return b if a == 0.0 and sign == "+" else None


def _product(a: _Rest, b: _Rest) -> _Rest:
    if 0.0 in (a, b):
        return 0.0
    return b if a == 1.0 else a if b == 1.0 else None


def _refusals(expression: Expression) -> tuple[Problem, ...]:
    """Problems of an expression that show once it is simplified, such as a division by x - x."""
    try:
        expression.to_sympy({symbol: sp.Symbol(symbol, real=True) for symbol in expression.symbols})
    except DeclarationError as error:
        return error.problems
    return ()


@dataclass(frozen=True)
class _Checker:
    """Checks one effect of a dictionary; `path` is its place."""

    declaration: DictionaryDeclaration
    path: str
    effect: OwnEffect

    def names(self) -> Iterator[Problem]:
        """Check the names of parameters and states, and how many there are."""
        effect = self.effect
        for section, most, what in (("parameters", MOST_PARAMETERS, "parameters"), ("states", MOST_STATES, "states")):
            names = getattr(effect, section)
            if len(names) > most:
                message = f"{len(names)} {what} are too many"
                remedy = f"an effect has at most {MOST_PARAMETERS} parameters and {MOST_STATES} states"
                yield self._problem(section, message, remedy, at_key=True)
            for name in names:
                if name in TAKEN:
                    message = f"the name '{name}' is taken in an effect"
                    yield self._problem(f"{section}.{name}", message, f"choose another, such as {name}0", at_key=True)
                elif section == "states" and name in effect.parameters:
                    message = f"the name '{name}' is already used in parameters"
                    yield self._problem(f"{section}.{name}", message, "rename one of them", at_key=True)

    def symbols(self) -> Iterator[Problem]:
        """Check the symbols of expressions, and that they can be compiled."""
        effect = self.effect
        rates = [state.rate for state in effect.states.values()]
        allowed = [*SYMBOLS[effect.where], *effect.parameters, *effect.states]
        for expression in (effect.expression, *rates):
            unknown = expression.check_symbols(allowed)
            yield from unknown or _refusals(expression)
        for state in effect.states.values():
            yield from state.size.check_symbols([*effect.parameters]) if state.size is not None else ()

    def numbers(self) -> Iterator[Problem]:
        """Check that all is used, bounds and values, and that a discovery can estimate or hold each parameter."""
        effect, found = self.effect, factors(self.effect)
        used = effect.expression.names.union(*(state.rate.names for state in effect.states.values()))
        for name in {**effect.parameters, **effect.states}.keys() - used:
            section, what = ("parameters", "parameter") if name in effect.parameters else ("states", "state")
            message, remedy = f"the {what} '{name}' is not used", "remove it or use it"
            yield self._problem(f"{section}.{name}", message, remedy, at_key=True)
        for name, parameter in effect.parameters.items():
            path = f"parameters.{name}"
            shown = f"{parameter.value or 0.0:g}"
            yield from bounded(self.declaration, f"{self.path}.{path}", shown, parameter.value, parameter.bounds)
            if name in used - {*found} and parameter.value is None and not parameter.tried:
                message = f"'{name}' is no factor of what the effect does"
                values = "values that a discovery begins from, such as 'tried: [0.1, 0.3, 1]', or a 'value' to hold"
                yield self._problem(path, message, f"give {values}", at_key=True)
        starts = math.prod(len(parameter.tried) for parameter in effect.parameters.values() if parameter.tried)
        if starts > MOST_STARTS:
            message, remedy = f"{starts} combinations of values to try are too many", f"try at most {MOST_STARTS}"
            yield self._problem("parameters", message, remedy, at_key=True)

    def units(self) -> Iterator[Problem]:
        """Check that units are made of those of the place, and that the expressions have the dimensions they should."""
        effect, units = self.effect, _UNITS[self.effect.where]
        problems: list[Problem] = []
        symbols: dict[str, Dimension | None] = {"t": dimension_of("s")}
        templates = {f"parameters.{name}": parameter.unit for name, parameter in effect.parameters.items()}
        templates |= {f"states.{name}": state.unit for name, state in effect.states.items()}
        for path, unit in templates.items():
            try:
                symbols[path.partition(".")[2]] = self._dimension(unit)
            except DeclarationError as error:
                problems.append(unit_problem(self.declaration, f"{self.path}.{path}.unit", error))
        if problems:
            yield from problems
            return
        subject = dimension_of("cd")
        symbols |= {"s": subject, "u": subject, "d": dimension_of("mol"), "d_rate": dimension_of("mol/s")}
        letter = next(iter(units))
        what = f"{effect.where}'s value" if effect.where != "element" else "force"
        yield from self._same(effect.expression, symbols, subject, f"the {what} is {letter}")
        for name, state in effect.states.items():
            own = symbols[name] or NONE
            rate = tuple(a - b for a, b in zip(own, dimension_of("s"), strict=True))
            yield from self._same(state.rate, symbols, rate, f"the rate of '{name}' is {self._shown(describe(rate))}")
            if state.size is not None:
                yield from self._same(state.size, symbols, own, f"the state '{name}' is {self._shown(describe(own))}")

    def _dimension(self, unit: str) -> Dimension:
        """Give the dimension of a unit, with those that stand for the place's."""
        units, template = _UNITS[self.effect.where], Expression(unit, path="unit")
        if template.symbols <= units.keys():
            return dimension_of(template.renamed(units))
        *first, last = units
        made = f"made of {', '.join(first)} and {last}, such as {_SUCH[first[0]]}"
        remedy = f"units of {_A[self.effect.where]} are {made}"
        step = template.first(min(template.symbols - units.keys()))
        raise DeclarationError(template.problem(step, f"'{step.value}' is no unit here", remedy))

    def _same(
        self, expression: Expression, symbols: Mapping[str, Dimension | None], wanted: Dimension, said: str
    ) -> Iterator[Problem]:
        if expression.unknown(symbols):
            return  # it has its own problem
        try:
            found = dimension_in(expression, symbols)
        except DeclarationError as error:
            yield from (replace(problem, message=self._shown(problem.message)) for problem in error.problems)
            return
        if found is not None and found != wanted:
            is_number = "a number without unit" if found == NONE else self._shown(describe(found))
            yield expression.problem((0, len(expression.text)), f"{said}, the expression {is_number}")

    def _shown(self, text: str) -> str:
        """Write a text with the units of the place instead of their stand-ins."""
        for letter, unit in _UNITS[self.effect.where].items():
            text = re.sub(rf"\b{unit}\b", letter, text)
        return text

    def _problem(self, path: str, message: str, remedy: str = "", at_key: bool = False) -> Problem:
        return problem_at(self.declaration, f"{self.path}.{path}", message, remedy, at_key)


_A = {"element": "an element", "sensor": "a sensor", "actuator": "an actuator"}
_SUCH = {"F": "F/D", "S": "1/S", "U": "1/U"}
