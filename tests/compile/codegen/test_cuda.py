"""What runs on a GPU: its code makes the same runs on this processor, and is code of such a processor at last."""

import contextlib
import ctypes
import importlib.util
import re
from pathlib import Path
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest

from masking import load_model
from masking.compile.codegen import cuda, llvm_text, native
from masking.compile.codegen.graph import Graph
from masking.errors import MaskingError, ModelError

TIMES = np.linspace(0.0, 20.0, 21)


def linked(text, name, *types, returns=None):
    """Return a function of LLVM code, made for this processor."""
    native.parsed("")
    builder = native.llvm.JITLibraryBuilder().add_ir(text).add_current_process().export_symbol(name)
    library = builder.link(native._linker(), f"test {name} {hash(text)}")
    return ctypes.CFUNCTYPE(returns, *types)(library[name]), library


class There(np.ndarray):
    """An array of a GPU that is none: what is written into it comes back only if it is fetched."""

    def get(self, out):
        out[:] = self


class Processor:
    """This processor in the place of CuPy and a GPU with little memory."""

    def __init__(self, free):
        runtime = SimpleNamespace(CUDARuntimeError=type("CUDARuntimeError", (Exception,), {}))
        pool = SimpleNamespace(malloc=None, free_all_blocks=lambda: None)
        self.sizes = []
        self.cuda = SimpleNamespace(
            MemoryPool=lambda: pool,
            using_allocator=contextlib.nullcontext,
            Device=lambda: SimpleNamespace(mem_info=(free, free)),
            memory=SimpleNamespace(OutOfMemoryError=type("OutOfMemoryError", (Exception,), {})),
            runtime=runtime,
            driver=SimpleNamespace(CUDADriverError=runtime.CUDARuntimeError),
        )

    def asarray(self, array):
        return np.array(array).view(There)

    def kernel(self, function):
        """Return what makes runs one after the other, of the same code."""
        module = native.parsed(cuda.assembled(function))
        native.optimise(module, cuda.OF_ONE, native._machine)

        made = []

        def start(grid, block, given):
            runs, *rest = given
            assert grid[0] * block[0] >= runs
            types = [{There: ctypes.c_void_p, np.float64: ctypes.c_double}.get(type(x), ctypes.c_int64) for x in rest]
            made[:] = made or [linked(str(module), cuda.OF_ONE, ctypes.c_int64, *types)]
            run, _ = made[0]
            passed = [x.ctypes.data if isinstance(x, There) else x.item() for x in rest]
            for i in range(runs):
                run(i, *passed)
            self.sizes.append(int(runs))

        return start


@pytest.fixture
def on_this_processor(monkeypatch):
    stands_for_gpu = Processor(free=2 * 3 * 22 * 6 * 8)  # three runs of six states
    monkeypatch.setattr(cuda, "available", lambda: stands_for_gpu)
    monkeypatch.setattr(cuda, "_loaded", stands_for_gpu.kernel)
    return stands_for_gpu


@pytest.fixture
def gpu():
    try:
        return cuda.available()
    except MaskingError as error:
        pytest.skip(str(error))


def test_a_gpu_makes_the_runs_of_the_processor(gpu):
    model = load_model("huygens").dimensionless()
    given = {"ensemble": {"z": np.linspace(0.1, 0.3, 1000)}, "tolerance": 1e-12}
    assert np.abs(model.simulate(TIMES, **given, gpu=True).states - model.simulate(TIMES, **given).states).max() < 1e-10


@pytest.mark.parametrize("name", ["huygens", "duffing", "van_der_pol", "cart_pendulum", "bristled_mass"])
def test_runs_are_those_of_the_processor(on_this_processor, name):
    model = load_model(name)
    model = model.dimensionless() if model.declaration.scales else model
    given = {
        "ensemble": {model.state_names[0]: np.linspace(0.1, 0.2, 5)},
        "initial": dict.fromkeys(model.coordinates, 0.1),
    }
    found, expected = model.simulate(TIMES, **given, gpu=True), model.simulate(TIMES, **given)
    assert sum(on_this_processor.sizes) == 5
    assert len(on_this_processor.sizes) > 1 or len(model.state_names) < 6
    assert abs(found.steps / expected.steps - 1.0) < 0.01  # steps of a switch depend on the last bits
    assert np.abs(found.states - expected.states).max() < 1e-7 * np.abs(expected.states).max()


