"""Models with nonlinear forces, of time, or with nothing to hold them; and energies that are none."""

from tests.benchmarks.certificates.entry import BOUNDED, NONE, Entry, springs

PENDULUM = "x'**2/2 - cos(x)"
CRATE = {"parameters": {"k": 1, "g": 1}, "units": {"x": "m", "k": "1/m", "g": "m/s**2"}}

HIDDEN = {
    "Duffing oscillator that nothing reaches": Entry(
        {"x": "-x - x'", "y": "-y - y**3"},
        f"{springs('x', 'y')} + y**4/4",
        "x",
        "y is on its own",
        (0, 1, 0, 0),
    ),
    "cubic coupling to a damped mass": Entry(
        {"x": "-x - x' - (x - y)**3", "y": "-y + (x - y)**3"},
        f"{springs('x', 'y')} + (x - y)**4/4",
        "x, y",
        "where x = 0, y^3 = 0",
        duration=1500,
        near=0.5,
    ),
    "two Duffing oscillators, damper between": Entry(
        {"x": "-x - x**3 - 0.3*(x' - y')", "y": "-y - y**3 + 0.3*(x' - y')"},
        f"{springs('x', 'y')} + x**4/4 + y**4/4",
        "x - y",
        "x = y + c: c + (y + c)^3 - y^3 = 0 for all y: c = 0",
        (1, 1, 0, 0),
    ),
    "two unlike Duffing oscillators, damper between": Entry(
        {"x": "-x - x**3 - 0.3*(x' - y')", "y": "-y - 2*y**3 + 0.3*(x' - y')"},
        f"{springs('x', 'y')} + x**4/4 + y**4/2",
        "x, y",
        "x = y + c: 2 y^3 - (y + c)^3 - c vanishes for no c and all y",
        duration=1500,
        near=0.5,
    ),
    "three Duffing oscillators on a beam": Entry(
        {f"x{i}": f"-(x{i} - x4) - (x{i} - x4)**3" for i in (1, 2, 3)}
        | {"x4": " + ".join(f"(x{i} - x4) + (x{i} - x4)**3" for i in (1, 2, 3)) + " - x4 - x4'"},
        " + ".join(f"x{i}'**2/2 + (x{i} - x4)**2/2 + (x{i} - x4)**4/4" for i in (1, 2, 3)) + " + (x4'**2 + x4**2)/2",
        "x4, x1, x2 + x3 | x4, x2, x1 + x3 | x4, x3, x1 + x2",
        "the sums of x and of x^3 are 0: so is the product of all x",
        (1, -1, 0, 0, 0, 0, 0, 0),
        duration=1000,
        near=0.7,
    ),
}

TIME = {
    "Mathieu's equation": Entry(
        {"x": "-x*(1 + 0.5*cos(2*t)) - 0.1*x'"}, springs("x"), NONE, "the first tongue", (0.1, 0), duration=100
    ),
    "damping that changes its sign in time": Entry(
        {"x": "-x - (0.1 + 2*sin(2*t))*x'"}, springs("x"), NONE, "parametric excitation", (0.1, 0.1), duration=60
    ),
    "a drive": Entry({"x": "-x - 0.1*x' + cos(2*t)"}, springs("x"), NONE, "a periodic motion", (0, 0)),
    "stiffness that grows to 1": Entry(
        {"x": "-(1 - exp(-t)/2)*x - 0.2*x'"}, springs("x"), "x", "an integrable disturbance of a stable oscillator"
    ),
}

