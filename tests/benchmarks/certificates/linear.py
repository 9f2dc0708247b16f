"""Linear models, coincidences of numbers, and forces with corners."""

import itertools

from tests.benchmarks.certificates.entry import BOUNDED, NONE, Entry, springs


def beam(first, second, third="x3 + x3'", **more):
    """Return two unit masses on springs to a beam that is damped."""
    return Entry(
        {"x1": f"-({first})", "x2": f"-({second})", "x3": f"{first} + {second} - ({third})"},
        **more,
    )


def chain(count, damped):
    """Return equal masses between walls, all springs 1, one of them damped."""
    x = [f"x{i + 1}" for i in range(count)]
    kinetic = " + ".join(f"{a}'**2" for a in x)
    stretch = " + ".join([f"{x[0]}**2", *(f"({a} - {b})**2" for a, b in itertools.pairwise(x)), f"{x[-1]}**2"])
    return {
        "equations": f"({kinetic} - {stretch.replace(' + ', ' - ')})/2",
        "energy": "",
        "dissipation": f"0.4*x{damped}'**2/2",
    }


NODE = "modes of a chain are sin(j k pi/(n + 1)): those with a node at the damper stay"

LINEAR = {
    "one oscillator": Entry({"x": "-x - 0.2*x'"}, springs("x"), "x", "eigenvalues"),
    "two masses, damper on one": Entry(
        {"x": "-2*x + y - 0.3*x'", "y": "-2*y + x"},
        "(x'**2 + y'**2 + x**2 + y**2 + (x - y)**2)/2",
        "x, y",
        "eigenvalues",
    ),
    "two equal oscillators, damper between": Entry(
        {"x": "-x - 0.2*(x' - y')", "y": "-y + 0.2*(x' - y')"}, springs("x", "y"), "x - y", "eigenvalues", (1, 1, 0, 0)
    ),
    "damper between unlike oscillators": Entry(
        {"x": "-x - 0.4*(x' - y')", "y": "-2*y + 0.4*(x' - y')"},
        "(x'**2 + y'**2 + x**2 + 2*y**2)/2",
        "x, y",
        "eigenvalues",
    ),
    "chain of three, damper in the node": Entry(
        **chain(3, 2), truth="x1 + x3, x2", why=NODE, start=(1, 0, -1, 0, 0, 0)
    ),
    "chain of three, damper at the end": Entry(**chain(3, 1), truth="x1, x2, x3", why=NODE),
    "chain of three, one heavier": Entry(
        "(x1'**2 + x2'**2 + 1.1*x3'**2 - x1**2 - (x1 - x2)**2 - (x2 - x3)**2 - x3**2)/2",
        "",
        "x1, x2, x3",
        "eigenvalues",
        dissipation="0.4*x2'**2/2",
        duration=2e4,
    ),
    "chain of five, damper in the middle": Entry(
        **chain(5, 3), truth="x3, x1 + x5, x2 + x4", why=NODE, start=(1, 0, 0, 0, -1, 0, 0, 0, 0, 0), duration=400
    ),
    "chain of five, damper on the second": Entry(
        **chain(5, 2),
        truth="x2, x4, x1 + x3, x3 + x5",
        why=NODE,
        start=(1, 0, -1, 0, 1, 0, 0, 0, 0, 0),
        duration=400,
    ),
    "light damping": Entry({"x": "-x - 1e-4*x'"}, springs("x"), "x", "eigenvalues", duration=1e5),
    "masses from micro to mega": Entry(
        "(1e-6*x'**2 + 1e6*y'**2 - x**2 - 1e6*(x - y)**2 - 1e6*y**2)/2",
        "",
        "x, y",
        "eigenvalues",
        dissipation="1e-3*x'**2/2 + 1e6*y'**2/2",
        duration=12,
    ),
    "three equal oscillators on a beam": Entry(
        {
            "x1": "-(x1 - x4)",
            "x2": "-(x2 - x4)",
            "x3": "-(x3 - x4)",
            "x4": "x1 + x2 + x3 - 3*x4 - x4 - x4'",
        },
        "(x1'**2 + x2'**2 + x3'**2 + x4'**2 + (x1 - x4)**2 + (x2 - x4)**2 + (x3 - x4)**2 + x4**2)/2",
        "x4, x1 + x2 + x3",
        "eigenvalues",
        (1, -1, 0, 0, 0, 0, 0, 0),
    ),
    "rest away from 0": Entry(
        {"x": "-2*x + y + 3 - 0.3*x'", "y": "-2*y + x - 0.1*y'"},
        "(x'**2 + y'**2 + x**2 + y**2 + (x - y)**2)/2 - 3*x",
        "x - 2, y - 1",
        "2 x - y = 3, 2 y = x",
    ),
    "input at rest": Entry({"x": "-x - 0.2*x' + u"}, springs("x"), "x", "eigenvalues without the input", inputs=("u",)),
}

