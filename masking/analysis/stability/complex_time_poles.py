"""Poles: which oscillators, each moving by itself, keep a sum of their motions constant.

Motions of x'' = -a x - b x^3 and of pendula are elliptic functions. In complex time x, and th' of a pendulum, have
simple poles. The nearest to the real axis are at a distance tau from each extremum of x, and from each passage of a
pendulum through its lowest point; tau falls strictly as the energy grows:

    tau = integral of ds / sqrt((s^2 - 1) (a + b A^2 (s^2 + 1) / 2)) from 1 to infinity, A the amplitude of x,
    tau = integral of dp / sqrt(2 (E + w^2 cosh p)) from 0 to infinity, E = th'^2/2 - w^2 cos th.

The residues are +-i sqrt(2/b) and +-2i. A sum that is constant has none, so that they cancel. Of oscillators with the
same a (or w), those with the largest energy have the nearest poles. Where these cancel among themselves, they fall into
groups that reach their extrema at once, the signed residues in each adding up to 0; equations and states of a group are
the same but for scale and sign, so that its part of the sum is 0. Then the same holds of the others, until only states
of rest are left.

Nor do poles of oscillators with different a cancel. At one distance from the real axis these have different periods T,
since T and tau determine a. The poles of one are at t + m T/2, with signs (-1)^m: a function of period T whose lowest
frequency, 1/T, is in none of those with shorter periods. There the poles of the longest period cancel alone, which two
of them do only where they do so everywhere. Three may not; then, and for more than two pendula, which may turn over,
the residues of different oscillators are asked not to add up to 0.

Source: Whittaker and Watson, A Course of Modern Analysis (1927), chapters 20 and 22.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import sympy as sp

from masking.analysis.stability.algebra import coefficients, normal, without_void
from masking.analysis.stability.hypotheses import Hypotheses
from masking.errors import ModelError

_MOST_OSCILLATORS = 6  # of one kind: 3^6 / 2 sums of residues are looked at
_MOST_FAMILIES = 500

Group = tuple[int, ...]  # sign of each oscillator of a kind in a group, 0 outside of it


@dataclass(frozen=True)
class Oscillator:
    """An oscillator x'' = -stiffness y - cubic y^3 with y = x - centre, or -stiffness sin(x)."""

    place: sp.Symbol  # x
    kind: Literal["cubic", "sine", "linear", "free"]  # 'free' where the sum does not hold it
    stiffness: sp.Expr = sp.S.Zero  # a, or w^2 of a pendulum
    cubic: sp.Expr = sp.S.Zero  # b
    centre: sp.Expr = sp.S.Zero  # where it rests; 0 for a pendulum, which may rest at pi, too
    weight: sp.Expr = sp.S.Zero  # of x, or of th''/stiffness, in the sum that is constant

    @property
    def size(self) -> sp.Expr:
        """Factor of x with which the cubic term is y^3."""
        return sp.sqrt(self.cubic) if self.kind == "cubic" else sp.Integer(1)

    @property
    def residue(self) -> sp.Expr:
        """Size of its residues in the sum, but for a factor that all of its kind have."""
        return self.weight / self.size


def oscillators(
    relation: sp.Expr, accelerations: Mapping[sp.Symbol, sp.Expr], circles: Sequence[sp.Symbol], given: Hypotheses
) -> tuple[Oscillator, ...]:
    """Each oscillator in a sum that is constant.

    The relation is the sum, linear in displacements or in sines of angles, less its value.

    Raises:
        ModelError: one of them does not move by itself, is of no such kind, or the sum is of another form.
    """
    parts, found = coefficients(relation, tuple(accelerations)), []
    parts.pop(sp.Integer(1), None)
    for x, acceleration in accelerations.items():
        weight, wave = (without_void(parts.pop(f, sp.Integer(0)), given) for f in (x, sp.sin(x)))
        if acceleration.free_symbols - {x} - {*given.symbols.values()}:
            raise ModelError(f"{x} does not move by itself, {x}'' = {acceleration}")
        if not all(w == 0 or given.is_nonzero(w) for w in (weight, wave)):
            raise ModelError(f"whether {relation} = 0 holds {x} is not known")
        if weight == 0 and wave == 0:
            found.append(Oscillator(x, "free"))
        elif wave == 0:
            found.append(_sprung(x, acceleration, weight, given))
        elif weight == 0 and x in circles:
            found.append(_pendulum(x, acceleration, wave, given))
        else:
            raise ModelError(f"{relation} = 0 holds {x} both by itself and in a sine")
    if parts:
        raise ModelError(f"{relation} = 0 is no sum of displacements and sines")
    return tuple(found)


def _sprung(x: sp.Symbol, acceleration: sp.Expr, weight: sp.Expr, given: Hypotheses) -> Oscillator:
    """Oscillator with a spring that is linear or cubic about its centre."""
    if acceleration.is_polynomial(x) and (degree := sp.Poly(acceleration, x).degree()) in {1, 3}:
        force = sp.Poly(-acceleration, x)
        lead = force.LC()
        centre = normal(-force.coeff_monomial(x ** (degree - 1)) / (degree * lead))
        about = sp.Poly(force.as_expr().subs(x, x + centre), x)
        slope = normal(about.coeff_monomial(x))
        is_odd = normal(about.coeff_monomial(1)) == 0
        if is_odd and given.sign(lead) == 1 and given.declared_sign(slope, strictly=False) in {0, 1}:
            kind: Literal["cubic", "linear"] = "cubic" if degree == 3 else "linear"
            return Oscillator(x, kind, slope, lead if degree == 3 else sp.Integer(0), centre, weight)
    raise ModelError(f"{x}'' = {acceleration} is no spring a x + b x**3 about its centre with a >= 0 and b > 0")


def _pendulum(x: sp.Symbol, acceleration: sp.Expr, wave: sp.Expr, given: Hypotheses) -> Oscillator:
    stiffness = normal(-acceleration / sp.sin(x))
    if x in stiffness.free_symbols or given.sign(stiffness) != 1:
        raise ModelError(f"{x}'' = {acceleration} is no pendulum")
    return Oscillator(x, "sine", stiffness, weight=normal(wave / stiffness))


@dataclass
class Cancellation:
    """How the poles of oscillators, all that move, can cancel."""

    oscillators: tuple[Oscillator, ...]
    given: Hypotheses
    _known: dict[sp.Expr, bool] = field(default_factory=dict)

    def families(self) -> tuple[dict[sp.Symbol, sp.Expr], ...]:
        """Each set of motions other than equilibria: what coordinates are by others, or where they rest.

        Raises:
            ModelError: it is not shown that poles cannot cancel in other ways, or there are too many sets.
        """
        kinds = [self._of_kind("cubic"), self._of_kind("sine")]
        options = [list(itertools.islice(self._arranged(kind), _MOST_FAMILIES)) for kind in kinds]
        linear = self._linear()
        found = [
            one | other | linear
            for (one, does_move), (other, does_too) in itertools.product(*options)
            if does_move or does_too or len(linear) < len(self._of_kind("linear")) or self._of_kind("free")
        ]
        if len(found) >= _MOST_FAMILIES:
            raise ModelError(f"there are {_MOST_FAMILIES} sets of motions or more")
        return tuple(found)

    def _of_kind(self, kind: str) -> list[Oscillator]:
        return [x for x in self.oscillators if x.kind == kind]

    def _vanishes(self, expression: sp.Expr) -> bool:
        """Whether an expression of parameters is 0; either is supposed, and a ModelError where it is not known."""
        expression = sp.fraction(normal(expression))[0]
        if expression == 0:
            return True
        if expression not in self._known:
            if self.given.is_void(expression):
                self.given.suppose(f"{expression} = 0")
                self._known[expression] = True
            elif self.given.is_nonzero(expression):
                self._known[expression] = False
            else:
                raise ModelError(f"whether {expression} is 0 is not known")
            self._known[-expression] = self._known[expression]
        return self._known[expression]

    def _groups(self, members: Sequence[Oscillator]) -> list[Group]:
        """Signs with which poles cancel, of oscillators that have one stiffness."""
        if (count := len(members)) > _MOST_OSCILLATORS:
            raise ModelError(f"there are {count} oscillators that are not linear, at most {_MOST_OSCILLATORS} are")
        found, mixed = list[Group](), list[Group]()
        for signs in itertools.product((0, 1, -1), repeat=len(members)):
            used = [(s, x) for s, x in zip(signs, members, strict=True) if s]
            if len(used) < 2 or used[0][0] < 0:
                continue
            is_one_class = all(self._vanishes(x.stiffness - used[0][1].stiffness) for _, x in used)
            residue = sum((sign * x.residue for sign, x in used), sp.Integer(0))
            if (is_one_class or self._may_mix(members)) and self._vanishes(residue):
                (found if is_one_class else mixed).append(signs)
        for signs in mixed:
            if not _is_union(signs, found):
                names = ", ".join(str(x.place) for s, x in zip(signs, members, strict=True) if s)
                raise ModelError(f"the poles of {names} may cancel")
        return [g for g in found if not any(_is_part(h, g) for h in found if h != g)]

    def _may_mix(self, members: Sequence[Oscillator]) -> bool:
        """Whether poles of oscillators with different stiffness might cancel by their periods."""
        if members[0].kind == "sine":
            return len(members) > 2
        return any(sum(self._vanishes(x.stiffness - y.stiffness) for y in members) > 2 for x in members)

    def _arranged(self, members: Sequence[Oscillator]) -> Iterator[tuple[dict[sp.Symbol, sp.Expr], bool]]:
        """Coordinates of one kind in each set, and whether any of them moves."""
        groups = self._groups(members)
        supports = [frozenset(i for i, s in enumerate(g) if s) for g in groups]

        def chosen(free: frozenset[int], first: int) -> Iterator[tuple[int, ...]]:
            yield ()
            for k in range(first, len(groups)):
                if supports[k] <= free:
                    yield from ((k, *more) for more in chosen(free - supports[k], k + 1))

        everyone = frozenset(range(len(members)))
        for some in chosen(everyone, 0):
            left = sorted(everyone - frozenset().union(*(supports[k] for k in some)))
            where = (sp.Integer(0), sp.pi) if members and members[0].kind == "sine" else (sp.Integer(0),)
            for places in itertools.product(where, repeat=len(left)):
                resting = [{i for i, at in zip(left, places, strict=True) if at == x} for x in where]
                if any(support <= rest for support in supports for rest in resting):
                    continue  # a group at rest is in the set where that group moves
                values = {members[i].place: members[i].centre + at for i, at in zip(left, places, strict=True)}
                for k in some:
                    values |= _together(groups[k], members)
                yield values, bool(some)

    def _linear(self) -> dict[sp.Symbol, sp.Expr]:
        """Last linear oscillator of each frequency by the others: their weighted sum is 0."""
        left, found = self._of_kind("linear"), dict[sp.Symbol, sp.Expr]()
        while left:
            alike = [x for x in left if self._vanishes(x.stiffness - left[0].stiffness)]
            *others, last = alike
            total = sum((x.weight * (x.place - x.centre) for x in others), sp.Integer(0))
            found[last.place] = last.centre - normal(total / last.weight)
            left = [x for x in left if x not in alike]
        return found


def _is_part(part: Group, whole: Group) -> bool:
    """Whether the signs of a group are those of another where they are not 0, up to one sign for all."""
    pairs = [(p, w) for p, w in zip(part, whole, strict=True) if p]
    return all(p == w for p, w in pairs) or all(p == -w for p, w in pairs)


def _is_union(signs: Group, groups: Sequence[Group]) -> bool:
    """Whether signs are those of groups, one after the other, so that their poles cancel within groups alone."""
    parts = (group for group in groups if _is_part(group, signs))
    rests = (tuple(0 if g else s for g, s in zip(part, signs, strict=True)) for part in parts)
    return not any(signs) or any(_is_union(rest, groups) for rest in rests)


def _together(group: Group, members: Sequence[Oscillator]) -> dict[sp.Symbol, sp.Expr]:
    (sign, first), *rest = ((s, x) for s, x in zip(group, members, strict=True) if s)
    return {x.place: x.centre + sign * s * normal(first.size / x.size) * (first.place - first.centre) for s, x in rest}