FREE = {
    "two free masses, damper between": Entry(
        {"x": "-0.2*(x' - y')", "y": "0.2*(x' - y')"}, "(x'**2 + y'**2)/2", NONE, "momentum", (0, 0, 1, 1)
    ),
    "two free masses, spring and damper between": Entry(
        "(x'**2 + y'**2 - (x - y)**2)/2", "", NONE, "momentum", (0, 0, 1, 1), dissipation="0.2*(x' - y')**2/2"
    ),
    "free mass in oil": Entry({"x": "-0.5*x'"}, "x'**2/2", "x'", "x' = e^(-t/2): rest anywhere", units={"x": "m"}),
    "free disc in oil": Entry({"x": "-0.5*x'"}, "x'**2/2", "x'", "as the mass", units={"x": "rad"}),
    "free mass in oil beside an oscillator": Entry(
        {"x": "-0.5*x'", "y": "-y"}, "(x'**2 + y'**2 + y**2)/2", "x'", "as the mass", (0, 1, 0, 0)
    ),
    "carriage with an oscillator, in oil": Entry(
        {"x": "-(x - y)", "y": "x - y - 0.4*y'"},
        "(x'**2 + y'**2 + (x - y)**2)/2",
        "x - y, x'",
        "y'' is the damping: y' = 0, then x - y = 0",
    ),
    "free carriage with a pendulum, joint damped": Entry(
        "x'**2 + x'*th'*cos(th) + th'**2/2 + cos(th)",
        "",
        NONE,
        "momentum",
        (0, 0, 1, 0),
        dissipation="0.2*th'**2/2",
        units={"th": "rad"},
    ),
    "egg crate in metres": Entry(
        {"x": "-g*sin(k*x)"}, "x'**2/2 - g*cos(k*x)/k", NONE, "x' = 3 is too fast for the crests", (0, 3), **CRATE
    ),
    "egg crate in metres, damped": Entry(
        {"x": "-g*sin(k*x) - d*x'"},
        "x'**2/2 - g*cos(k*x)/k",
        "rest",
        "x'^2/2 - cos x falls and is above -1",
        size=3.0,
        parameters=CRATE["parameters"] | {"d": 0.2},
        units=CRATE["units"] | {"d": "1/s"},
    ),
    "rotor with a constant torque": Entry(
        {"x": "1.5 - sin(x) - 0.1*x'"}, f"{PENDULUM} - 1.5*x", NONE, "no equilibrium", (0, 0), units={"x": "rad"}
    ),
    "rotor with a small constant torque": Entry(
        {"x": "0.5 - sin(x) - 0.1*x'"},
        f"{PENDULUM} - 0.5*x",
        NONE,
        "turns at x' = 5, too fast for the crests",
        (0, 5),
        units={"x": "rad"},
    ),
}

NEGATIVE = {
    "double well": Entry(
        {"x": "x - x**3 - 0.2*x'"}, "x'**2/2 - x**2/2 + x**4/4", "x | x - 1 | x + 1", "V' = -0.2 x'^2"
    ),
    "two coupled double wells": Entry(
        {"x": "x - x**3 - 0.1*(x - y) - 0.2*x'", "y": "y - y**3 + 0.1*(x - y) - 0.2*y'"},
        "(x'**2 + y'**2 - x**2 - y**2)/2 + (x**4 + y**4)/4 + 0.1*(x - y)**2/2",
        "rest",
        "V' = -0.2 (x'^2 + y'^2)",
    ),
    "negative stiffness": Entry({"x": "x - 0.2*x'"}, "(x'**2 - x**2)/2", NONE, "grows", (0.1, 0)),
    "Henon and Heiles, damped": Entry(
        {"x": "-x - 2*x*y - 0.1*x'", "y": "-y - x**2 + y**2 - 0.1*y'"},
        f"{springs('x', 'y')} + x**2*y - y**3/3",
        NONE,
        "escapes over the saddle y = 1",
        (0, 1.2, 0, 0.5),
        size=0.3,
    ),
    "stiffness that weakens": Entry(
        {"x": "-x/(1 + x**2)**2 - 0.1*x'**3"},
        "x'**2/2 - 1/(2*(1 + x**2))",
        NONE,
        "energy above 0: x' = 1/sqrt(0.2 t), x grows as sqrt(t)",
        (0, 4),
        duration=500,
    ),
    "inverted pendulum on a spring": Entry(
        {"x": "sin(x) - 2*x - 0.2*x'"}, "x'**2/2 + cos(x) + x**2", "x", "sin x = 2 x for x = 0 alone"
    ),
    "pitchfork, at the point": Entry(
        {"x": "-x**3 - 0.5*x'"}, "x'**2/2 + x**4/4", "x", "V' = -0.5 x'^2", duration=2000, near=0.1
    ),
}

