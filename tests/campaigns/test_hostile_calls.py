"""A sample of the hostile calls of `python -m tests.campaigns calls`, and that a call beyond its arrays is noticed."""

import dataclasses

import numpy as np

import masking
from masking.compile.codegen.argument_conditions import NOTHING
from tests.campaigns import hostile_calls, kernels_in_use


def test_no_hostile_call_ends_its_process():
    outcome = hostile_calls.run(1500, seed=3, is_quick=True)
    assert outcome.ended == []
    assert min(outcome.refused.total(), outcome.returned.total()) > 300


def test_a_kernel_that_is_not_asked_for_its_sizes_ends_its_process(monkeypatch):
    solve = masking.load_model("duffing").kernels.solve_taylor
    careless = dataclasses.replace(solve, needed=NOTHING)
    given = (0.0, np.zeros(6), np.linspace(0.0, 1.0, 5), np.zeros(0), np.full(8, 0.5), 1e-6, 0.0, np.zeros((5, 6)))
    for function, is_safe in ((solve, True), (careless, False)):
        function.prepare()
        monkeypatch.setattr(kernels_in_use, "recorded", lambda one=function, **_: [(one, given)])
        assert (hostile_calls.run(200, seed=1).ended == []) == is_safe
