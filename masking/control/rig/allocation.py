"""Allocation: what each input of a model gets of each actuator of a rig."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import DeclarationError
from masking.model.declaration.experiment_checks import check_allocation
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import problem_at
from masking.model.declaration.schema import ModelDeclaration, PlantDeclaration
from masking.model.declaration.units import factor_of


def allocation(plant: PlantDeclaration, model: ModelDeclaration, parameters: Mapping[str, float]) -> Array:
    """Input of a model, in SI units, per unit of each actuator, in its unit (inputs, actuators).

    The parameters of the model are in SI units; without `actuators` in the plant file, each input is an actuator. A
    DeclarationError where an input is not wired, or not linear in the actuators.
    """
    sizes = np.array([factor_of(channel.unit) for channel in (plant.actuators or model.inputs).values()])
    if not plant.actuators:
        return np.diag(sizes)
    if problems := [*check_allocation(plant, model)]:
        raise DeclarationError(problems)
    rows = np.zeros((len(model.inputs), len(plant.actuators)))
    for i, name in enumerate(model.inputs):
        path = f"allocation.{name}"

        def at(command: Array, expression: Expression = plant.allocation[name]) -> float:
            return expression.evaluate({**parameters, **dict(zip(plant.actuators, command, strict=True))})

        rest = at(np.zeros(len(plant.actuators)))
        rows[i] = [at(unit) - rest for unit in np.eye(len(plant.actuators))]
        probe = np.random.default_rng(0).uniform(0.5, 1.5, len(plant.actuators))
        if rest != 0.0 or not np.isclose(at(probe), rows[i] @ probe, rtol=1e-9):
            message = "the allocation must be a sum of actuators times numbers"
            problems.append(problem_at(plant, path, message, "put anything else into effects"))
    if problems:
        raise DeclarationError(problems)
    rows *= sizes
    return rows
