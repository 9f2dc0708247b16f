"""LaSalle's invariant set: the motions along which the energy stays as it is.

Where V' = -sum d_k l_k(v)^2 with d_k > 0, the energy stays while every l_k(v) is 0. What else holds of such a motion is
found by elimination: for a linear model the states that cannot be observed through l_k(v), exactly; else from what
stays of the equations when l_k(q) are constants, by the rules

* a bounded function whose second derivative is constant is constant;
* an analytic function of one coordinate that vanishes along a motion vanishes everywhere, or that coordinate is
  constant;
* where a product of analytic functions vanishes along a motion, one of them does.

Source: LaSalle (1960), Some extensions of Liapunov's second method; Rijlaarsdam (2008), appendix A.2 (the first rule).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import sympy as sp
from sympy.simplify.fu import TR9

from masking.analysis.stability.algebra import coefficients, normal, radical, solve_constants, without_void
from masking.analysis.stability.complex_time_poles import Cancellation, oscillators
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses
from masking.display.printed_result import Printed
from masking.errors import ModelError

_MOST_RULES = 3  # applications of the first rule, one after the other
_Further = tuple[tuple[sp.Expr, ...], str]


@dataclass(frozen=True, repr=False)
class Family(Printed):
    """A set of motions, by relations of coordinates and velocities: expressions that are 0 on it."""

    relations: tuple[sp.Expr, ...]

    def __str__(self) -> str:
        return ", ".join(f"{relation} = 0" for relation in self.relations)


@dataclass(frozen=True)
class InvariantSet:
    """The largest invariant set in V' = 0, found or not."""

    is_found: bool  # whether the elimination came to an end
    families: tuple[Family, ...] = ()  # sets of motions in it
    equilibria: bool = False  # whether all else in it are equilibria; False where there is nothing else
    # values of coordinates at those equilibria, as far as elimination determines them
    known: dict[sp.Symbol, sp.Expr] = field(default_factory=dict)
    is_of_bounded: bool = False  # whether that is so of bounded motions alone
    steps: tuple[str, ...] = ()  # the argument, sentence by sentence


def invariant_set(motion: Motion, forms: Sequence[sp.Expr]) -> InvariantSet:
    """Find the largest invariant set of bounded solutions on which linear forms of the velocities are 0."""
    names = ", ".join(f"{form} = 0" for form in forms)
    start = f"V' = 0 only where {names}."
    if any(sp.diff(form, v).free_symbols & {*motion.q, *motion.v} for form in forms for v in motion.v):
        end = "These are no linear forms with constant coefficients: not eliminated."
        return InvariantSet(False, steps=(start, end))
    if not motion.is_linear:
        return _Elimination(motion, tuple(forms)).run(start)
    relations = unobserved(motion, forms)
    family = Family(relations)
    if len(relations) == 2 * len(motion.q):
        end = "Along a motion of this linear model that stays there, everything is 0: it is the equilibrium."
    else:
        end = f"Motions of this linear model that stay there, which these forms do not observe, have {family}."
    return InvariantSet(True, (family,), steps=(start, end))


class _OpenError(ModelError):
    """The rules do not go on from here."""