FRICTION = {
    "dry friction": Entry(
        {"x": "-x - 0.1*sign(x')"}, springs("x"), BOUNDED, "sticks where |x| < 0.1", is_rough=True, duration=60
    ),
    "dry friction on one of two": Entry(
        {"x": "-2*x + y - 0.1*sign(x')", "y": "-2*y + x"},
        "(x'**2 + y'**2 + x**2 + y**2 + (x - y)**2)/2",
        BOUNDED,
        "y swings by itself while x sticks",
        (0, 0.05, 0, 0),
        is_rough=True,
        duration=60,
    ),
    "friction by tanh": Entry({"x": "-x - 0.1*tanh(5*x')"}, springs("x"), "x", "V' = -0.1 x' tanh(5 x')"),
    "friction by tanh on one of two": Entry(
        {"x": "-2*x + y - 0.1*tanh(5*x')", "y": "-2*y + x"},
        "(x'**2 + y'**2 + x**2 + y**2 + (x - y)**2)/2",
        "x, y",
        "x' = 0, then y = 2 x is constant, then x = 2 y",
        duration=400,
    ),
    "stick-slip on a belt": Entry(
        {"x": "-x - 0.3*tanh(20*(x' - 0.5))*(1 + 2*exp(-(x' - 0.5)**2*25))"},
        springs("x"),
        NONE,
        "friction falls with speed",
        (0.1, 0),
    ),
    "drag": Entry({"x": "-x - 0.3*x'*abs(x')"}, springs("x"), "x", "V' = -0.3 |x'|^3", duration=1000, near=0.05),
    "damping by the cube": Entry(
        {"x": "-x - 0.5*x'**3"}, springs("x"), "x", "V' = -0.5 x'^4", duration=1500, near=0.05
    ),
    "damping by the cube on both": Entry(
        {"x": "-x - x'**3/10", "y": "-y - y'**3"},
        springs("x", "y"),
        "x, y",
        "V' = -x'^4/10 - y'^4",
        duration=1500,
        near=0.2,
    ),
    "damping by the cube between two": Entry(
        {"x": "-x - 0.5*(x' - y')**3", "y": "-y + 0.5*(x' - y')**3"},
        springs("x", "y"),
        "x - y",
        "V' = -(x' - y')^4/2",
        (1, 1, 0, 0),
        duration=1500,
        near=0.05,
    ),
    "linear and cubic damping": Entry({"x": "-x - 0.1*x' - x'**3"}, springs("x"), "x", "V' = -0.1 x'^2 - x'^4"),
}

