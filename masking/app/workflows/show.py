"""Descriptions for people: what a declaration or a physical effect is, typeset for a terminal or as JSON."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import sympy as sp

from masking.control.law import Controller
from masking.display.printed_result import Printed, aligned
from masking.lab.runs import batch_plan, experiment_card
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue, registry, schema
from masking.model.declaration.expression import Expression
from masking.model.effects import EFFECTS, Effect, EffectParameter, own
from masking.model.modelling.equations import Equations
from masking.model.modelling.model import Model, load_model

# Operations in the longest expression that is simplified; simplifying takes a second for some hundreds.
LONGEST_SIMPLIFIED = 120
_ARTICLES = {"element": "an element", "sensor": "a sensor", "actuator": "an actuator", "loop": "the loop"}


@dataclass(frozen=True, repr=False)
class Description(Printed):
    """A text for the terminal and the Python prompt, and the same content for programs."""

    text: str
    content: dict[str, Any]

    def __str__(self) -> str:
        return self.text

    def as_dict(self) -> dict[str, Any]:
        """The same as JSON can hold it."""
        return self.content

    __repr__ = __str__  # whoever asks to see a declaration wants all of it


def show(name_or_path: str | Path, kind: catalogue.Kind | None = None) -> Description:
    """Describe a model, a plant or an experiment: equations, parameters, blocks; or physical effects.

    Args:
        name_or_path: a packaged name, a file, or the name of an effect that comes with the package.
        kind: of the declaration, where a name stands for several; by default the first that has it.

    Raises:
        DeclarationError: there is no such declaration, or it is wrong.
    """
    if kind is None and name_or_path in EFFECTS:
        return effect(EFFECTS[str(name_or_path)])
    known = kind or catalogue.kind_of(name_or_path)
    if known == "model":
        return model(load_model(name_or_path))
    if known == "plant":
        return plant(registry.load_plant(name_or_path))
    if known == "dictionary":
        return dictionary(registry.load_dictionary(name_or_path))
    if known == "batch":
        return batch_of(name_or_path)
    return experiment(Experiment.load(name_or_path))


def model(subject: Model) -> Description:
    """Describe a model: coordinates, inputs, equations, parameters, scales."""
    d, e = subject.declaration, subject.equations
    lines = _head(d)
    lines += _table("coordinates", [(n, c.unit, c.meaning) for n, c in d.coordinates.items()])
    lines += _table("internal states", [(n, z.unit, z.meaning) for n, z in d.states.items()])
    lines += _table("inputs", [(n, i.unit, i.meaning) for n, i in d.inputs.items()])
    lines += _table("outputs", [(n, o.unit, o.meaning or o.expression.text) for n, o in d.outputs.items()])
    equations = dict(zip([s.name for s in e.symbols.a], map(e.written, e.accelerations), strict=True))
    sides = zip(e.mass * sp.Matrix(e.symbols.a), map(e.written, e.force), strict=True)
    rates = {f"{n}'": e.written(rate) for n, rate in zip(d.states, e.rates, strict=True)}
    typeset = [line for left, right in (*sides, *rates.items()) for line in _equation(left, right)]
    lines += ["equations", *typeset, ""] if typeset else []
    events = [(n, f"{one.when.text} crosses 0", one.written, one.meaning) for n, one in d.events.items()]
    lines += _table("events", events)
    if e.energy is not None:
        lines += ["energy", *_equation("E", e.energy), ""]
    values = subject.parameter_values()
    scaled = subject.dimensionless().parameter_values() if d.scales and not subject.units.is_plain else {}
    rows = []
    for name, p in d.parameters.items():
        factor = subject.units.conversions[p.unit].factor
        in_scales = f"{scaled[name]:.6g}" if name in scaled else ""
        rows.append((name, f"{values[name] / factor:.6g}", "" if p.unit == "1" else p.unit, in_scales, p.meaning))
    lines += _table("parameters" + (" (value, unit, in the scales)" if scaled else ""), rows)
    scales, sizes = subject.units.scale_values(subject.overrides), subject.units.conversions
    lines += _table("scales", [(n, f"{scales[n]:.6g}", sizes[s.unit].si) for n, s in d.scales.items()])
    content = {
        **d.canonical(),
        "accelerations": {name: {"text": str(x), "latex": sp.latex(x)} for name, x in equations.items()},
        "rates": {name: {"text": str(x), "latex": sp.latex(x)} for name, x in rates.items()},
        "values": values,
        "dimensionless": scaled,
    }
    return Description("\n".join(lines).rstrip(), content)


def effect(subject: Effect) -> Description:
    """Describe a physical effect: what it is, its expression and parameters, where it comes from and what helps."""
    lines = [subject.spoken, subject.meaning]
    lines += [f"source: {subject.source}", ""] if subject.source else [""]
    lines += [f"in {_ARTICLES[subject.where]}: {subject.expression or 'what is commanded acts later'}"]
    lines += [*(f"with {name}' = {state.rate}" for name, state in subject.states.items()), ""]
    rows = []
    for name, p in subject.parameters.items():
        taken = "" if p.value is None else f"{p.value:g} where none is given"
        tried = ", ".join(f"{part:g}" for part in p.tried)
        role = "a factor" if name in subject.factors else f"tried: {tried}" if tried else ""  # of an own effect
        rows.append((name, p.unit, _range(p), taken or role, p.meaning))
    lines += _table("parameters (unit of the place, usual range)", rows)
    lines += [f"usual causes: {subject.cause}"] if subject.cause else []
    lines += [f"what helps: {subject.remedy}"] if subject.remedy else []
    content = asdict(replace(subject, trials=()))
    return Description("\n".join(lines).rstrip(), {k: v for k, v in content.items() if not k.startswith("trials")})


def dictionary(declaration: schema.DictionaryDeclaration) -> Description:
    """Describe a dictionary of own effects: each of them as `effect` does."""
    texts = [effect(one).text for one in own(declaration).values()]
    return Description("\n\n".join(["\n".join(_head(declaration)).rstrip(), *texts]), declaration.canonical())


def batch_of(name_or_path: str | Path) -> Description:
    """Describe a batch: its runs, with the values of the experiment that each has."""
    declaration, _, runs = batch_plan.load(name_or_path)
    lines = [*_head(declaration), f"{len(runs)} runs of {declaration.experiment}", ""]
    lines += _table("runs", [(str(run.number), *(f"{n} = {x:g}" for n, x in run.settings.items())) for run in runs])
    return Description("\n".join(lines).rstrip(), declaration.canonical())


def _range(parameter: EffectParameter) -> str:
    """Usual range of a parameter; of an own effect, its bounds."""
    low, high = parameter.prior or parameter.bounds
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    return f"from {low:g}" if low is not None else f"to {high:g}" if high is not None else ""


def plant(declaration: schema.PlantDeclaration) -> Description:
    """Describe a plant: its model, sensors, limits and effects."""
    d = declaration
    lines = _head(d)
    lines += [f"kind: {d.kind}", f"model: {d.model}", ""]
    gains = {n: f"x {s.gain.value:g} {s.gain.unit}" * ("gain" in s.model_fields_set) for n, s in d.sensors.items()}
    lines += _table("sensors", [(n, s.measures.text, gains[n], s.unit, s.meaning) for n, s in d.sensors.items()])
    limits = [(n, f"{x.max:g}", x.unit) for n, x in d.limits.inputs.items()]
    limits += [(f"rate of {n}", f"{x.rate:g}", f"{x.unit}/s") for n, x in d.limits.inputs.items() if x.rate is not None]
    limits += [(x.text, f"{y.max:g}", y.unit) for x, y in d.limits.coordinates.items()]
    limits += [(f"rate of {x.text}", f"{y.max:g}", y.unit) for x, y in d.limits.velocities.items()]
    if d.limits.power is not None:
        limits.append(("power", f"{d.limits.power.value:g}", d.limits.power.unit))
    lines += _table("limits", limits)
    lines += _table("effects", [_effect_use(name, one) for name, one in d.effects.items()])
    return Description("\n".join(lines).rstrip(), d.canonical())


def _effect_use(name: str, use: schema.EffectUse) -> tuple[str, ...]:
    values = ", ".join(f"{p} = {x.text if isinstance(x, Expression) else f'{x:g}'}" for p, x in use.parameters.items())
    return name, use.effect.replace("_", " "), ", ".join(use.at), values, "" if use.enabled else "off"


def experiment(subject: Experiment) -> Description:
    """Describe an experiment: what moves as what, and the blocks T, D, L and G of its control law."""
    d, controller = subject.declaration, subject.acting_law
    rig, virtual, transform = controller.model, controller.virtual, controller.transform
    e, written = rig.affine.equations, virtual.equations.written
    lines = [*_head(d), experiment_card.in_words(subject.assembly)]
    lines += [f"{subject.time_scale:.6g} s per unit of virtual time", ""]
    known = virtual.equations.definitions  # inputs that are no expressions are polynomials, piece by piece
    series = {known[name]: sp.Symbol(f"{name}(t)") for name, source in d.inputs.items() if source.expression is None}
    wanted = [written(a).subs(series) for a in virtual.equations.accelerations]
    curves = {f"g({one.input})": one.text for one in controller.curves.each}
    blocks = {
        "T: virtual coordinates": dict(zip(virtual.coordinates, transform.expressions, strict=True)),
        "D: wanted accelerations": dict(zip([f"{c}''" for c in virtual.coordinates], wanted, strict=True)),
        **(_direct(e) if controller.is_direct else _higher(controller)),
        **({"g: what an input stands for in L and G": curves} if curves else {}),
    }
    happening = [(n, f"{one.when.text} crosses 0", one.written) for n, one in virtual.declaration.events.items()]
    zero = subject.passive.zero_dynamics if subject.passive else None
    lines += [str(zero), ""] if zero else []
    lines += [controller.approach, ""] if controller.approach else []
    lines += _table("events of the virtual system", happening)
    for title, equations in blocks.items():
        lines += [title, *(line for name, value in equations.items() for line in _equation(name, value)), ""]
    content = {
        **d.canonical(),
        "time_scale": subject.time_scale,
        **({"passive": zero.as_dict()} if zero else {}),
        "blocks": {title[0]: {n: str(x) for n, x in equations.items()} for title, equations in blocks.items()},
    }
    return Description("\n".join(lines).rstrip(), content)


Block = Mapping[str, Mapping[str, sp.Expr]]  # an equation by what it gives, for each title


def _direct(e: Equations) -> Block:
    """Blocks L and G of a rig whose inputs change accelerations at once."""
    still, gain = dict.fromkeys(e.symbols.u, 0), sp.Matrix(e.accelerations).jacobian(e.symbols.u)
    free = {f"{c}''": a.subs(still) for c, a in zip(e.coordinates, e.accelerations, strict=True)}
    entries = itertools.product(enumerate(e.coordinates), enumerate(e.symbols.u))
    by = {f"d{c}''/d{u}": gain[i, j] for (i, c), (j, u) in entries if gain[i, j] != 0}
    return {"L: cancelled accelerations": free, "G: inverse of the accelerations per input": by}


def _higher(controller: Controller) -> Block:
    """Blocks L and G of another rig: derivatives of the virtual coordinates in which inputs appear first."""
    e, free, by = controller.model.affine.equations, dict[str, sp.Expr](), dict[str, sp.Expr]()
    s = e.symbols
    states, rates = (s.t, *s.q, *s.v, *s.s), (sp.Integer(1), *s.v, *e.accelerations, *e.rates)
    mapped = zip(controller.virtual.coordinates, controller.transform.expressions, controller.degrees, strict=True)
    for name, eta, degree in mapped:
        value = eta
        for _ in range(degree):
            value = sp.Add(*(sp.diff(value, x) * rate for x, rate in zip(states, rates, strict=True)))
        label = name + "'" * degree
        free[label] = value.subs(dict.fromkeys(s.u, 0))
        by |= {f"d{label}/d{u}": slope for u in s.u if (slope := sp.diff(value, u)) != 0}
    return {"L: cancelled derivatives": free, "G: inverse of the derivatives per input": by}


def _head(declaration: schema.Declaration) -> list[str]:
    lines = [declaration.name]
    lines += [declaration.description] if declaration.description else []
    lines += [f"source: {declaration.source}"] if declaration.source else []
    return [*lines, ""]


def _table(title: str, rows: Sequence[Sequence[str]]) -> list[str]:
    return [title, *aligned(rows), ""] if rows else []


def _equation(left: str | sp.Expr, right: sp.Expr) -> list[str]:
    equation = sp.Eq(sp.Symbol(left) if isinstance(left, str) else _simple(left), _simple(right), evaluate=False)
    return ["  " + line for line in sp.pretty(equation, use_unicode=True, wrap_line=False).splitlines()]


def _simple(expression: sp.Expr) -> sp.Expr:
    """Expression simplified, where that does not take long."""
    if not isinstance(expression, sp.Expr) or sp.count_ops(expression) > LONGEST_SIMPLIFIED:
        return expression
    simple = sp.simplify(expression)
    return simple if sp.count_ops(simple) < sp.count_ops(expression) else expression
