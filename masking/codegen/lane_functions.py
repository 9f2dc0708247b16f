"""Functions of mathematics in lanes, of the operations that a processor has for vectors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

# measured: element by element from the library, sines and cosines take a fifth of the time of a run of pendula.
# Source: fdlibm 5.3 (Sun Microsystems 1993), e_rem_pio2.c, k_sin.c, k_cos.c: a quarter of a turn in two parts, the first
# of 33 bits; sin x = x + x^3 (S1 + S2 x^2 + ...) and cos x = 1 - x^2/2 + x^4 (C1 + C2 x^2 + ...) to an eighth of a turn.
QUARTER = (1.57079632673412561417e00, 6.07710050650619224932e-11)
QUARTERS_IN_ONE = 6.36619772367581382433e-01
SINE = (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04)
SINE += (2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10)
COSINE = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05)
COSINE += (-2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11)

Apply = Callable[..., str]
Number = Callable[[float], str]


def sine_and_cosine(apply: Apply, number: Number, x: str) -> tuple[str, str]:
    """Return sin x and cos x, right to two units in the last place of x or of the result.

    Args:
        apply: returns the value of an operation, of its name and values.
        number: returns the value of a constant.
        x: the value of the angle; beyond 1e15 rounding leaves nothing of it.
    """
    turned = apply("floor", apply("add", apply("mul", x, number(QUARTERS_IN_ONE)), number(0.5)))
    angle = x
    for part in QUARTER:
        angle = apply("sub", angle, apply("mul", turned, number(part)))
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


def _polynomial(apply: Apply, number: Number, x: str, coefficients: Sequence[float]) -> str:
    found = number(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        found = apply("add", apply("mul", found, x), number(coefficient))
    return found


def _remainder(apply: Apply, number: Number, x: str, divisor: float) -> str:
    whole = apply("floor", apply("mul", x, number(1.0 / divisor)))
    return apply("sub", x, apply("mul", whole, number(divisor)))