SELF_EXCITED = {
    "van der Pol": Entry({"x": "-x + 0.5*(1 - x**2)*x'"}, springs("x"), NONE, "a limit cycle (Lienard)", (0.1, 0)),
    "Rayleigh": Entry({"x": "-x + 0.5*x' - x'**3"}, springs("x"), NONE, "a limit cycle (Lienard)", (0.1, 0)),
    "van der Pol backwards": Entry(
        {"x": "-x - 0.5*(1 - x**2)*x'"}, springs("x"), NONE, "outside of the cycle all grows", (4, 0), duration=5
    ),
    "van der Pol held by a damped mass": Entry(
        {"x": "-x + 0.2*(1 - x**2)*x' - (x - y)", "y": "-y + (x - y) - 0.1*y'"},
        f"{springs('x', 'y')} + (x - y)**2/2",
        NONE,
        "one eigenvalue to the right",
        (0.1, 0.1, 0, 0),
    ),
    "damping by place, positive": Entry({"x": "-x - 0.2*(1 + x**2)*x'"}, springs("x"), "x", "V' = -0.2 (1 + x^2) x'^2"),
    "damping by place, 0 in the middle": Entry(
        {"x": "-x - 0.5*x**2*x'"}, springs("x"), "x", "V' = -0.5 x^2 x'^2", duration=1500, near=0.1
    ),
    "damping by place, of both signs": Entry(
        {"x": "-x - 0.3*cos(x)*x'"}, springs("x"), NONE, "a limit cycle near 2.4 (averaging)", (4, 0)
    ),
    "damping by place that fades": Entry(
        {"x": "-x - 0.3*exp(-x**2)*x'"}, springs("x"), "x", "V' = -0.3 exp(-x^2) x'^2"
    ),
    "damping by the place of the other": Entry(
        {"x": "-x - (1 + y**2)*x'", "y": "-2*y - y'"},
        "(x'**2 + y'**2 + x**2 + 2*y**2)/2",
        "x, y",
        "V' = -(1 + y^2) x'^2 - y'^2",
    ),
    "damper at an angle by place": Entry(
        {"x": "-x - 0.2*(x' + y'*cos(x))", "y": "-2*y - 0.2*cos(x)*(x' + y'*cos(x)) - 0.1*y'"},
        "(x'**2 + y'**2 + x**2 + 2*y**2)/2",
        "x, y",
        "V' = -0.2 (x' + y' cos x)^2 - 0.1 y'^2",
    ),
}

RAD = {"x": "rad", "y": "rad"}
PENDULA = {
    "pendulum, damped": Entry({"x": "-sin(x) - 0.2*x'"}, PENDULUM, "rest", "V' = -0.2 x'^2", units=RAD, size=3.0),
    "pendulum": Entry({"x": "-sin(x)"}, PENDULUM, BOUNDED, "energy", (1, 0), units=RAD),
    "two pendula, damper between": Entry(
        {"x": "-sin(x) - 0.2*(x' - y')", "y": "-sin(y) + 0.2*(x' - y')"},
        "(x'**2 + y'**2)/2 - cos(x) - cos(y)",
        "sin((x - y)/2) | rest",
        "x - y = c, sin(y + c) = sin(y) for all y, or rest",
        (1, 1, 0, 0),
        units=RAD,
    ),
    "two unlike pendula, damper between": Entry(
        {"x": "-sin(x) - 0.4*(x' - y')", "y": "-2*sin(y) + 0.4*(x' - y')"},
        "(x'**2 + y'**2)/2 - cos(x) - 2*cos(y)",
        "rest",
        "x - y = c, 2 sin(y + c) = sin(y) for no c and all y",
        units=RAD,
        duration=600,
    ),
    "two pendula, spring and damper on one": Entry(
        {"x": "-sin(x) - (x - y) - 0.4*x'", "y": "-sin(y) + (x - y)"},
        "(x'**2 + y'**2 + (x - y)**2)/2 - cos(x) - cos(y)",
        "rest",
        "x = c: y = sin c + c is constant",
        units=RAD,
        duration=600,
    ),
    "double pendulum, joints damped": Entry(
        "x'**2 + y'**2/2 + x'*y'*cos(x - y) + 2*cos(x) + cos(y)",
        "",
        "rest",
        "V' = -0.2 x'^2 - 0.2 (x' - y')^2",
        units=RAD,
        dissipation="0.2*x'**2/2 + 0.2*(x' - y')**2/2",
        duration=200,
    ),
    "double pendulum": Entry(
        "x'**2 + y'**2/2 + x'*y'*cos(x - y) + 2*cos(x) + cos(y)", "", BOUNDED, "energy", (1, 1, 0, 0), units=RAD
    ),
    "pendulum on a damped carriage": Entry(
        "x'**2 + x'*th'*cos(th) + th'**2/2 + cos(th) - x**2/2",
        "",
        "rest",
        "x = c: the pendulum's reaction is constant, which is at rest alone",
        dissipation="0.4*x'**2/2",
        units={"th": "rad"},
        duration=600,
    ),
    "spherical bowl, damped": Entry(
        "(x'**2 + y'**2)*(1 + x**2 + y**2)/2 - (x**2 + y**2)/2",
        "",
        "x, y",
        "V' = -0.3 (x'^2 + y'^2)",
        dissipation="0.3*(x'**2 + y'**2)/2",
    ),
}

