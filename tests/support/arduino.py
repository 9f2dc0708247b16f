"""Sketches without a board: what they use of Arduino's library, on a Cortex-M4F in QEMU with a serial line."""

import shutil
import subprocess

from masking.control.exports.c_unit import CUnit
from masking.control.exports.unit_files import programs
from tests.support.cortex_m4 import EMULATOR, FLAGS, LINKED, MACHINE

COMPILER = shutil.which("arm-none-eabi-g++")
MISSING = "there is no arm-none-eabi-g++" if COMPILER is None else "there is no qemu-system-arm"
LIBRARY = """
#pragma once
#include <stddef.h>
#include <stdint.h>

struct Port {
    void begin(long baud);
    int available();
    int read();
    size_t write(const uint8_t *bytes, size_t size);
};
extern Port Serial;
uint32_t micros();
uint32_t millis();
"""
BOARD = """
#include "Arduino.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define DATA REGISTER(0x40004000u)
#define STATE REGISTER(0x40004004u)

extern uint32_t data_source[], data_start[], data_end[], bss_start[], bss_end[], stack_top[];
void setup();
void loop();

Port Serial;
static uint32_t counted, before;

void Port::begin(long)
{
    REGISTER(0x40004010u) = 16; // divider
    REGISTER(0x40004008u) = 3;  // send and receive
    REGISTER(0xE000E014u) = 0x00FFFFFFu;
    REGISTER(0xE000E018u) = 0;
    REGISTER(0xE000E010u) = 5; // SysTick, 25 MHz
}

int Port::available() { return (STATE & 2u) != 0; }

int Port::read() { return (int)(DATA & 0xFFu); }

size_t Port::write(const uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        while (STATE & 1u) {
        }
        DATA = bytes[i];
    }
    return size;
}

uint32_t micros()
{
    const uint32_t now = REGISTER(0xE000E018u);
    counted += (before - now) & 0x00FFFFFFu;
    before = now;
    return counted / 25u;
}

uint32_t millis() { return micros() / 1000u; }

extern "C" void halt() { for (;;) {} }

extern "C" void reset()
{
    REGISTER(0xE000ED88u) |= 0xFu << 20; // the floating-point unit
    __asm volatile("dsb\\n\\tisb");
    for (uint32_t *to = data_start, *from = data_source; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_start; to < bss_end;) *to++ = 0;
    setup();
    for (;;) loop();
}

extern "C" __attribute__((section(".vectors"), used)) void (*const vectors[16])() = {
    (void (*)())stack_top, reset, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, halt};
"""


def built(folder, unit, real, *defines):
    """Build the sketch of a unit; return the program."""
    text = CUnit(unit, real)
    files = {f"{unit.name}.h": text.header(), f"{unit.name}.c": text.source(), **programs(unit, real)}
    files |= {"Arduino.h": LIBRARY, "board.cpp": BOARD}
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    own = [flag for flag in FLAGS if flag != "-std=c99"]
    cpp = ["-std=c++17", "-fno-exceptions", "-fno-rtti", "-I.", *defines]
    subprocess.run(["arm-none-eabi-gcc", *FLAGS, "-c", f"{unit.name}.c", "-o", "unit.o"], cwd=folder, check=True)
    sketch = ["-x", "c++", f"{unit.name}_arduino.ino"]
    subprocess.run([COMPILER, *own, *cpp, "-c", *sketch, "-o", "sketch.o"], cwd=folder, check=True)
    subprocess.run([COMPILER, *own, *cpp, "-c", "board.cpp", "-o", "board.o"], cwd=folder, check=True)
    objects = ["unit.o", "sketch.o", "board.o"]
    subprocess.run([COMPILER, *own, *LINKED, *objects, "-lm", "-o", "sketch.elf"], cwd=folder, check=True)
    return folder / "sketch.elf"


def started(program, device, **options):
    """Run a program on a board whose UART is a device of this machine, or with `pty` a new one that it prints."""
    machine = [device if part == "stdio" else part for part in MACHINE]
    return subprocess.Popen([EMULATOR, *machine, "-kernel", program], stdin=subprocess.DEVNULL, **options)
