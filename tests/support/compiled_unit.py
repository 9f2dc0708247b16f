"""Exported units compiled by gcc and called with arrays."""

import ctypes
import math
import shutil
import subprocess

import numpy as np

from masking.control.exports.c_unit import CUnit
from masking.control.exports.unit_kernels import COUNTERS

GCC = shutil.which("gcc")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion")
TYPES = {"double": (ctypes.c_double, np.float64), "float": (ctypes.c_float, np.float32)}


class CompiledUnit:
    """A unit in C: its operations are methods that take what the header says, and return the status."""

    def __init__(self, folder, unit, real="double", flags=("-O1",)):
        self.unit, (self.number, self.dtype) = unit, TYPES[real]
        text = CUnit(unit, real)
        (folder / f"{unit.name}.h").write_text(text.header())
        source, library = folder / f"{unit.name}.c", folder / f"{unit.name}_{real}.so"
        source.write_text(text.source())
        subprocess.run([GCC, *STRICT, *flags, "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))
        size = sum(max(1, math.prod(shape)) for shape in unit.memory.values())
        self.state = ctypes.create_string_buffer(size * self.dtype().itemsize + 8 * COUNTERS)

    def memory(self, name):
        """Return an array of its state, flat, as it is there."""
        sizes = {one: max(1, math.prod(shape)) for one, shape in self.unit.memory.items()}
        before = sum(list(sizes.values())[: list(sizes).index(name)])
        return np.frombuffer(self.state, self.dtype, sizes[name], before * self.dtype().itemsize)

    def __getattr__(self, name):
        function = getattr(self.library, f"{self.unit.name}_{name}")
        written = self.unit.written(name)
        operation = self.unit.operations[name]
        public = [a for a in operation.arguments if a == "time" or a in self.unit.ports]

        def call(*given):
            values, out = list(given), {}
            arguments = []
            for argument in public:
                if argument in written:
                    out[argument] = np.zeros(len(self.unit.ports[argument]), self.dtype)
                    arguments.append(out[argument].ctypes.data_as(ctypes.c_void_p))
                elif argument == "time":
                    arguments.append(self.number(values.pop(0)))
                else:
                    array = np.ascontiguousarray(values.pop(0), self.dtype)
                    out[f"given {argument}"] = array
                    arguments.append(array.ctypes.data_as(ctypes.c_void_p))
            self.status = function(ctypes.byref(self.state), *arguments)
            return out[written[0]] if written else None

        return call