BEAM_ENERGY = "(x1'**2 + x2'**2 + x3'**2 + x3**2 + {0}*(x1 - x3)**2 + {1}*(x2 - x3)**2)/2"
CUBIC = "(1.1*(x1 - x3) + {0}*(x1 - x3)**3)", "(1.1*(x2 - x3) + {1}*(x2 - x3)**3)"
CUBIC_ENERGY = BEAM_ENERGY.format(1.1, 1.1) + " + ({0})*(x1 - x3)**4/4 + ({1})*(x2 - x3)**4/4"
ANTI = {"truth": "x3, x1 + x2", "start": (1, -1, 0, 0, 0, 0)}
FIVE = {"a": 0.1, "d": 0.2, "c": 0.3}


def thirds(one, two, **more):
    """Return two oscillators on a beam whose springs are spelt."""
    return beam(f"{one}*(x1 - x3)", f"{two}*(x2 - x3)", energy=BEAM_ENERGY.format(one, two), **more)


COINCIDENCES = {
    "masses and springs in one ratio": Entry(
        "(0.1*x1'**2 + 0.7*x2'**2 + x3'**2 - 0.3*(x1 - x3)**2 - 2.1*(x2 - x3)**2 - 90*x3**2)/2",
        "",
        "x3, 0.3*x1 + 2.1*x2",
        "k/m = 3 for both",
        (7, -1, 0, 0, 0, 0),
        dissipation="0.8*x3'**2/2",
        duration=3e4,
    ),
    "springs of the issue": Entry(
        "(m1*x1'**2 + m2*x2'**2 + x3'**2 - k1*(x1 - x3)**2 - k2*(x2 - x3)**2 - 90*x3**2)/2",
        "",
        "x3, 7.38*x1 + 10.44*x2",
        "k/m = 180 for both",
        (10.44, -7.38, 0, 0, 0, 0),
        parameters={"m1": 0.041, "k1": 7.38, "m2": 0.058, "k2": 10.44},
        dissipation="0.8*x3'**2/2",
        duration=400,
    ),
    "a spring by the mass of its oscillator": Entry(
        "(0.041*x1'**2 + m2*x2'**2 + x3'**2 - 7.38*(x1 - x3)**2 - k2*(x2 - x3)**2 - 90*x3**2)/2",
        "",
        "x3, 7.38*x1 + 10.44*x2",
        "k/m = 180 for both",
        (10.44, -7.38, 0, 0, 0, 0),
        parameters={"m2": 0.058, "k2": "180*m2"},
        dissipation="0.8*x3'**2/2",
        duration=400,
    ),
    "springs that differ by 1e-4": Entry(
        "(0.041*x1'**2 + 0.058*x2'**2 + x3'**2 - 7.38*(x1 - x3)**2 - k2*(x2 - x3)**2 - 90*x3**2)/2",
        "",
        "x1, x2, x3",
        "eigenvalues",
        parameters={"k2": 10.441},
        dissipation="0.8*x3'**2/2",
        duration=1e9,
    ),
    "a third as 1/3 and 3.0": thirds("(1/3)", "(1/3.0)", why="equal springs", duration=400, **ANTI),
    "0.3 as 0.1*3": thirds("0.3", "(0.1*3)", why="equal springs", duration=400, **ANTI),
    "7 as 0.7/0.1": thirds("7", "(0.7/0.1)", why="equal springs", duration=1000, **ANTI),
    "0.1 as a root": thirds("0.1", "sqrt(0.01)", why="equal springs", duration=2000, **ANTI),
    "0.3 in a definition": beam(
        "g*(x1 - x3)",
        "0.3*(x2 - x3)",
        energy=BEAM_ENERGY.format("g", 0.3),
        definitions={"g": "a + d"},
        parameters={"a": 0.1, "d": 0.2},
        why="equal springs",
        duration=400,
        **ANTI,
    ),
    "cubic springs that agree": beam(
        *(x.format("(a + d)", "c") for x in CUBIC),
        energy=CUBIC_ENERGY.format("a + d", "c"),
        parameters=FIVE,
        why="theorem 7.1 of the source document",
        near=0.1,
        **ANTI,
    ),
    "cubic springs that differ": beam(
        *(x.format("0.3", "0.9") for x in CUBIC),
        energy=CUBIC_ENERGY.format("0.3", "0.9"),
        truth="x1, x2, x3",
        why="1.1 d + 0.3 d^3 and 1.1 d + 0.9 d^3 are the same for d = 0 alone",
        duration=600,
        near=0.6,
    ),
    "springs that differ by 1e-10": thirds(
        "1.1", "1.1000000001", truth="x1, x2, x3", why="slowly, in 1e20 periods", duration=0
    ),
    "a gyroscopic force that is 0": Entry(
        {"x": "-x + (a + d - c)*y' - x'/2", "y": "-2*y - (a + d - c)*x'"},
        "(x'**2 + y'**2 + x**2 + 2*y**2)/2",
        "x",
        "0.1 + 0.2 - 0.3 = 0: y is on its own",
        (0, 1, 0, 0),
        parameters=FIVE,
    ),
    "a damper that is 0": Entry(
        {"x": "-x - (a + d - c)*x'"}, springs("x"), BOUNDED, "0.1 + 0.2 - 0.3 = 0", (1, 0), parameters=FIVE
    ),
    "dampers that are semidefinite": Entry(
        {"x": "-x - 0.1*x' - 0.2*y'", "y": "-y - 0.2*x' - 0.4*y'"},
        springs("x", "y"),
        "0.1*x + 0.2*y",
        "0.2^2 = 0.1 0.4",
        (2, -1, 0, 0),
    ),
    "dampers that are definite": Entry(
        {"x": "-x - 0.1*x' - 0.19*y'", "y": "-y - 0.19*x' - 0.4*y'"},
        springs("x", "y"),
        "x, y",
        "0.19^2 < 0.1 0.4",
        duration=4000,
    ),
    "dampers in parameters that are semidefinite": Entry(
        {"x": "-x - a*x' - c*y'", "y": "-y - c*x' - b*y'"},
        springs("x", "y"),
        "0.1*x + 0.2*y",
        "0.2^2 = 0.1 0.4",
        (2, -1, 0, 0),
        parameters={"a": 0.1, "b": 0.4, "c": 0.2},
    ),
    "a force that feeds energy in, times 0": Entry(
        {"x": "-x - x'**3 + (a + d - c)*y'**3", "y": "-y"},
        springs("x", "y"),
        "x",
        "0.1 + 0.2 - 0.3 = 0",
        (0, 1, 0, 0),
        parameters=FIVE,
        duration=2000,
        near=0.05,
    ),
}

