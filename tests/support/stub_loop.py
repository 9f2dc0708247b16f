"""A loop whose rows are known: two oscillators in anti-phase at 1 kHz, until its switch is pressed.

`python -m tests.support.stub_loop [seconds] [--die] [--attended]` prints the paths of its ring and of its switch, and,
when it ends, in which row, how many rows after the switch was pressed, and how late its ticks were.
"""

import json
import math
import sys
import time

import numpy as np

from masking.lab.records.ring import Ring
from masking.lab.records.stop_switch import Switch

RATE, HERTZ, BEFORE = 1000.0, 1.25, 500
COLUMNS = ("index", "rig.x1", "rig.x2", "virtual.th1", "virtual.th2", "sensor.s1", "applied.V1", "power.V1", "late",
           "duration")  # fmt: skip
BOUNDS = [
    {"kind": "limit", "label": "x1", "unit": "m", "bound": 0.005, "weights": {"rig.x1": 1.0}},
    {"kind": "limit", "label": "x2", "unit": "m", "bound": 0.005, "weights": {"rig.x2": 1.0}},
    {"kind": "limit", "label": "x1 - x2", "unit": "m", "bound": 0.0085, "weights": {"rig.x1": 1.0, "rig.x2": -1.0}},
    {"kind": "command", "label": "V1", "unit": "V", "bound": 2.0, "weights": {"applied.V1": 1.0}},
    {"kind": "heat", "label": "V1", "unit": "W", "bound": 8.0, "weights": {"power.V1": 1.0}},
]


def row(n):
    """Return row n, as a closed form."""
    t = (n - BEFORE) / RATE
    phase = 2.0 * math.pi * HERTZ * t
    x1, x2 = 0.0036 * math.sin(phase), -0.0035 * math.sin(phase)
    duration = 6e-6 * (1.0 + 0.4 * math.sin(n * 0.7) + (3.0 if n % 97 == 0 else 0.0))
    heat = 3.0 * (1.0 - math.exp(-max(t, 0.0) / 6.0))
    return (n - BEFORE, x1, x2, 0.24 * math.sin(phase), -0.233 * math.sin(phase), 2.5 * x1, 0.9 * math.cos(phase), heat,
            float(n % 5000 == 4999), duration)  # fmt: skip


def main():
    seconds = float(sys.argv[1])
    units = {"rig.x1": "m", "rig.x2": "m", "virtual.th1": "rad", "virtual.th2": "rad", "power.V1": "W"}
    facts = {"name": "huygens on a rig", "plant": "TU/e rig at udp://127.0.0.1:5005", "pair": ["th1", "th2"]}
    switch = Switch.make()
    ring = Ring(COLUMNS, RATE, units, **facts, bounds=BOUNDS, attended=False)
    print(json.dumps([str(ring.path), str(switch.path)]), flush=True)
    begun, n, pressed_at, seen = time.perf_counter(), 0, None, 0
    late = np.zeros(int(seconds * RATE))
    while n < len(late):
        due = begun + n / RATE
        time.sleep(max(0.0, due - time.perf_counter()))
        late[n] = time.perf_counter() - due
        if switch.pressed:
            pressed_at = time.monotonic()
            break
        seen = switch.seen
        ring.put(np.array(row(n)))
        n += 1
    if "--die" in sys.argv:
        import os

        os.kill(os.getpid(), 9)
    if switch.pressed:
        sentence = f"tick {n}: ESTOP: the emergency stop was pressed; release it once the rig is safe"
        switch.publish(end="tripped", trip={"cause": "ESTOP", "tick": n, "sentence": sentence})
    else:
        switch.publish(end="finished")
    ring.close()
    switch.remove()
    told = {"rows": n, "stopped": pressed_at, "seen": seen, "p99": float(np.quantile(late[: max(n, 1)], 0.99))}
    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
