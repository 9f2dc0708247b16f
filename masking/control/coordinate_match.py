"""Coordinates of the controller's model among those of a plant, which may have more: by name, or by a sensor's name.

A controller's model is often the poorer one: a link without its second mode, a gear without its play. Each of its
coordinates is the plant's of the same name, or what the sensor of that name measures; the others are the plant's own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile.codegen.compiled_functions import Kernels
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph
from masking.compile.numerics.arrays import Array
from masking.control.law import Controller
from masking.control.transform import Transform
from masking.errors import DeclarationError, ModelError, Problem
from masking.lazy_imports import sampled_loop
from masking.model.declaration import dimensions, schema, units
from masking.model.declaration.expression import Expression
from masking.model.declaration.instrument_declaration import Sensor
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class CoordinateMatch:
    """Where the coordinates of the controller's model are in the plant; a ModelError where one is not there."""

    controller: Controller  # the control law, in the coordinates of the controller's model
    plant: Model  # the model of the plant, in SI units
    sensors: Mapping[str, Sensor]  # of the plant

    def __post_init__(self) -> None:
        ours, theirs = self.controller.model.inputs, self.plant.inputs
        if ours != theirs:
            raise ModelError(
                f"the controller's model {self.controller.model.name} has the inputs {', '.join(ours)}, the plant "
                f"{self.plant.name} has {', '.join(theirs)}; both must have the same, in the same order"
            )
        _ = self._texts

    @property
    def is_same(self) -> bool:
        """Whether both have the same coordinates, in the same order."""
        return self.controller.model.coordinates == self.plant.coordinates

    @cached_property
    def _texts(self) -> dict[str, str]:
        """Each coordinate of the controller's model by those of the plant, SI units."""
        values, found = self.plant.parameter_values(), {}
        for name in self.controller.model.coordinates:
            measured = self.sensors[name].measures if name in self.sensors else None
            if name in self.plant.coordinates:
                found[name] = name
            elif measured is not None and measured.symbols <= {*self.plant.coordinates, *values}:
                known = {symbol: f"({values[symbol]!r})" for symbol in measured.symbols if symbol in values}
                found[name] = measured.renamed(known)
            else:
                sensors = ", ".join(self.sensors) or "none"
                raise ModelError(
                    f"the controller's model {self.controller.model.name} has the coordinate {name}: the plant "
                    f"{self.plant.name} has no coordinate of that name ({', '.join(self.plant.coordinates)}), and no "
                    f"sensor of that name that reads a position (sensors: {sensors}); give the coordinate, or the "
                    "sensor that reads it, the name of the other"
                )
        return found

    def check_units(self) -> None:
        """Refuse a coordinate whose unit in the controller's model does not fit what it is in the plant."""
        ours, theirs = (dimensions.symbol_dimensions(m.declaration) for m in (self.controller.model, self.plant))
        if self.is_same or ours is None or theirs is None:
            return
        for name, text in self._texts.items():
            wanted, found = ours[name], dimensions.dimension_in(Expression(text), theirs)
            if wanted is not None and found is not None and wanted != found:
                raise ModelError(
                    f"the coordinate {name} is in {units.describe(wanted)} in the controller's model "
                    f"{self.controller.model.name}, and in {units.describe(found)} in the plant {self.plant.name}; "
                    "give both the same dimension"
                )

    @property
    def own(self) -> tuple[str, ...]:
        """Coordinates of the plant that the controller's model does not have."""
        return tuple(self.plant.coordinates[i] for i in self.view.passive)

    @cached_property
    def view(self) -> Transform:
        """Coordinates of the controller's model by those of the plant, SI units."""
        if self.is_same:
            return Transform(self.plant, self.controller.model, schema.Transform())
        expressions = {name: Expression(text) for name, text in self._texts.items()}
        return Transform(self.plant, self.controller.model, schema.Transform(expressions=expressions))

    @cached_property
    def mapping(self) -> Transform:
        """Virtual coordinates by those of the plant, each measured in `lengths`."""
        transform, declared = self.controller.transform, self.controller.transform.declaration
        if self.is_same:
            return transform
        sizes = zip(self._texts.items(), self.controller.lengths.tolist(), strict=True)
        known = {name: f"(({text})/{size!r})" for (name, text), size in sizes}
        names, virtual = transform.rig.coordinates, transform.virtual.coordinates
        if declared.expressions is not None:
            texts = {name: entry.renamed(known) for name, entry in declared.expressions.items()}
        elif declared.matrix is not None:
            rows = ([f"({x})*{known[n]}" for x, n in zip(row, names, strict=True)] for row in declared.matrix)
            texts = dict(zip(virtual, map(" + ".join, rows), strict=True))
        else:
            texts = dict(zip(virtual, (known[str(x)] for x in transform.expressions), strict=True))
        expressions = {name: Expression(text) for name, text in texts.items()}
        composed = schema.Transform(expressions=expressions, parameters=declared.parameters)
        return Transform(self.plant, transform.virtual, composed)

    @cached_property
    def lengths(self) -> Array:
        """Size in SI units of one unit of each coordinate of the plant as `mapping` sees it (n,)."""
        return self.controller.lengths if self.is_same else np.ones(len(self.plant.coordinates))

    def structure(self) -> dict[str, object]:
        """All that a compiled loop depends on beyond the controller and the plant."""
        return {} if self.is_same else {"view": self.view.declaration.model_dump(mode="json")}

    def add_to(self, module: Module) -> None:
        """Add `view(t, q, v, p, out)` to a module of a loop, and `views` of all rows; see `seen`."""
        graph, (q, v) = Graph(), (self.plant.coordinates, [f"{c}'" for c in self.plant.coordinates])
        places, rates = ([graph.symbol(name, varying=True) for name in names] for names in (q, v))
        found = self.view.lower(graph, places, rates, [])
        loads = {name: f"{array}[{i}]" for array, names in (("q", q), ("v", v)) for i, name in enumerate(names)}
        results = [(f"out[{i}]", x) for i, x in enumerate([*found.eta, *found.rate, *found.bias])]
        module.add("view(t: float, q, v, p, out)", graph, results, loads)
        module.add_factory("views", sampled_loop.transforms, "view", len(q))

    def seen(self, kernels: Kernels, states: Array, accelerations: Array | None = None) -> Array:
        """Motion of the controller's coordinates (m, 2 k), or (m, 3 k) with accelerations, from the plant's.

        Args:
            kernels: those of a loop.
            states: of the plant: coordinates, velocities and whatever follows (m, .), SI units.
            accelerations: of the plant (m, n), SI units.
        """
        n, k = len(self.plant.coordinates), len(self.controller.model.coordinates)
        if self.is_same:
            return states if accelerations is None else np.hstack([states[:, : 2 * n], accelerations])

        def view(moving: Array) -> Array:
            out = np.empty((len(moving), 3 * k))
            kernels.views(np.zeros(len(moving)), np.ascontiguousarray(moving), np.empty(0), out)
            return out

        found = view(states)
        if accelerations is None:
            return np.ascontiguousarray(found[:, : 2 * k])
        found[:, 2 * k :] += view(np.hstack([states[:, :n], accelerations]))[:, k : 2 * k]
        return found


