"""Cycles of a step on a Cortex-M4F, computed: the instructions that QEMU executes, with the times that Arm states.

QEMU does not model how long an instruction takes, but logs the address of each. The bounds of what they take are those
of Tables 3-1 and 7-1 of the *Arm Cortex-M4 Processor Technical Reference Manual*, revision r0p1 (100166), which hold
where memory has no wait states and no interrupt comes.
"""

import re
import socket
import subprocess
import time
from dataclasses import dataclass
from functools import cache

from tests.support.cortex_m4 import CortexM4

REFILL = (1, 3)  # P, cycles in which the pipeline is refilled after a branch
SLOW = 14  # of a division or a square root, which integer instructions may overlap
CONDITIONS = "eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
BRANCH = re.compile(rf"(b({CONDITIONS})?|bl|bx|blx|cbn?z|tb[bh])$")
# Bounds in cycles by mnemonic, without condition and width; the first that matches. Neighbours among single loads and
# stores pipeline to one cycle; IT and NOP may be folded; a floating-point result that the next instruction takes costs
# a cycle more.
TIMES = (
    (r"it[te]*|nop", (0, 1)),
    (
        r"(mov[wt]?|mvn|addw?|adc|adr|subw?|sbc|rsb|neg|cmp|cmn|tst|teq|and|eor|orr|orn|bic|lsl|lsr|asr|ror|rrx)s?",
        (1, 1),
    ),
    (r"(mul|mla|mls|[su]mull|[su]mlal|clz|rev|rbit|[su]xt[bh]|[su]bfx|bfi|bfc|[su]sat)s?", (1, 1)),
    (r"[su]div", (2, 12)),
    (r"(ldr|str)(s?[bh])?", (1, 2)),
    (r"(ldr|str)d", (3, 3)),
    (r"v(ldr|str)", (1, 2)),
    (r"vmov|vmrs|vmsr", (1, 1)),
    (r"v(abs|neg|add|sub|n?mul|cmpe?|cvtr?)", (1, 2)),
    (r"v(n?ml[as]|fn?m[as])", (3, 4)),
    (r"v(div|sqrt)", (1, SLOW + 1)),
    (r"tb[bh]", (2, 2)),
    (BRANCH.pattern[:-1], (1, 1)),
)
MULTIPLE = re.compile(r"(v)?(ldm|stm|push|pop)(ia|db)?$")
LINE = re.compile(r"^ *([0-9a-f]+):\t((?:[0-9a-f]{4} ?){1,2}) *\t(\S+)(?:\t([^;@\n]*))?", re.MULTILINE)
EXECUTED = re.compile(r"^Trace \d+: \S+ \[[0-9a-f]+/([0-9a-f]+)/", re.MULTILINE)
SINGLE_STEP = ("singlestep on", "one-insn-per-tb on")  # by versions of QEMU; the other one is unknown to it
PATIENCE = 30.0  # seconds


@dataclass(frozen=True)
class Instruction:
    """An instruction in flash: its bytes, its bounds in cycles where it does not branch, and what it is."""

    size: int
    low: int
    high: int
    is_floating: bool
    is_slow: bool


def program(elf):
    """Return the instructions of a program by their addresses, as the disassembler prints them."""
    text = subprocess.run(["arm-none-eabi-objdump", "-d", elf], capture_output=True, text=True, check=True).stdout
    found, conditional = {}, 0
    for address, words, mnemonic, operands in LINE.findall(text):
        if mnemonic.startswith("."):
            continue
        found[int(address, 16)] = (len(words.split()) * 2, mnemonic, operands.strip(), conditional > 0)
        conditional = len(mnemonic) - 1 if re.fullmatch(r"it[te]*", mnemonic) else conditional - 1
    return found


@cache
def instruction(size, mnemonic, operands, is_conditional):
    """Return an instruction of a program; one whose condition fails takes a cycle."""
    base = mnemonic.split(".")[0]
    if is_conditional and not BRANCH.match(base):
        base = re.sub(rf"({CONDITIONS})$", "", base)
    low, high = bounds(base, operands)
    is_floating, is_slow = base.startswith("v"), base in {"vdiv", "vsqrt"}
    return Instruction(size, min(low, 1) if is_conditional else low, high, is_floating, is_slow)


