"""A law that no dictionary has, written into the model of a controller: masking cancels it.

The record is made by scipy; the rig of the experiment has the law as an expression that is typed here.
"""

import numpy as np
import pytest

import masking
from tests.benchmarks.laws import records

CASE = records.Case("fluid 1.7", 1)
EXPERIMENT = """
name: on a rig with an unknown drag
plant: {folder}/rig.yaml
virtual: van_der_pol
transform: {{expressions: {{x: q1/stroke}}, parameters: {{stroke: {stroke}}}}}
controller: {{rate: {rate:.9g} Hz, observer: exact, model: {folder}/believed.yaml}}
time_scale: {time_scale}
duration: 40
"""
RIG = """
name: rig with an unknown drag
kind: simulated
model: true.yaml
sensors: {q1: {measures: q1, unit: m}}
"""


@pytest.mark.search
def test_a_law_without_a_name_is_cancelled(tmp_path):
    rig = records.Rig.of(CASE)
    believed = records.model(rig, 1)
    drag = rig.hidden(0.0, 1.0)  # of a rate of 1 m/s
    term = f" - ({drag:.9g})*abs(q1'/v1)**0.7*q1'/v1 + u"
    true = believed.replace(" + u\n", f"{term}\n").replace(
        "parameters:\n", "parameters:\n  v1: {value: 1, unit: m/s}\n"
    )
    true = true.replace(f"({drag:.9g})", "f1").replace(
        "parameters:\n", f"parameters:\n  f1: {{value: {drag:.9g}, unit: N}}\n"
    )
    content = EXPERIMENT.format(
        folder=tmp_path, stroke=0.5 * rig.size, rate=1000.0 * rig.speed / (2.0 * np.pi), time_scale=1.0 / rig.speed
    )
    for name, text in (("believed", believed), ("true", true), ("rig", RIG), ("experiment", content)):
        (tmp_path / f"{name}.yaml").write_text(text)
    for seed, name in ((1, "train"), (2, "unseen")):
        (tmp_path / f"{name}.csv").write_text(records.table(records.record(rig, seed)))
    given = {"record": tmp_path / "train.csv", "validation": tmp_path / "unseen.csv", "hold": "first-order"}
    made = masking.refine(tmp_path / "experiment.yaml", **given, out=tmp_path / "out")
    assert (made.discovery.verdict, made.discovery.law.place) == ("unknown", "spring1")
    assert made.after.worst < 0.2 * made.before.worst
    assert "a law without a name in spring1" in made.sentence