def in_coordinates_of(
    model: schema.ModelDeclaration, plant: schema.PlantDeclaration, coordinates: Collection[str]
) -> schema.PlantDeclaration:
    """Plant file, of a rig with some coordinates, as a controller with a model of its own reads it.

    The sensor that a coordinate of the model is named after reads that coordinate; one that reads what the model does
    not have reads nothing that the controller knows. A DeclarationError where such a thing is limited.
    """
    known = {*model.coordinates, *model.parameters, *model.outputs, *model.states}
    own = {s.measures.text: name for name, s in plant.sensors.items() if name in {*model.coordinates} - {*coordinates}}
    own |= {f"{text}'": f"{name}'" for text, name in own.items()}

    def named(expression: Expression) -> Expression:
        text = own.get(expression.text) or expression.renamed(own)
        return expression if text == expression.text else Expression(text, expression.place, expression.path)

    sensors = {}
    for name, sensor in plant.sensors.items():
        measures = named(sensor.measures)
        sensors[name] = sensor.model_copy(update={"measures": measures if measures.names <= known else Expression("0")})
    limits = plant.limits
    limited = {kind: {named(e): x for e, x in getattr(limits, kind).items()} for kind in ("coordinates", "velocities")}
    for kind, expression in ((kind, expression) for kind, table in limited.items() for expression in table):
        if missing := sorted(expression.names - known):
            path = f"limits.{kind}.{expression.text}"
            message = (
                f"{', '.join(missing)}, which the controller's model {model.name} does not have, cannot be held to it"
            )
            remedy = f"limit {', '.join(model.coordinates)}, or add {', '.join(missing)} to the controller's model"
            raise DeclarationError(Problem(plant.key_place(path), path, message, remedy))
    return plant.model_copy(update={"sensors": sensors, "limits": limits.model_copy(update=limited)})
