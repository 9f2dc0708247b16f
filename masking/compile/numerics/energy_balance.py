"""Energy balance: how much energy a masked motion has gained beyond what its virtual system gives it.

A passivity observer integrates the power of what differs from the virtual system's accelerations; a passivity
controller takes the surplus out again, as a damper that is negative where energy is missing.
Source: Hannaford and Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics and
Automation 18 (2002) 1-10.
"""
# ruff: noqa: ANN001, ANN202, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import Kernel
from masking.compile.numerics.compilation import compiled
from masking.compile.numerics.controller_sizes import Sizes
from masking.compile.numerics.runge_kutta import copy

AVERAGED = 0.25  # bandwidth of the mean of twice the kinetic energy, as a part of that of the power's filters


def energy_balance(virtual: Kernel, momentum: Kernel, sizes: Sizes) -> Kernel:
    """Make the step of the energy balance.

    With eta'' = D(eta, eta') + rho, the energy E of the virtual system changes by the power sum_i dE/deta_i' rho_i
    beyond what D does. A velocity that is estimated holds noise, and so does rho, with which it is correlated: both go
    through the same low-pass filter before they are multiplied. Its bandwidth is near the frequency
    of the motion, whose power it scales as it does the energy S = sum_i dE/deta_i' eta_i' that is compared.

    measured: from unfiltered estimates, the noise of the sensors alone multiplied the amplitude of clocks by 7.

    Args:
        virtual: `virtual(t, y, p, out)` writes eta, eta', D (k, each, per second), the bandwidth in 1/s, and the rate
            per unit of virtual time at which the surplus is taken out.
        momentum: `momentum(t, e, p, g)` writes dE/deta_i' (k,) at e = [eta, eta'], 0 for what is no oscillator.
        sizes: of the controller.

    Returns:
        `balance(t, h, y, memory, p, o, g) -> damping`, the damping per unit of virtual time for a state y at time t,
        with work space o (3 k + 2,) and g (k,). Until the release it remembers the motion and returns 0.
    """
    k = sizes.balanced

    @compiled
    def balance(t, h, y, memory, p, o, g):
        before, smooth, excess = memory[: 3 * k], memory[3 * k : 5 * k], memory[5 * k : 6 * k]
        virtual(t, y, p, o)
        damping = 0.0
        if t <= 0.0:
            copy(o, smooth, 2 * k)
            for i in range(k):
                excess[i] = 0.0
            memory[6 * k] = memory[6 * k + 1] = 0.0
        else:
            part = -math.expm1(-h * o[3 * k])
            for i in range(2 * k):
                smooth[i] += part * (0.5 * (before[i] + o[i]) - smooth[i])
            for i in range(k):
                rho = (o[k + i] - before[k + i]) / h - 0.5 * (before[2 * k + i] + o[2 * k + i])
                excess[i] += part * (rho - excess[i])
            momentum(t, smooth, p, g)
            surplus, level = memory[6 * k], 0.0
            for i in range(k):
                surplus += h * g[i] * excess[i]
                level += g[i] * smooth[k + i]
            memory[6 * k + 1] += AVERAGED * part * (level - memory[6 * k + 1])
            level = memory[6 * k + 1]
            memory[6 * k] = surplus = min(max(surplus, -level), level)
            if level > 0.0:
                damping = o[3 * k + 1] * surplus / level
        copy(o, before, 3 * k)
        return damping

    return balance