def test_a_run_that_cannot_go_on_is_named(on_this_processor, declared):
    """x'' = x^3 from x = a and x' = a^2/sqrt(2) is a/(1 - a t/sqrt(2)), infinite at sqrt(2)/a."""
    model = declared(coordinates={"x": {}}, equations={"x''": "x**3"})
    a = np.array([0.01, 1.0, 0.02])
    found = model.simulate(TIMES, ensemble={"x": a, "x'": a**2 / 2**0.5}, gpu=True)
    assert list(found.errors) == [1]
    assert np.isnan(found.states[1]).all()
    exact = a[:, None] / (1.0 - a[:, None] * TIMES / 2**0.5)
    assert np.abs(found["x"] / exact - 1.0)[[0, 2]].max() < 1e-9


@pytest.mark.parametrize("name", [*llvm_text.OWN, "sqrt", "floor"])
def test_elementary_functions_are_right(name):
    """To three units in the last place; a power to those of the exponent times the logarithm."""
    two = name in llvm_text.TWO
    graph = Graph()
    x = [graph.symbol(one, varying=True) for one in ("x", "y")[: 1 + two]]
    text = llvm_text.function("f", {"x": "float", "y": "float"}, graph, [], {}, graph.apply(name, *x))
    whole = "\n\n".join(llvm_text.with_elementary_functions("\n".join([llvm_text.declarations(text), text])))
    assert not re.search(r"@(?!masking|llvm\.(sqrt|floor|fabs)|f\()", whole)
    real = ctypes.c_double
    function, library = linked(whole, "f", real, real, returns=real)
    points = [*np.linspace(-3.0, 3.0, 31), *np.geomspace(1e-3, 1e2, 20)]
    second = {"pow": [2.0, 3.0, -1.0, 0.5, 1.7, -2.3, 0.0], "atan2": [0.0, 1.0, -1.0, 0.3, -2.0]}.get(name, [0.0])
    at = {"pow": mpmath.power, "floor": mpmath.floor}.get(name) or getattr(mpmath, name)
    with mpmath.workdps(40):
        for b in second:
            for a in points:
                try:
                    exact = at(mpmath.mpf(a), mpmath.mpf(b)) if two else at(mpmath.mpf(a))
                except ZeroDivisionError:
                    exact = mpmath.inf
                found = function(a, b)
                if isinstance(exact, mpmath.mpc) or mpmath.isnan(exact):
                    assert np.isnan(found), (a, b)
                elif mpmath.isinf(exact):
                    assert found == exact, (a, b)
                else:
                    units = 3.0 * (max(1.0, abs(b * np.log(abs(a)))) if name == "pow" and a else 1.0)
                    assert abs(found - exact) <= units * np.spacing(abs(float(exact))), (a, b)
    del library


def test_the_code_is_that_of_a_gpu_and_is_linked_once(monkeypatch):
    """In a process, for all models of the same equations; in another process, it is found on disk."""
    linked = []

    def module(path):
        linked.append(Path(path).read_text())
        return SimpleNamespace(get_function=lambda name: (name, len(linked)))

    monkeypatch.setattr(cuda, "available", lambda: SimpleNamespace(RawModule=module, cuda=None))
    monkeypatch.setattr(cuda, "_kernels", {})
    for _ in range(2):
        assert cuda._loaded(load_model("huygens").dimensionless().kernels.solve_taylor) == (cuda.KERNEL, 1)
    assert f".visible .entry {cuda.KERNEL}(" in linked[0]
    assert ".extern" not in linked[0]
    monkeypatch.setattr(cuda, "_assembly", None)
    assert [cuda.code(load_model("huygens").dimensionless().kernels.solve_taylor)] == linked


@pytest.mark.parametrize(
    ("kind", "message"), [("memory", "no room for 1 runs together"), ("runtime", r"made no runs \(stopped\)")]
)
def test_a_gpu_that_fails_says_so(on_this_processor, monkeypatch, kind, message):
    error = {"memory": "OutOfMemoryError", "runtime": "CUDARuntimeError"}[kind]

    def kernel(grid, block, given):
        raise getattr(getattr(on_this_processor.cuda, kind), error)("stopped")

    monkeypatch.setattr(cuda, "_loaded", lambda function: kernel)
    with pytest.raises(MaskingError, match=message):
        load_model("huygens").simulate(TIMES, ensemble={"z": [0.1]}, gpu=True)


def test_what_a_gpu_cannot_make_is_refused():
    model = load_model("huygens")
    if importlib.util.find_spec("cupy") is None:
        with pytest.raises(MaskingError, match="CuPy is not installed"):
            model.simulate(TIMES, ensemble={"z": [0.1]}, gpu=True)
    with pytest.raises(ModelError, match="one for each run; got none"):
        model.simulate(TIMES, gpu=True)
    with pytest.raises(ModelError, match="no runs with events, delays"):
        load_model("escapements").simulate(TIMES, ensemble={"x1": [0.1]}, gpu=True)