CORIOLIS = "the force does no work"
GYROSCOPIC = {
    "rotor with damping": Entry(
        {"x": "-x + 2*y' - 0.3*x'", "y": "-y - 2*x' - 0.3*y'"}, springs("x", "y"), "x, y", "eigenvalues"
    ),
    "rotor with one damper": Entry(
        {"x": "-x + 0.3*y' - 0.4*x'", "y": "-2*y - 0.3*x'"},
        "(x'**2 + y'**2 + x**2 + 2*y**2)/2",
        "x, y",
        "eigenvalues",
        duration=400,
    ),
    "rotor without damping": Entry(
        {"x": "-x + 2*y'", "y": "-y - 2*x'"}, springs("x", "y"), BOUNDED, CORIOLIS, (1, 0, 0, 0)
    ),
    "saddle held by gyroscopic forces, damped": Entry(
        {"x": "x + 4*y' - 0.1*x'", "y": "y - 4*x' - 0.1*y'"},
        "(x'**2 + y'**2 - x**2 - y**2)/2",
        NONE,
        "Thomson, Tait and Chetaev: complete damping destroys gyroscopic stabilisation",
        (0.1, 0, 0, 0),
    ),
    "saddle held by gyroscopic forces, cubic damping": Entry(
        {"x": "x + 4*y' - x'**3", "y": "y - 4*x' - y'**3"},
        "(x'**2 + y'**2 - x**2 - y**2)/2",
        NONE,
        "grows, although its eigenvalues are imaginary: the energy falls from 0 as x or y grow",
        (0.3, 0, 0, 0.3),
        size=0.3,
        duration=2000,
    ),
    "charge in a magnetic field": Entry(
        {"x": "y'", "y": "-x'"}, "(x'**2 + y'**2)/2", NONE, "circles about any place", (0, 0, 1, 0)
    ),
    "gyroscopic force that is not linear": Entry(
        {"x": "-x + y'*x - x'/10", "y": "-y - x'*x - y'"}, springs("x", "y"), "x, y", "V' = -(x'^2/10 + y'^2)"
    ),
    "gyroscopic force by place, one damper": Entry(
        {"x": "-x + y'*y - x'/2", "y": "-y - x'*y"},
        springs("x", "y"),
        "x, y",
        "where x = 0, 0 = y' y: y is constant, and y'' = -y leaves 0",
        duration=1500,
        near=0.4,
    ),
    "gyroscopic forces in three coordinates": Entry(
        {"x": "-x + y' - 0.5*x'", "y": "-2*y - x' + z'", "z": "-3*z - y'"},
        "(x'**2 + y'**2 + z'**2 + x**2 + 2*y**2 + 3*z**2)/2",
        "x, y, z",
        "eigenvalues",
        duration=800,
    ),
}

