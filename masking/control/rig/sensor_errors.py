"""Errors of sensors that a controller knows: what its observer expects of a sensor that reads wrongly."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from masking.compile.codegen.graph import Graph, Node
from masking.control.rig.twin import PlacedEffect, Twin, lowered
from masking.model.effects import Effect, expressions


@dataclass(frozen=True)
class SensorError:
    """An effect in a sensor: a law of the true reading, and of states that move steadily from 0."""

    effect: str  # its name in the plant file
    sensor: str
    entry: Effect
    values: tuple[float, ...]  # of its parameters, in the order of the entry, in units of the sensor

    @classmethod
    def of(cls, twin: Twin, placed: Iterable[PlacedEffect]) -> tuple[SensorError, ...]:
        """Those of some effects in the sensors of a twin, in the order in which a reading passes them."""
        return tuple(
            cls(
                e.path.removeprefix("effects."),
                e.at,
                e.entry,
                tuple(twin.parameter_value(f"{e.label}_{name}") for name in e.entry.parameters),
            )
            for e in placed
        )

    def reading(self, true: float) -> float:
        """Reading at first, by the true one, both in the sensor's unit."""
        at = dict(zip(self.entry.parameters, self.values, strict=True)) | dict.fromkeys(self.entry.states, 0.0)
        return float(expressions(self.entry)[0].evaluate(at | {"s": true, "on": 1.0}))

    def lower(self, graph: Graph, true: Node, parameters: Sequence[Node], since: Node) -> Node:
        """Reading as a node of a graph, by the true one, the parameters, and the time since the first reading."""
        law, rates = expressions(self.entry)
        given = dict(zip(self.entry.parameters, parameters, strict=True)) | {"s": true, "on": graph.number(1.0)}
        states = {name: graph.mul(lowered(graph, rate, given), since) for name, rate in rates.items()}
        return lowered(graph, law, given | states)


def known_readings(
    errors: Sequence[SensorError],
    graph: Graph,
    true: Mapping[str, Node],
    parameters: Callable[[str, int], Sequence[Node]],
    time: Node,
) -> list[Node]:
    """Readings by the true ones of all sensors.

    `parameters` gives a number of next nodes of the parameter array under a name: those of each error, then the
    time of the first reading.
    """
    readings = dict(true)
    values = [parameters(f"error_{i}", len(error.values)) for i, error in enumerate(errors)]
    since = graph.sub(time, parameters("begun", 1)[0]) if errors else time
    for error, given in zip(errors, values, strict=True):
        readings[error.sensor] = error.lower(graph, readings[error.sensor], given, since)
    return list(readings.values())
