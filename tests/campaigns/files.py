"""Faults 23, 24, 28 and 33: a self-test on a rig that is wired wrongly, and declarations that are hostile or broken."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from masking.errors import MaskingError
from masking.lab.plants.udp import UdpPlant
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.self_test import SIZE, self_test
from tests.campaigns.bench import Bench
from tests.campaigns.table import Fault, Judgement
from tests.campaigns.twins import PLANT, twin

_PLANT: Final = "linear_rig"
_PLACE: Final = re.compile(r"\.yaml:\d+:\d+:")


def _tested(bench: Bench, judgement: Judgement, damage: Mapping[str, Any], named: str, plant: str = _PLANT) -> None:
    """Demand that the self-test refuses a damaged rig, names the channel, and never sends more than its pulse."""
    served = bench.served(plant=plant)
    served.damage(**damage)
    found = self_test(twin(plant), UdpPlant(served.address, patience=20.0), lockstep=True, acknowledge=True)
    largest = 0.0
    for _ in twin(plant).actuators[: max(1, len({answer.actuator for answer in found.answers}))]:
        largest = max(largest, float(np.abs(served.record().array("input")).max()))
    pulse = SIZE * max(limit.max for limit in twin(plant).declaration.limits.inputs.values())
    judgement.need(found.findings, f"{named}: not refused")
    judgement.need(any(named in finding for finding in found.findings), f"{named}: not named in {found.findings}")
    judgement.need(largest <= pulse * (1.0 + 1e-12), f"{named}: {largest:g} V, more than the pulse of {pulse:g} V")
    if found.findings:
        judgement.say(f"{found.findings[0].split(';')[0][:70]} (at most {largest:.3g} V)")


def _hums(bench: Bench, judgement: Judgement) -> None:
    declared = twin(PLANT).noise()["s2"]
    _tested(bench, judgement, {"what": "hum", "channel": 1, "value": 10.0 * declared}, "s2", PLANT)


def _wrong_sign(bench: Bench, judgement: Judgement) -> None:
    _tested(bench, judgement, {"what": "scale", "channel": 2, "value": -1.0}, "s3")


def _wrong_actuator(bench: Bench, judgement: Judgement) -> None:
    _tested(bench, judgement, {"what": "command", "channel": 1, "value": -1.0}, "V2")
    _tested(bench, judgement, {"what": "command", "channel": 1, "value": 0.0}, "V2")
    _tested(bench, judgement, {"what": "stick", "channel": 1, "value": 0.01}, "V2")


def _hostile(bench: Bench, judgement: Judgement) -> None:
    folder = bench.place()
    folder.mkdir(parents=True)
    touched = folder / "executed"
    head = "name: hostile\nvirtual: duffing\nplant: tue_rig\n"
    expression = 'transform: {{expressions: {{x1: "{}"}}}}\n'
    cases = {
        "import": expression.format(f"__import__('os').system('touch {touched}')"),
        "attribute": expression.format("x1.__class__"),
        "lambda": expression.format("(lambda: x1)()"),
        "infinite": expression.format("1e400*x1"),
        "power": expression.format("9**9**9**9*x1"),
        "look-alike": expression.format("\u04451"),
        "tag": f"initial: !!python/object/apply:os.system ['touch {touched}']\n",
        "twice": "duration: 3\nduration: 4\n",
        "octal": "duration: 010\n",
        "unknown": "durations: 3\n",
        "open": "initial: {x1: [1, 2\n",
        "tab": "\tduration: 3\n",
    }  # fmt: skip
    for name, text in cases.items():
        file = folder / f"{name}.yaml"
        file.write_text(head + text, encoding="utf-8")
        try:
            Experiment.load(str(file)).validate()
            judgement.need(holds=False, broken=f"{name}: not refused")
        except MaskingError as error:
            judgement.need(_PLACE.search(str(error)), f"{name}: no file:line:column in {str(error)[:100]!r}")
        except Exception as error:  # what a reader must not raise is what is evaluated
            judgement.need(holds=False, broken=f"{name}: {type(error).__name__}")
    judgement.need(not touched.exists(), "a declaration was executed")
    judgement.say(f"{len(cases)} declarations refused by their place; nothing executed")


FAULTS: Final = (
    Fault(23, "sensor with the wrong sign", "the self-test refuses; never more than its pulse", _wrong_sign),
    Fault(24, "actuator reversed, dead, stuck", "the self-test refuses; never more than its pulse", _wrong_actuator),
    Fault(28, "hostile or broken declarations", "refused with file:line:column; nothing executed", _hostile),
    Fault(33, "50 Hz of 10 times the noise on a sensor", "the self-test refuses; never more than its pulse", _hums),
)
