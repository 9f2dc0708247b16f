"""A controller that is called from Python: what a call costs beyond the compiled law, and casadi's buffered Function.

Both compute the same control law: casadi gets the statements of the generated source, with its own symbols.
"""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np

from masking.compile.codegen.generated_module import reads
from masking.compile.codegen.printers import statements
from masking.control.stepwise_controller import LawStep, SampledStep
from masking.lab.runs.experiment import Experiment
from tests.benchmarks.table import Row, few, limited, missing, told
from tests.support.python_language import PYTHON

CALLS, ROUNDS = 1000, 600
LARGEST_DIFFERENCE = 1e-12
MOST, MOST_OF_THOUSAND = 1000.0, 5000.0  # ns: a call beyond the machine code; 999 of 1000 calls
MANY = 1_000_000  # calls

Call = tuple[Callable[[], object], Callable[..., object], tuple[object, ...]]


def rows() -> Iterator[Row]:
    """Measure the Duffing law with a known state, and the clocks on the imperfect rig with an observer."""
    law, state, (whole, *given) = calls()
    yield beyond("step(t, state), duffing", whole)
    for name, call in zip(("array", "list"), given, strict=True):
        yield beyond(f"step(readings), huygens_rig, {name}", call)
    yield longest(law, state)
    yield casadi_row(law, state)


def calls() -> tuple[LawStep, np.ndarray, tuple[Call, Call, Call]]:
    """Return the Duffing law, a state, and what is called: the machine code, the controller, and its arguments."""
    law, sampled = Experiment.load("duffing").controller(), Experiment.load("huygens_rig").controller()
    assert isinstance(law, LawStep)
    assert isinstance(sampled, SampledStep)
    state = np.array([1e-3, 2e-3, -1e-3, 0.01, 0.0, 0.02])
    readings = np.array([0.01, -0.01, 0.02])
    sampled.reset(readings)
    sampled(readings)
    bare = sampled._bound[0].call
    whole: Call = (law._bound.call, law, (0.1, state))
    return law, state, (whole, (bare, sampled, (readings,)), (bare, sampled, (readings.tolist(),)))


def table() -> str:
    """Return the times of a call as a table of Markdown, in us to one digit."""
    law, state, (whole, given, _) = calls()
    times = [measured(*call) for call in (whole, given)]
    theirs = "not installed"
    if find_spec("casadi") is not None:
        evaluate, *_kept = buffered(law, state)
        theirs = digit(nanoseconds((evaluate, ()))[0])
    named = {
        "an empty call": [digit(nothing) for _, _, nothing in times],
        "the machine code alone": [digit(compiled) for compiled, _, _ in times],
        "a call of the controller": [digit(called) for _, called, _ in times],
        f"the call beyond the machine code, at most {MOST / 1000:g} us": [digit(x - y) for y, x, _ in times],
        "casadi's buffered `Function` of the same law": [theirs, ""],
    }
    head = "| us | `step(t, state)` of `duffing` | `step(readings)` of `huygens_rig` |\n|---|---|---|\n"
    return head + "\n".join(f"| {name} | {' | '.join(cells)} |" for name, cells in named.items())


def digit(time: float) -> str:
    """Return a time in ns as us, to a digit."""
    return f"{time / 1000:.1f}" if time >= 100.0 else f"{time / 1000:.2f}"


def empty(*_: object) -> None:
    """Do nothing, to be called."""


def nanoseconds(*calls: tuple[Callable[..., object], tuple[object, ...]]) -> list[float]:
    """Return the shortest time of a call of each function with its arguments, measured in turn."""
    timers = []
    for called, arguments in calls:
        names = {f"a{i}": value for i, value in enumerate(arguments)}
        timers.append(timeit.Timer(f"called({', '.join(names)})", globals={"called": called, **names}))
    rounds = [[timer.timeit(CALLS) for timer in timers] for _ in range(few(ROUNDS))]
    return [min(times) / CALLS * 1e9 for times in zip(*rounds, strict=True)]


def measured(bare: Callable[[], object], step: Callable[..., object], given: tuple[object, ...]) -> list[float]:
    """Return what the machine code takes in ns, the call of the controller, and an empty call."""
    return nanoseconds((bare, ()), (step, given), (empty, given))


def beyond(what: str, call: Call) -> Row:
    """Give the row of what a call costs beyond the machine code that it calls."""
    compiled, called, nothing = measured(*call)
    note = f"a call takes {called:.0f} ns, the machine code {compiled:.0f} ns, an empty call {nothing:.0f} ns"
    value = called - compiled
    return limited(f"beyond the compiled law: {what}", f"{value:.0f} ns", "", value, at_most=MOST, unit="ns", note=note)


def longest(law: LawStep, state: np.ndarray) -> Row:
    """Give the row of how long 999 of 1000 calls take at most, the clock included."""
    clock, times = time.perf_counter_ns, np.empty(few(MANY, 1000), dtype=np.int64)
    for i in range(len(times)):
        begin = clock()
        law(0.1, state)
        times[i] = clock() - begin
    middle, most, all_of = np.quantile(times, (0.5, 0.999, 1.0))
    note = f"of {len(times):g} calls; median {middle:.0f} ns, longest {all_of / 1000:.0f} us"
    what = "step(t, state), duffing: 99.9 % of calls within"
    return limited(what, f"{most:.0f} ns", "", most, at_most=MOST_OF_THOUSAND, unit="ns", note=note)


def casadi_row(law: LawStep, state: np.ndarray) -> Row:
    """Give the row of the Duffing law beside casadi's buffered Function."""
    what = "control law called from Python, duffing"
    if find_spec("casadi") is None:
        return missing(what, "casadi is not installed")
    evaluate, inputs, *kept = buffered(law, state)
    evaluate()
    law(0.1, state)
    difference = float(np.max(np.abs(inputs - law.inputs)) / np.max(np.abs(inputs)))
    if difference > LARGEST_DIFFERENCE:
        return missing(what, f"inputs differ by {difference:.1e}")
    ours, theirs, nothing = nanoseconds((law, (0.1, state)), (evaluate, ()), (empty, (0.1, state)))
    note = f"inputs differ by {difference:.1e}; an empty call {nothing:.0f} ns; casadi's buffers are filled before"
    del kept
    return told(what, f"{ours:.0f} ns", f"{theirs:.0f} ns", theirs / ours, note)


def buffered(law: LawStep, state: np.ndarray) -> tuple[Any, ...]:
    """Return casadi's buffered Function of the law's generated source, the inputs that it writes, and what it needs."""
    import casadi

    n, m, p = len(law.loop.plant.coordinates), len(law.inputs), law.loop.values()
    symbols: Any = casadi.SX.sym("y", 2 * n)
    u: list[Any] = [None] * m
    step: Any = law.loop._build().parts["step"]
    lines = reads(step.graph, [node for _, node in step.results], step.loads, PYTHON)
    lines += statements(step.graph, step.results, PYTHON)
    q, v = ([symbols[first + i] for i in range(n)] for first in (0, n))
    exec("\n".join(lines), {"math": casadi, "t": 0.0, "q": q, "v": v, "u": u, "p": p.tolist()})  # noqa: S102
    made = casadi.Function("law", [symbols], [casadi.vertcat(*u)])
    buffer, evaluate = made.buffer()
    inputs = np.zeros(m)
    buffer.set_arg(0, memoryview(state))
    buffer.set_res(0, memoryview(inputs))
    return evaluate, inputs, buffer, made