def bounds(base, operands):
    """Return the least and the most cycles of an instruction, without a refill of the pipeline."""
    if MULTIPLE.match(base):
        words = sum(_count(part) for part in re.search(r"\{(.*)\}", operands)[1].split(","))
        return 1 + words, 1 + words
    if base in {"vldr", "vstr"} and operands.startswith("d"):
        return 2, 3
    if base == "vmov" and len(re.findall(r"\b[rsd]\d+|\b(?:ip|lr|sl|fp)\b", operands)) > 2:
        return 2, 2
    times = [times for pattern, times in TIMES if re.fullmatch(pattern, base)]
    assert times, f"the time of {base} is not in the table"
    return times[0]


def _count(part):
    """Return the words of a register or a range of registers, `r4`, `s16-s18`, `d8-d9`."""
    first, _, last = part.strip().partition("-")
    words = 2 if first.startswith("d") else 1
    return words * (int(last[1:]) - int(first[1:]) + 1) if last else words


def cycles(instructions, addresses):
    """Return the least and the most cycles of the instructions at the addresses that were executed, in their order."""
    low = high = free = 0
    for here, then in zip(addresses, [*addresses[1:], None], strict=True):
        it = instruction(*instructions[here])
        if it.is_floating:
            low = max(low, free)  # waits for a division
        if it.is_slow:
            free = low + SLOW
        refills = then != here + it.size
        low += it.low + REFILL[0] * refills
        high += it.high + REFILL[1] * refills
    return low, high


def of_longest_step(folder, unit, real, orders, ticks):
    """Return the least and the most cycles of the longest step among orders, and the instructions that QEMU logged.

    `ticks` are what `CortexM4.replay` returned for the orders.
    """
    longest = ticks.index(max(ticks))
    monitor = folder / "monitor"
    options = ("-chardev", f"socket,id=monitor,path={monitor},server=on,wait=off", "-mon", "chardev=monitor")
    with CortexM4(folder, unit, real, options) as board:
        board.replay(orders[:longest])
        log = folder / "executed"
        with Monitor(monitor) as told:
            for line in (f"logfile {log}", *SINGLE_STEP, "log exec,nochain"):
                told.say(line)
            board.replay([orders[longest]])
            told.say("log none")
    executed = _inside(folder / "unit.elf", unit, log)
    return *cycles(program(folder / "unit.elf"), executed), len(executed)


def _inside(elf, unit, log):
    """Return the addresses that were executed from the first of the step to its return."""
    names = subprocess.run(["arm-none-eabi-nm", "-S", elf], capture_output=True, text=True, check=True).stdout
    lines = [words for words in map(str.split, names.splitlines()) if len(words) == 4]
    symbols = {name: (int(address, 16), int(size, 16)) for address, size, _, name in lines}
    (main, size), (begin, _) = symbols["main"], symbols[f"{unit.name}_step"]
    executed = [int(address, 16) for address in EXECUTED.findall(log.read_text())]
    executed = executed[executed.index(begin) :]
    end = next(i for i, address in enumerate(executed) if main <= address < main + size)
    # An instruction at which the emulator looked at its clock is logged again.
    return [a for a, before in zip(executed[:end], [None, *executed], strict=False) if a != before]


class Monitor:
    """The monitor of QEMU; a context."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(PATIENCE)
        end = time.monotonic() + PATIENCE
        while self.socket.connect_ex(str(path)):
            assert time.monotonic() < end, "the emulator has no monitor"
            time.sleep(0.01)
        self._prompt()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def say(self, line):
        """Give an order, and wait until it is done."""
        self.socket.sendall(f"{line}\n".encode())
        self._prompt()

    def _prompt(self):
        found, end = b"", time.monotonic() + PATIENCE
        while not found.endswith(b"(qemu) "):
            assert time.monotonic() < end, found
            found += self.socket.recv(4096)
