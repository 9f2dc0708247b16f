"""Exported controllers on a Cortex-M4F: built by arm-none-eabi-gcc and run in QEMU, over its serial port.

QEMU does not model the time that an instruction takes. With `-icount shift=6` each takes 64 ns of the virtual clock,
and SysTick counts at 25 MHz: ticks times 40 / 64 are the instructions that were executed, exact to two.
"""

import select
import shutil
import struct
import subprocess

import numpy as np

from masking.control.exports.c_unit import CUnit
from masking.control.exports.unit_files import programs

COMPILER, EMULATOR = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")
MISSING = "there is no arm-none-eabi-gcc" if COMPILER is None else "there is no qemu-system-arm"
FLAGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-mcpu=cortex-m4", "-mthumb"),
    *("-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffp-contract=off"),
)
LINKED = ("-nostartfiles", "--specs=nosys.specs", "-T", "cortex_m4.ld")
MACHINE = (
    "-M",
    "mps2-an386",
    "-display",
    "none",
    "-monitor",
    "none",
    "-serial",
    "stdio",
    "-icount",
    "shift=6,sleep=off",
)
INSTRUCTIONS_PER_TICK = 40 / 64
PATIENCE = 30.0  # seconds without an answer
BATCH = 100  # orders, whose bytes and answers fit into a pipe
TYPES = {"double": np.float64, "float": np.float32}


def order(kind, readings, real):
    """Return the bytes that begin (`i`) or make a step (`s`)."""
    return kind + np.asarray(readings, TYPES[real]).tobytes()


class CortexM4:
    """A unit on a processor of its own; a context that ends with the emulator.

    `flash` is the bytes of its object file that go there.
    """

    def __init__(self, folder, unit, real, options=()):
        self.unit, self.real, self.dtype = unit, real, TYPES[real]
        text = CUnit(unit, real)
        files = {f"{unit.name}.h": text.header(), f"{unit.name}.c": text.source(), **programs(unit, real)}
        for name, content in files.items():
            (folder / name).write_text(content)
        sources = [f"{unit.name}.c", f"{unit.name}_cortex_m4.c"]
        subprocess.run([COMPILER, *FLAGS, *LINKED, *sources, "-lm", "-o", "unit.elf"], cwd=folder, check=True)
        subprocess.run([COMPILER, *FLAGS, "-c", sources[0], "-o", "unit.o"], cwd=folder, check=True)
        size = subprocess.run(["arm-none-eabi-size", "unit.o"], cwd=folder, capture_output=True, text=True, check=True)
        self.flash = int(size.stdout.splitlines()[1].split()[0])
        self.process = subprocess.Popen(
            [EMULATOR, *MACHINE, *options, "-kernel", folder / "unit.elf"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0,
        )  # fmt: skip

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()

    def init(self, readings):
        self.process.stdin.write(order(b"i", readings, self.real))

    def step(self, readings):
        self.process.stdin.write(order(b"s", readings, self.real))
        return self._answer()

    def replay(self, orders):
        """Send orders, many at a time, and return the ticks of each step; 0 for what begins."""
        ticks = []
        for first in range(0, len(orders), BATCH):
            batch = orders[first : first + BATCH]
            self.process.stdin.write(b"".join(each + b"r" * (each[:1] == b"s") for each in batch))
            for each in batch:
                is_step = each[:1] == b"s" and self._answer() is not None
                ticks.append(struct.unpack("<4I", self._read(16))[0] if is_step else 0)
        return ticks

    def measured(self):
        """Return instructions of the last step and of the longest one, bytes of stack, bytes of the state."""
        self.process.stdin.write(b"r")
        last, longest, stack, state = struct.unpack("<4I", self._read(16))
        return round(last * INSTRUCTIONS_PER_TICK), round(longest * INSTRUCTIONS_PER_TICK), stack, state

    def _answer(self):
        size = len(self.unit.ports["commands"]) * self.dtype().itemsize
        answer = self._read(size + 4)
        self.status = struct.unpack("<i", answer[size:])[0]
        return np.frombuffer(answer[:size], self.dtype).astype(np.float64)

    def _read(self, size):
        found = b""
        while len(found) < size:
            assert select.select([self.process.stdout], [], [], PATIENCE)[0], "the emulator does not answer"
            part = self.process.stdout.read(size - len(found))
            assert part, "the emulator has ended"
            found += part
        return found