@dataclass
class _Elimination:
    """The residual equations of a model while forms of its coordinates are constant."""

    motion: Motion
    forms: tuple[sp.Expr, ...]
    steps: list[str] = field(default_factory=list)
    families: list[Family] = field(default_factory=list)
    known: dict[sp.Symbol, sp.Expr] = field(default_factory=dict)
    is_of_bounded: bool = False

    @property
    def given(self) -> Hypotheses:
        return self.motion.given

    @cached_property
    def frozen(self) -> tuple[tuple[int, ...], sp.Matrix]:
        """Coordinates that the forms give, and the reduced forms."""
        matrix = sp.Matrix([[sp.diff(f, v) for v in self.motion.v] for f in self.forms])
        reduced, pivots = matrix.rref(simplify=normal)
        return tuple(pivots), reduced[: len(pivots), :]

    @cached_property
    def constants(self) -> tuple[sp.Symbol, ...]:
        """Constant values of the forms of the coordinates."""
        count = len(self.frozen[0])
        return tuple(self._new("c" if count == 1 else f"c{i + 1}") for i in range(count))

    @cached_property
    def turning(self) -> tuple[sp.Symbol, ...]:
        """Constants that count modulo one turn, as the angles do which they give."""
        pairs = zip(self.frozen[0], self.constants, strict=True)
        return tuple(c for i, c in pairs if self.motion.q[i] in self.motion.circles)

    @cached_property
    def bound(self) -> sp.Symbol:
        """Constant that a bounded function is."""
        return self._new("K")

    def _new(self, name: str) -> sp.Symbol:
        """Real constant with a name that nothing in the model has."""
        symbols = self.motion.model.equations.symbols
        taken = {str(s) for s in (*symbols.q, *symbols.v, *symbols.u, *symbols.p, *self.given.symbols.values())}
        while name in taken:
            name += "_"
        return sp.Symbol(name, real=True)

    @cached_property
    def moving(self) -> tuple[int, ...]:
        return tuple(j for j in range(len(self.motion.q)) if j not in self.frozen[0])

    def _tied(self, symbols: Sequence[sp.Symbol], values: Sequence[sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
        """Values of the frozen symbols by those of the forms."""
        pivots, reduced = self.frozen
        rest = [sum((reduced[k, j] * symbols[j] for j in self.moving), sp.Integer(0)) for k in range(len(pivots))]
        return {symbols[i]: values[k] - rest[k] for k, i in enumerate(pivots)}

    @cached_property
    def reduced(self) -> tuple[dict[sp.Symbol, sp.Expr], tuple[sp.Expr, ...]]:
        """Accelerations of what moves, by velocity symbol, and the equations left over; a ModelError for none."""
        q, v, n = self.motion.q, self.motion.v, len(self.motion.q)
        zeros = [sp.Integer(0)] * len(self.frozen[0])
        tied = self._tied(q, self.constants) | self._tied(v, zeros)
        a = tuple(sp.Dummy(f"a{i}", real=True) for i in range(n))
        tied_a = self._tied(a, zeros)
        column = sp.Matrix([tied_a.get(x, x) for x in a])
        residual = (self.motion.mass * column - self.motion.force).subs(tied)
        wanted = [a[j] for j in self.moving]
        own = sp.Matrix([residual[j] for j in self.moving])
        matrix = own.jacobian(wanted)
        right = -own.subs(dict.fromkeys(wanted, 0))
        if wanted and self.given.declared_sign(normal(matrix.det())) not in {1, -1}:
            raise _OpenError("the equations of what moves do not give its accelerations")
        solved = dict(zip(wanted, (normal(x) for x in matrix.LUsolve(right)), strict=True)) if wanted else {}
        left = tuple(normal(residual[i].subs(solved)) for i in self.frozen[0])
        rates = {v[j]: solved[a[j]] for j in self.moving}
        return rates, tuple(x for x in left if x != 0)

    def rate(self, expression: sp.Expr) -> sp.Expr:
        accelerations, _ = self.reduced
        found = sum(sp.diff(expression, self.motion.q[j]) * self.motion.v[j] for j in self.moving)
        return found + sum(sp.diff(expression, v) * a for v, a in accelerations.items())

    def run(self, start: str) -> InvariantSet:
        q = self.motion.q
        values = ", ".join(f"{q[i]} = {x}" for i, x in zip(self.frozen[0], self._frozen_values(), strict=True))
        self.steps += [start, f"A motion that stays there has {values}, constant."]
        try:
            further = self._eliminate()
        except ModelError as error:
            self.steps.append(f"Here the elimination ends: {error}.")
            return InvariantSet(False, steps=tuple(self.steps))
        if further is not None:
            forms, words = further
            return replace(self, forms=forms).run(words)
        families, steps = tuple(dict.fromkeys(self.families)), tuple(self.steps)
        return InvariantSet(True, families, True, self.known, self.is_of_bounded, steps)

    def _eliminate(self) -> _Further | None:
        """Find the families, or further forms that are 0, and why."""
        moving = [self.motion.q[j] for j in self.moving]
        if not moving:
            self.steps.append("Nothing moves: it is an equilibrium.")
            return None
        left = [normal(x.subs(self._known_constants())) for x in self.reduced[1]]
        if len(moving) == 1:
            self._vanishing(left, moving[0], list(self.constants), {})
            return None
        if not left:
            raise _OpenError("no equation is left over that ties what moves")
        names = ", ".join(str(self.motion.q[i]) for i in self.frozen[0])
        self.steps.append(f"The remaining equation of {names} is 0 = {' and 0 = '.join(map(str, left))}.")
        for equation in left:
            if (r := self._resting(equation)) is not None:
                v = self.motion.v[self.motion.q.index(r)]
                return (*self.forms, v), f"There {r} alone is left, which is constant: {v} = 0."
        relation, constants = self._integrated(left[0], moving)
        if len(moving) > 2:
            return self._many(relation, left)
        steps, families = len(self.steps), len(self.families)
        try:
            self._pair(relation, left, constants)
        except _OpenError as error:
            del self.steps[steps:], self.families[families:]
            try:
                return self._many(relation, left)
            except ModelError:
                raise error from None
        return None

    def _resting(self, equation: sp.Expr) -> sp.Symbol | None:
        """One coordinate that an equation holds, where it does not hold for every value of it."""
        held = equation.free_symbols & {self.motion.q[j] for j in self.moving}
        if len(held) != 1 or equation.free_symbols & {*self.motion.v}:
            return None
        (r,) = held
        try:
            parts = coefficients(equation, (r,))
        except ModelError:
            return None
        fixed = [c for f, c in parts.items() if f != 1 and not c.free_symbols & {*self.constants}]
        return r if any(self.given.is_nonzero(c) for c in fixed) else None

    def _integrated(self, relation: sp.Expr, moving: Sequence[sp.Symbol]) -> tuple[sp.Expr, list[sp.Symbol]]:
        """Relation after the first rule, applied as often as it can be, and the constants that are not known."""
        constants = list(self.constants)
        for _ in range(_MOST_RULES):
            if _is_affine(relation, moving) or not (found := self._constant_derivative(relation, moving, constants)):
                break
            relation, constants = found
        return normal(relation.subs(self._known_constants())), constants

    def _many(self, relation: sp.Expr, left: Sequence[sp.Expr]) -> _Further | None:
        """Apply the rule of poles where each of the others moves by itself; else eliminate by what is linear."""
        moving = [self.motion.q[j] for j in self.moving]
        known = self._known_constants()
        rates = [normal(self.reduced[0][self.motion.v[j]].subs(known)) for j in self.moving]
        if len(left) > 1:
            raise _OpenError(f"{len(left)} equations are left over that tie {len(moving)} coordinates")
        try:
            found = oscillators(relation, dict(zip(moving, rates, strict=True)), self.motion.circles, self.given)
        except ModelError:
            rate = self.rate(relation)
            if _is_affine(relation, moving) and len(moving) > 2 and not rate.free_symbols & {*moving}:
                return (*self.forms, rate), f"Hence {rate} = 0, too."
            raise
        values, self.is_of_bounded = Cancellation(found, self.given).families(), True
        names = ", ".join(str(x.place) for x in found if x.kind != "free")
        self.steps.append(
            f"Each of {names} moves by itself, and {relation} = 0 for all time: in complex time their poles cancel, "
            "which they do only in groups that move together but for scale and sign; without a group the same holds "
            "of the others, and what has no poles to cancel is at rest."
        )
        if not values:
            self.steps.append("There is no such group: only equilibria are left.")
        for tied in values:
            self._add_family(known, tied)
        return None

    def _frozen_values(self) -> list[sp.Expr]:
        tied = self._tied(self.motion.q, self.constants)
        return [tied[self.motion.q[i]] for i in self.frozen[0]]

    def _pair(self, relation: sp.Expr, left: Sequence[sp.Expr], constants: list[sp.Symbol]) -> None:
        r1, r2 = (self.motion.q[j] for j in self.moving)
        left = [normal(x.subs(self._known_constants())) for x in left]
        if _is_affine(relation, (r1, r2)) and not self.given.is_nonzero(sp.diff(relation, r2)):
            raise _OpenError(f"{relation} = 0 does not give {r2}")
        for tied in _linear_relations(relation, r1, r2, self.bound, self.motion):
            self._along(tied, r1, r2, left, constants)

    def _single_constants(self) -> Iterator[tuple[sp.Symbol, sp.Symbol]]:
        """Each frozen coordinate that is one constant by itself, with it."""
        for i, value in zip(self.frozen[0], self._frozen_values(), strict=True):
            if value.is_Symbol:
                yield self.motion.q[i], value

    def _known_constants(self) -> dict[sp.Symbol, sp.Expr]:
        return {c: self.known[q] for q, c in self._single_constants() if q in self.known}

    def _constant_derivative(
        self, relation: sp.Expr, pair: Sequence[sp.Symbol], constants: list[sp.Symbol]
    ) -> tuple[sp.Expr, list[sp.Symbol]] | None:
        """Apply the first rule: relation = D^2(sum a_j phi_j) + b with constant b; None where it is no such sum."""
        functions = [*pair, *(sp.sin(r) for r in pair), *(sp.cos(r) for r in pair)]
        weights = [sp.Dummy(f"a{i}", real=True) for i in range(len(functions))]
        rates = [self.rate(self.rate(f)) for f in functions]
        ansatz = relation - sum(w * rate for w, rate in zip(weights, rates, strict=True))
        variables = (*pair, *(self.motion.v[j] for j in self.moving))
        parts = coefficients(ansatz, variables)
        constant = parts.pop(sp.Integer(1), sp.Integer(0))
        found = sp.solve(list(parts.values()), weights, dict=True) if parts else []
        if not found:
            return None
        solution = {w: found[0].get(w, sp.Integer(0)).subs(dict.fromkeys(weights, 0)) for w in weights}
        if not all(self.given.is_nonzero(sp.fraction(sp.together(x))[1]) for x in solution.values()):
            return None
        constant = normal(constant.subs(solution))
        total = normal(sum(solution[w] * f for w, f in zip(weights, functions, strict=True)))
        if total == 0:
            return None
        factor, total = total.as_independent(*pair, as_Add=False)
        if not self.given.is_nonzero(factor):
            raise _OpenError(f"{relation} = 0 may hold because {factor} = 0")
        constant = normal(constant / factor)
        solutions = solve_constants([constant], constants, self.given)
        if not solutions:
            raise _OpenError(f"{constant} = 0 cannot be")
        (solved,) = solutions
        plain = total.replace(lambda x: x.func in {sp.sin, sp.cos}, lambda _: sp.Integer(1))
        unbounded = bool(plain.free_symbols & {*pair} & {*self.motion.circles})
        if constant == 0 and unbounded:
            return None
        self.is_of_bounded = True
        words = ", ".join(f"{c} = {x}" for c, x in solved.values.items()) or "nothing new"
        what = f"the second derivative of {total} is {normal(-constant)}, constant, and its first derivative is bounded"
        self.steps.append(f"Hence {what}: the constant is 0, so {words}.")
        for q, c in self._single_constants():
            if c in solved.values:
                self.known[q] = solved.values[c]
        rest = [c for c in constants if c not in solved.values]
        if unbounded:
            return (normal(relation.subs(solved.values)), rest) if solved.values else None
        self.steps.append(f"{total} is bounded, so that it is a constant, {self.bound}.")
        return total - self.bound, [*rest, self.bound]

    def _along(
        self, tied: sp.Expr, r1: sp.Symbol, r2: sp.Symbol, left: Sequence[sp.Expr], constants: list[sp.Symbol]
    ) -> None:
        """Apply the second rule where r2 = tied, a linear function of r1."""
        velocity = {v: self.motion.v[j] for j, v in zip(self.moving, (r1, r2), strict=True)}
        slope = sp.diff(tied, r1)
        on_it = {r2: tied, velocity[r2]: slope * velocity[r1]}
        accelerations = self.reduced[0]
        second = accelerations[velocity[r2]] - slope * accelerations[velocity[r1]]
        known = self._known_constants()
        equations = [normal(x.subs(on_it).subs(known)) for x in (second, *left)]
        every = dict.fromkeys([*tied.free_symbols & {self.bound}, *constants, *self.constants])
        unknown = [c for c in every if c not in known]
        self.steps.append(f"Where {r2} = {tied}, its second derivative gives 0 = {equations[0]}.")
        self._vanishing(equations, r1, unknown, {r2: tied})

    def _vanishing(
        self, equations: Sequence[sp.Expr], r: sp.Symbol, unknown: Sequence[sp.Symbol], tied: dict[sp.Symbol, sp.Expr]
    ) -> None:
        """Apply the second rule: each expression of r vanishes for all r, or r is constant."""
        equations, unknown = self._without_velocity(equations, r, unknown)
        conditions = [c for equation in equations for c in coefficients(equation, (r,), self.given).values()]
        if conditions:
            shown = {radical(c, self.given): c for c in reversed(conditions)}
            words = ", ".join(f"{c} = 0" for c in sorted(shown, key=sp.count_ops))
            if (one := sp.Integer(1)) in shown:
                words = f"{shown[one]} = 0"
            self.steps.append(f"Either {r} is constant, which is an equilibrium, or this holds for every {r}: {words}.")
        solutions = solve_constants(conditions, unknown, self.given, self.turning)
        if not solutions:
            self.steps.append("That cannot be: only equilibria are left.")
        for solved in solutions:
            if solved.left:
                raise _OpenError(f"{' and '.join(f'{x} = 0' for x in solved.left)} could not be solved")
            if conditions:
                words = ", ".join(f"{c} = {x}" for c, x in solved.values.items())
                self.steps.append(f"It holds for {words}." if words else "It holds.")
            self._add_family(solved.values | self._known_constants(), tied)

    def _without_velocity(
        self, equations: Sequence[sp.Expr], r: sp.Symbol, unknown: Sequence[sp.Symbol]
    ) -> tuple[list[sp.Expr], list[sp.Symbol]]:
        """Put in the square of the velocity of r where r'' is a function of r: r'^2/2 less its integral is constant."""
        v = self.motion.v[self.motion.q.index(r)]
        if not any(equation.free_symbols & {*self.motion.v} for equation in equations):
            return [*equations], [*unknown]
        acceleration = self.reduced[0].get(v, v).subs(self._known_constants())
        energy = self._new("E")
        square = 2 * (energy + sp.integrate(sp.expand(acceleration), r))
        found = []
        for equation in equations:
            is_even = equation.is_polynomial(v) and all(n % 2 == 0 for (n,) in sp.Poly(equation, v).monoms())
            if not is_even or acceleration.free_symbols & {*self.motion.v} or square.has(sp.Integral):
                raise _OpenError(f"{equation} = 0 holds velocities, too")
            parts = sp.Poly(equation, v).terms()
            found.append(normal(sum((c * square ** (n // 2) for (n,), c in parts), sp.Integer(0))))
        self.steps.append(f"There {v}**2 = {square} with a constant {energy}.")
        return found, [*unknown, energy]

    def _add_family(self, values: dict[sp.Symbol, sp.Expr], tied: dict[sp.Symbol, sp.Expr]) -> None:
        q, v = self.motion.q, self.motion.v
        zeros = [sp.Integer(0)] * len(self.constants)
        relations = []
        for i, position in enumerate(q):
            fixed = self._tied(q, self.constants) | tied
            if position in fixed:
                value = normal(fixed[position].subs(tied).subs(values))
                rate = sum((sp.diff(value, q[j]) * v[j] for j in self.moving), sp.Integer(0))
                relations += [position - value, v[i] - self._tied(v, zeros).get(v[i], rate)]
        ordered = sorted(relations, key=lambda x: (bool(x.free_symbols & {*v}), str(x)))
        self.families.append(Family(tuple(ordered)))


def _is_affine(expression: sp.Expr, variables: Sequence[sp.Symbol]) -> bool:
    return bool(expression.is_polynomial(*variables) and sp.Poly(expression, *variables).total_degree() == 1)


def _linear_relations(relation: sp.Expr, r1: sp.Symbol, r2: sp.Symbol, k: sp.Symbol, motion: Motion) -> list[sp.Expr]:
    """Values of r2 as linear functions of r1.

    An affine relation gives r2 = K + sigma r1 with a new constant K; a product of sines, by the third rule, one
    relation for each factor, angles modulo one turn.
    """
    if _is_affine(relation, (r1, r2)):
        by = sp.diff(relation, r2)
        if relation.has(k):
            return [sp.expand(-relation.subs(r2, 0) / by)]
        return [k - normal(sp.diff(relation, r1) / by) * r1]
    found: list[sp.Expr] = []
    for factor in sp.Mul.make_args(sp.factor_terms(TR9(relation))):
        if not factor.free_symbols & {r1, r2}:
            if not motion.given.is_nonzero(factor):
                raise _OpenError(f"{relation} = 0 may hold because {factor} = 0")
            continue
        inner = factor.args[0] if factor.func in {sp.sin, sp.cos} else None
        if inner is None or not _is_affine(inner, (r1, r2)) or {r1, r2} - {*motion.circles}:
            raise _OpenError(f"{relation} = 0 gives no linear relation of {r1} and {r2}")
        by = sp.diff(inner, r2)
        step = sp.Abs(sp.pi / by)
        turns = 2 * sp.pi / step
        if not turns.is_Integer:
            raise _OpenError(f"{relation} = 0 gives no finite number of relations modulo one turn")
        offset = sp.Integer(0) if factor.func == sp.sin else sp.pi / 2
        found += [sp.expand((offset - inner.subs(r2, 0)) / by) + m * step for m in range(int(turns))]
    return found


def unobserved(motion: Motion, forms: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
    """Relations, linear in the states, of the unobservable subspace of a linear model, outputs being the forms.

    The states x with O x = 0 for O = [C; C A; C A^2; ...], by elimination of rows that are linearly dependent.
    """
    n = len(motion.q)
    state = (*motion.q, *motion.v)
    inverse = motion.mass.inv()
    lower = (inverse * motion.force.jacobian(state)).applyfunc(normal)
    a = sp.Matrix.vstack(sp.Matrix.hstack(sp.zeros(n), sp.eye(n)), lower)
    rows, fresh = list[sp.Matrix](), [sp.Matrix([[sp.diff(form, x) for x in state]]) for form in forms]
    pivots, determinant = list[int](), sp.Integer(1)
    while fresh:
        row = fresh.pop(0)
        reduced = row
        for pivot, other in zip(pivots, rows, strict=True):
            reduced = (reduced - reduced[pivot] * other).applyfunc(normal)
        reduced = reduced.applyfunc(lambda x: without_void(x, motion.given))
        entry = _pivot(reduced, motion.given)
        if entry is None:
            continue
        determinant *= reduced[entry]
        reduced = (reduced / reduced[entry]).applyfunc(normal)
        rows = [(r - r[entry] * reduced).applyfunc(normal) for r in rows]
        rows.append(reduced)
        pivots.append(entry)
        fresh.append((row * a).applyfunc(normal))
    # Earlier pivots are eliminated from later rows: the product is a minor of O; the result holds where it is not 0.
    motion.given.is_nonzero(without_void(normal(determinant), motion.given))
    ordered = sorted(zip(pivots, rows, strict=True), key=lambda x: x[0])
    plain = [row.applyfunc(lambda x: without_void(x, motion.given)) for _, row in ordered]
    return tuple(sum((row[j] * x for j, x in enumerate(state)), sp.Integer(0)) for row in plain)


def _pivot(row: sp.Matrix, given: Hypotheses) -> int | None:
    """Last entry of a row that is not 0, one with a sign first; None where all are 0."""
    order = [j for j in reversed(range(row.cols)) if row[j] != 0]
    return next((j for j in order if given.sign(row[j]) in {1, -1}), order[0] if order else None)
