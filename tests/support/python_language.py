"""Graph nodes as Python: a second implementation of what every operation means."""

from masking.compile.codegen.printers import Language

PYTHON = Language(
    templates={
        **{f: f"math.{f}({{0}})" for f in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh")},
        **{f: f"math.{f}({{0}})" for f in ("tanh", "exp", "log")},
        "pow": "{0} ** {1}",
        "abs": "abs({0})",
        "sign": "np.sign({0})",
        "floor": "np.floor({0})",
        "min": "min({0}, {1})",
        "max": "max({0}, {1})",
        "atan2": "math.atan2({0}, {1})",
        "heaviside": "(0.5 if {0} == 0.0 else (1.0 if {0} > 0.0 else 0.0))",
        "where": "({1} if {0} else {2})",
        "lt": "({0} < {1})",
        "le": "({0} <= {1})",
    },
    declare="",
    end="",
)