CONSERVATIVE = {
    "Duffing oscillator": Entry({"x": "-x - x**3"}, f"{springs('x')} + x**4/4", BOUNDED, "energy", (1, 0)),
    "two coupled oscillators": Entry(
        {"x": "-2*x + y", "y": "-2*y + x"},
        "(x'**2 + y'**2 + x**2 + y**2 + (x - y)**2)/2",
        BOUNDED,
        "energy",
        (1, 0, 0, 0),
    ),
    "Henon and Heiles": Entry(
        {"x": "-x - 2*x*y", "y": "-y - x**2 + y**2"},
        f"{springs('x', 'y')} + x**2*y - y**3/3",
        NONE,
        "escapes over the saddle y = 1",
        (0, 1.2, 0, 0.5),
        size=0.2,
    ),
    "a mass that is free": Entry({"x": "0*x"}, "x'**2/2", NONE, "x = v t", (0, 1), units={"x": "m"}),
    "exponential wall": Entry({"x": "exp(-x)"}, "x'**2/2 + exp(-x)", NONE, "leaves to infinity", (0, 0)),
}

WRONG_ENERGY = {
    "negative energy of growth": Entry({"x": "-x + x'"}, "-(x'**2 + x**2)/2", NONE, "grows", (0.1, 0), duration=20),
    "kinetic energy of both signs": Entry(
        {"x": "-x - x**3 - x'", "y": "y + y**3 + y'", "z": "z + z**3 + z'"},
        "(x'**2 + x**2 - y'**2 + y**2 - z'**2 + z**2)/2 + (x**4 + y**4 + z**4)/4",
        NONE,
        "y and z grow",
        (0, 0.1, 0.1, 0, 0, 0),
        duration=3,
    ),
    "negative kinetic energy": Entry(
        {"x": "x + x**3 + x'"}, "-x'**2/2 + x**2/2 + x**4/4", NONE, "grows", (0.1, 0), duration=2
    ),
    "0 as an energy": Entry({"x": "-x + x'"}, "0*x", NONE, "grows", (0.1, 0), duration=20),
    "energy of one of two": Entry(
        {"x": "-x - x'", "y": "y"}, springs("x"), NONE, "y grows", (0, 0.1, 0, 0), duration=20
    ),
    "cubic spring left out": Entry({"x": "-x - x**3 - x'"}, springs("x"), "x", "V' with x^4/4 is -x'^2"),
    "stiffness of another spring": Entry({"x": "-2*x - 0.2*x'"}, springs("x"), "x", "eigenvalues"),
    "sign of a coupling": Entry(
        {"x": "-x + 2*y - 0.1*x'", "y": "-y + 2*x - 0.1*y'"}, springs("x", "y"), NONE, "grows", (0.1, 0.1, 0, 0)
    ),
    "energy without kinetic energy": Entry({"x": "-x - x'"}, "x**2/2", "x", "eigenvalues"),
    "energy that jumps": Entry({"x": "-x - x'"}, f"{springs('x')} + heaviside(x)", "x", "eigenvalues"),
    "quadratic form that is no energy": Entry({"x": "-x - x'"}, "(x'**2 + x*x' + 1.5*x**2)/2", "x", "eigenvalues"),
    "no energy": Entry({"x": "-x - x'"}, "", "x", "eigenvalues"),
    "momentum squared": Entry({"x": "y - x", "y": "x - y"}, "(x' + y')**2/2", NONE, "drifts", (0, 0, 1, 1)),
}
