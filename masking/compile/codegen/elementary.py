"""Elementary functions built from the vector operations of a processor.

They are right to three units in the last place where nothing else is said; sinh and cosh are infinite from 710 on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

# measured: element by element from the library, sin, cos, exp and log take a third of the time of a run of pendula.
# Source: fdlibm 5.3 (Sun Microsystems 1993), e_rem_pio2.c, k_sin.c, k_cos.c, e_exp.c, e_log.c, s_atan.c.
# A quarter of a turn in two parts, the first of 33 bits; sin x = x + x^3 (S1 + S2 x^2 + ...) and
# cos x = 1 - x^2/2 + x^4 (C1 + C2 x^2 + ...) to an eighth of a turn.
QUARTER = (1.57079632673412561417e00, 6.07710050650619224932e-11)
QUARTERS_IN_ONE = 6.36619772367581382433e-01
SINE: tuple[float, ...] = (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04)
SINE += (2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10)
COSINE: tuple[float, ...] = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05)
COSINE += (-2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11)
# log 2 in two parts, the first of 32 bits; x coth(x/2) = 2 + x^2 (P1 + P2 x^2 + ...), and with s = f / (2 + f)
# log(1 + f) = f - f^2/2 + s (f^2/2 + s^2 (L1 + L2 s^2 + ...)).
LOG_2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
ONE_BY_LOG_2 = 1.44269504088896338700e00
LONGEST, SHORTEST = 7.1e2, -7.46e2  # beyond these exp is infinite, or 0
EXP: tuple[float, ...] = (1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05)
EXP += (-1.65339022054652515390e-06, 4.13813679705723846039e-08)
LOG: tuple[float, ...] = (6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01)
LOG += (2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01)
SMALLEST_NORMAL, RAISED = 2.0**-1022, 54
# sinh x = x (1 + x^2/3! + x^4/5! + ...) to |x| = 1; tanh is 1 to the last bit beyond 22.
SINH = tuple(1.0 / math.factorial(2 * k + 1) for k in range(11))
TANH_IS_ONE = 22.0
# atan x = x - x (A1 x^2 + A2 x^4 + ...) to |x| = 7/16; below each bound of |x| it is atan c + atan((x - c) / (1 + c x))
# of a centre c, with atan c in two parts.
ATAN: tuple[float, ...] = (3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01)
ATAN += (-1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02)
ATAN += (6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02)
ATAN += (-3.65315727442169155270e-02, 1.62858201153657823623e-02)
ATAN_BOUNDS = (0.4375, 0.6875, 1.1875, 2.4375)
ATAN_CENTRES = (0.0, 0.5, 1.0, 1.5)
ATAN_OF_CENTRES: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
ATAN_OF_CENTRES += ((4.63647609000806093515e-01, 2.26987774529616870924e-17),)
ATAN_OF_CENTRES += ((7.85398163397448278999e-01, 3.06161699786838301793e-17),)
ATAN_OF_CENTRES += ((9.82793723247329054082e-01, 1.39033110312309984516e-17),)
# Minimax polynomials of log2(1 + f) to sqrt(2) and sqrt(1/2), and of 2^x to |x| = 1/2.
ROUGH_LOG2 = (4.764e-05, 1.4416386, -0.7259153, 0.5188850, -0.3264623)
ROUGH_EXP2 = (0.9999245, 0.6931053, 0.2426400, 0.0560058)
HALF_TURN = (3.14159265358979311600, 1.22464679914735317720e-16)

Apply = Callable[..., str]
Number = Callable[[float], str]


def sine_and_cosine(apply: Apply, number: Number, x: str) -> tuple[str, str]:
    """Sin x and cos x, to 1e6 right to two units in the last place or 1e-20; beyond, to two units of that of x.

    Beyond 1e15 rounding leaves nothing of the angle x but its bounds. `apply` returns the value of an operation, of its
    name and values, and `number` that of a constant.
    """
    turned = apply("floor", apply("add", apply("mul", x, number(QUARTERS_IN_ONE)), number(0.5)))
    angle = x
    for part in QUARTER:
        angle = apply("sub", angle, apply("mul", turned, number(part)))
    angle = apply("max", apply("min", angle, number(1.0)), number(-1.0))  # of no effect below 1e15
    square = apply("mul", angle, angle)
    cube, fourth = apply("mul", square, angle), apply("mul", square, square)
    sine = apply("add", angle, apply("mul", cube, _polynomial(apply, number, square, SINE)))
    less = apply("sub", number(1.0), apply("mul", square, number(0.5)))
    cosine = apply("add", less, apply("mul", fourth, _polynomial(apply, number, square, COSINE)))
    is_odd = apply("lt", number(0.5), _remainder(apply, number, turned, 2.0))
    quarter = _remainder(apply, number, turned, 4.0)
    is_below = apply("lt", number(1.5), quarter)
    is_behind = apply("lt", apply("abs", apply("sub", quarter, number(1.5))), number(1.0))
    found = apply("where", is_odd, cosine, sine), apply("where", is_odd, sine, cosine)
    signed = zip((is_below, is_behind), found, strict=True)
    first, second = (apply("where", is_negative, apply("neg", one), one) for is_negative, one in signed)
    return first, second


def exponential(apply: Apply, number: Number, x: str) -> str:
    """Exp x, right to a unit in the last place; arguments as those of `sine_and_cosine`."""
    x = apply("max", apply("min", x, number(LONGEST)), number(SHORTEST))
    turned = apply("floor", apply("add", apply("mul", x, number(ONE_BY_LOG_2)), number(0.5)))
    high = apply("sub", x, apply("mul", turned, number(LOG_2[0])))
    low = apply("mul", turned, number(LOG_2[1]))
    rest = apply("sub", high, low)
    square = apply("mul", rest, rest)
    even = apply("sub", rest, apply("mul", square, _polynomial(apply, number, square, EXP)))
    odd = apply("div", apply("mul", rest, even), apply("sub", number(2.0), even))
    found = apply("sub", number(1.0), apply("sub", apply("sub", low, odd), high))
    half = apply("floor", apply("mul", turned, number(0.5)))  # twice, since 2^1024 is no number
    for power in (half, apply("sub", turned, half)):
        found = apply("mul", found, apply("power_of_two", power))
    return found


def logarithm(apply: Apply, number: Number, x: str) -> str:
    """Log x, right to a unit in the last place; arguments as those of `sine_and_cosine`."""
    is_small = apply("lt", x, number(SMALLEST_NORMAL))
    normal = apply("where", is_small, apply("mul", x, number(2.0**RAISED)), x)
    exponent = apply("exponent", normal)
    exponent = apply("sub", exponent, apply("where", is_small, number(RAISED), number(0.0)))
    f = apply("sub", apply("significand", normal), number(1.0))
    s = apply("div", f, apply("add", number(2.0), f))
    square, half = apply("mul", s, s), apply("mul", apply("mul", f, f), number(0.5))
    series = apply("add", half, apply("mul", square, _polynomial(apply, number, square, LOG)))
    low = apply("add", apply("mul", s, series), apply("mul", exponent, number(LOG_2[1])))
    found = apply("sub", apply("mul", exponent, number(LOG_2[0])), apply("sub", apply("sub", half, low), f))
    none = apply("where", apply("lt", x, number(0.0)), number(math.nan), number(-math.inf))
    found = apply("where", apply("lt", number(0.0), x), found, none)
    return apply("where", apply("lt", x, number(math.inf)), found, x)


def rough_log2(apply: Apply, number: Number, x: str) -> str:
    """Log2 x of a normal x, right to 1e-4; arguments as those of `sine_and_cosine`."""
    series = _polynomial(apply, number, apply("sub", apply("significand", x), number(1.0)), ROUGH_LOG2)
    return apply("add", apply("exponent", x), series)


def rough_exp2(apply: Apply, number: Number, x: str) -> str:
    """2^x, right to a part of 1e-4, for |x| < 126; arguments as those of `sine_and_cosine`."""
    whole = apply("floor", apply("add", x, number(0.5)))
    series = _polynomial(apply, number, apply("sub", x, whole), ROUGH_EXP2)
    return apply("mul", apply("power_of_two", whole), series)


def tangent(apply: Apply, number: Number, x: str) -> str:
    """Tan x; arguments as those of `sine_and_cosine`."""
    return apply("div", *sine_and_cosine(apply, number, x))


def hyperbolic_sine(apply: Apply, number: Number, x: str) -> str:
    """Sinh x; arguments as those of `sine_and_cosine`."""
    near = apply("mul", x, _polynomial(apply, number, apply("mul", x, x), SINH))
    e = exponential(apply, number, x)
    far = apply("mul", number(0.5), apply("sub", e, apply("div", number(1.0), e)))
    return apply("where", apply("lt", apply("abs", x), number(1.0)), near, far)


def hyperbolic_cosine(apply: Apply, number: Number, x: str) -> str:
    """Cosh x; arguments as those of `sine_and_cosine`."""
    e = exponential(apply, number, x)
    return apply("mul", number(0.5), apply("add", e, apply("div", number(1.0), e)))


def hyperbolic_tangent(apply: Apply, number: Number, x: str) -> str:
    """Tanh x; arguments as those of `sine_and_cosine`."""
    x = apply("max", apply("min", x, number(TANH_IS_ONE)), number(-TANH_IS_ONE))
    return apply("div", hyperbolic_sine(apply, number, x), hyperbolic_cosine(apply, number, x))


def arc_tangent(apply: Apply, number: Number, x: str) -> str:
    """Atan x; arguments as those of `sine_and_cosine`."""
    size = apply("abs", x)
    above, below = number(-1.0), size  # beyond the last bound, a quarter of a turn and atan(-1 / |x|)
    high, low = (number(0.5 * part) for part in HALF_TURN)
    parts = [*zip(ATAN_BOUNDS, ATAN_CENTRES, ATAN_OF_CENTRES, strict=True)]
    for bound, centre, (first, second) in reversed(parts):
        is_here, c = apply("lt", size, number(bound)), number(centre)
        above = apply("where", is_here, apply("sub", size, c), above)
        below = apply("where", is_here, apply("add", number(1.0), apply("mul", c, size)), below)
        high, low = (apply("where", is_here, number(a), b) for a, b in ((first, high), (second, low)))
    rest = apply("div", above, below)
    square = apply("mul", rest, rest)
    series = apply("mul", rest, apply("mul", square, _polynomial(apply, number, square, ATAN)))
    found = apply("sub", high, apply("sub", apply("sub", series, low), rest))
    return apply("where", apply("lt", x, number(0.0)), apply("neg", found), found)


def arc_sine(apply: Apply, number: Number, x: str) -> str:
    """Asin x; arguments as those of `sine_and_cosine`."""
    square = apply("mul", apply("sub", number(1.0), x), apply("add", number(1.0), x))
    return arc_tangent(apply, number, apply("div", x, apply("sqrt", square)))


def arc_cosine(apply: Apply, number: Number, x: str) -> str:
    """Acos x; arguments as those of `sine_and_cosine`."""
    square = apply("div", apply("sub", number(1.0), x), apply("add", number(1.0), x))
    return apply("mul", number(2.0), arc_tangent(apply, number, apply("sqrt", square)))


def arc_tangent_of_two(apply: Apply, number: Number, y: str, x: str) -> str:
    """Angle of the point (x, y), 0 of none; arguments as those of `sine_and_cosine`."""
    zero = number(0.0)
    angle = arc_tangent(apply, number, apply("div", apply("abs", y), apply("abs", x)))
    is_none = apply("le", apply("add", apply("abs", x), apply("abs", y)), zero)
    angle = apply("where", is_none, zero, angle)
    behind = apply("sub", number(HALF_TURN[0]), apply("sub", angle, number(HALF_TURN[1])))
    angle = apply("where", apply("lt", x, zero), behind, angle)
    return apply("where", apply("lt", y, zero), apply("neg", angle), angle)


def _polynomial(apply: Apply, number: Number, x: str, coefficients: Sequence[float]) -> str:
    found = number(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        found = apply("add", apply("mul", found, x), number(coefficient))
    return found


def _remainder(apply: Apply, number: Number, x: str, divisor: float) -> str:
    whole = apply("floor", apply("mul", x, number(1.0 / divisor)))
    return apply("sub", x, apply("mul", whole, number(divisor)))