CIRCULATORY = {
    "weak damping": Entry(
        {"x": "-x - y/2 - x'/10", "y": "-y + x/2 - y'/10"}, springs("x", "y"), NONE, "eigenvalues", (0.1, 0, 0, 0)
    ),
    "strong damping": Entry({"x": "-x - y/10 - x'", "y": "-y + x/10 - y'"}, springs("x", "y"), "x, y", "eigenvalues"),
    "Ziegler's column beyond its load": Entry(
        {"x": "-2*x + 2*y - 0.01*x'", "y": "3*x - 4*y - 0.01*y'"},
        springs("x", "y"),
        "x, y",
        "eigenvalues: below the load of flutter",
        duration=2000,
    ),
    "follower force": Entry(
        {"x": "-x + 1.5*y - 0.05*x'", "y": "-1.5*x - 1.2*y - 0.05*y'"},
        springs("x", "y"),
        NONE,
        "eigenvalues: flutter",
        (0.1, 0, 0, 0),
    ),
}
CIRCULATORY = {f"circulatory, {name}": entry for name, entry in CIRCULATORY.items()}

PLAY = "(max(x - y - 0.5, 0) + min(x - y + 0.5, 0))"
PLAY_ENERGY = "(max(x - y - 0.5, 0)**2 + min(x - y + 0.5, 0)**2)/2"
GAPS = {
    "stop on one side": Entry(
        {"x": "-x - 0.2*x' - 5*max(x - 0.5, 0)"}, "(x'**2 + x**2 + 5*max(x - 0.5, 0)**2)/2", "x", "V' = -0.2 x'^2"
    ),
    "coupling with play": Entry(
        {"x": f"-x - 0.3*x' - {PLAY}", "y": f"-y + {PLAY}"},
        f"{springs('x', 'y')} + {PLAY_ENERGY}",
        "x",
        "y moves freely within the play",
        (0, 0.4, 0, 0),
        duration=600,
        near=0.1,
    ),
    "spring with play": Entry(
        {"x": "-max(x - 0.5, 0) - min(x + 0.5, 0) - 0.4*x'"},
        "(x'**2 + max(x - 0.5, 0)**2 + min(x + 0.5, 0)**2)/2",
        "rest",
        "V' = -0.4 x'^2",
        size=2.0,
    ),
    "coupling that only pushes": Entry(
        {"x": "-x - 0.3*x' - max(x - y, 0)", "y": "-y + max(x - y, 0)"},
        f"{springs('x', 'y')} + max(x - y, 0)**2/2",
        "x, y",
        "where x = 0, y >= 0 for ever: only 0 is",
        duration=400,
    ),
    "damper with play in place": Entry(
        {"x": "-x - max(abs(x) - 0.5, 0)*x'"}, springs("x"), BOUNDED, "no damping where |x| < 0.5", (0.4, 0), size=2.0
    ),
    "spring |x| x": Entry(
        {"x": "-x*abs(x) - 0.3*x'"}, "x'**2/2 + x**2*abs(x)/3", "x", "V' = -0.3 x'^2", duration=2000, near=0.05
    ),
    "spring |x| x beside an oscillator": Entry(
        {"x": "-x - 0.3*x' - (x - y)*abs(x - y)", "y": "-y + (x - y)*abs(x - y)"},
        f"{springs('x', 'y')} + (x - y)**2*abs(x - y)/3",
        "x, y",
        "where x = 0, y |y| = 0",
        duration=1500,
        near=0.4,
    ),
}
