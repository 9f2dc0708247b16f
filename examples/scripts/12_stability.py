"""Parameter studies of stability: damping and speed, coupling and the onset of synchronisation, basins of two motions.

1. Fig. 8.4: the damping of the middle disc at which two discs synchronise fastest, by eigenvalues and by simulation.
2. Two clocks that are not alike keep their own frequencies while the beam is heavy against them; from some mass ratio
   on they share one. Chapter 10 of the source document asks for that coupling strength.
3. Two clocks that are alike may end in phase or in anti-phase; which, the initial state decides.
4. What the energies of the thesis' systems prove, and where conjecture 8.1 ends: gravity that makes further equilibria.

Pictures are written to `results/stability`.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from masking.analysis.stability.basins import basins
from masking.analysis.stability.energy_certificate import certificate
from masking.analysis.stability.equilibria import equilibria
from masking.analysis.stability.modes import sweep, upsilon
from masking.analysis.stability.orbits import orbit
from masking.analysis.stability.settling import settling_time
from masking.analysis.synchronisation import period
from masking.model.modelling.model import Model, load_model
from masking.reports.stability_page import basins_figure, sweep_figure

CLOCKS = """
name: two clocks on a beam
description: Oscillators that an escapement drives to the amplitude 2 a, on a beam that moves sideways.
coordinates: {x1: {initial: 0.5}, x2: {initial: 0.3}, x3: {initial: 0}}
oscillators: [x1, x2]
parameters:
  w1: {value: 1, meaning: frequency of clock 1}
  w2: {value: 1, meaning: frequency of clock 2}
  b: {value: 0.2, meaning: strength of the escapements}
  a: {value: 0.5, meaning: half the amplitude of the clocks}
  mu: {value: 0.1, meaning: mass of a clock per mass of the beam}
  w3: {value: 0.7, meaning: frequency of the beam}
  z3: {value: 0.02, meaning: damping ratio of the beam}
definitions:
  f1: w1**2*(x1 - x3) - b*(1 - ((x1 - x3)/a)**2)*(x1' - x3')
  f2: w2**2*(x2 - x3) - b*(1 - ((x2 - x3)/a)**2)*(x2' - x3')
equations:
  x1'': -f1
  x2'': -f2
  x3'': mu*(f1 + f2) - w3**2*x3 - 2*z3*w3*x3'
"""
OUT = Path("results/stability")
OUT.mkdir(parents=True, exist_ok=True)

# 1. Damping
discs = load_model("discs").dimensionless().with_parameters(w3=0.7252, mu1=0.0256, mu2=0.0256)  # Table 8.3
z3 = np.concatenate([np.linspace(0.05, 0.7, 66), np.linspace(0.75, 2.5, 36)])
slowest, settled = sweep(discs, "z3", z3), sweep(discs, "z3", z3, settling_time)
best = float(z3[np.argmin(slowest)])
least, later = float(z3[np.argmin(settled)]), settled[np.argmin(slowest)] / settled.min() - 1.0
print(f"damping: fastest at z3 = {best:.2f}, upsilon = {slowest.min():.1f}")
print(f"simulated: tau_s is least at z3 = {least:.2f}, and {later:.1%} longer at {best:.2f}")
words = ("damping", "Damping of the middle disc", "Fig. 8.4: upsilon (8.13), and tau_s by definition 8.1.")
curves = {r"$\upsilon$": (slowest, best), r"$\tau_s$": (settled, least)}
(OUT / "damping.png").write_bytes(sweep_figure("z3", z3, curves, words).png)

# 2. Coupling
with TemporaryDirectory() as folder:
    Path(folder, "clocks.yaml").write_text(CLOCKS)
    clocks = load_model(Path(folder, "clocks.yaml"))


def beat(model: Model) -> float:
    """Return the difference of the clocks' frequencies over the last part of a long motion."""
    times = np.linspace(0.0, 3000.0, 60001)
    run = model.simulate(times, tolerance=1e-8)
    last = times > 1500.0
    first, second = (2 * np.pi / period(times[last], run[c][last]) for c in ("x1", "x2"))
    return abs(first - second)


unlike = clocks.with_parameters(w1=0.99, w2=1.01, z3=0.3)
mu = np.linspace(0.002, 0.06, 30)
differences = sweep(unlike, "mu", mu, beat)
onset = float(mu[np.flatnonzero(differences > 1e-3)[-1] + 1])
print(f"coupling: clocks of 0.99 and 1.01 share one frequency from a mass ratio of {onset:.3f} on")
words = (
    "coupling",
    "Coupling",
    "Difference of the frequencies of two clocks over the mass of a clock per that of the beam.",
)
(OUT / "coupling.png").write_bytes(
    sweep_figure("mu", mu, {"difference of frequencies": (differences, onset)}, words).png
)

# 3. Basins
cycles = {}
for name, sign in (("in phase", 1.0), ("anti-phase", -1.0)):
    settled_run = clocks.simulate([0.0, 600.0], {"x1": 1.0, "x2": sign})
    cycles[name] = orbit(clocks, settled_run.states[-1], 6.3)
    size = np.abs(cycles[name].multipliers[1])
    print(f"{name}: period {cycles[name].period:.4f}, largest Floquet multiplier but 1 is {size:.3f}")
span = np.linspace(-1.5, 1.5, 24)
found = basins(clocks, ("x1", span), ("x2", span + 1e-3), duration=600.0, last=20.0, near=0.2)
print("basins:", ", ".join(f"{label} {share:.0%}" for label, share in found.shares().items() if share))
words = ("basins", "Basins", "Where two clocks end that begin at rest in these places.")
(OUT / "basins.png").write_bytes(basins_figure(found, words).png)

# 4. What is proved
for name in ("setup_identical", "duffing", "discs", "huygens", "discs_eccentric"):
    print(f"{name}: {certificate(load_model(name).dimensionless()).conclusion}")
eccentric = load_model("discs_eccentric").dimensionless()
low, high = 0.7, 2.0
while high - low > 1e-3:
    nu = 0.5 * (low + high)
    rest = equilibria(eccentric.with_parameters(nu1=nu, nu2=nu))
    low, high = (nu, high) if rest.is_complete and len(rest.points) == 1 else (low, nu)
print(f"conjecture 8.1, with Table 8.4 but for nu1 = nu2: from nu = {high:.3f} on there are further equilibria")

assert abs(best - 0.394) < 0.01
assert abs(upsilon(discs.with_parameters(z3=0.394)) - 39.0) < 0.05
assert differences[0] > 0.015
assert 0.002 < onset < 0.06
assert all(cycle.is_stable for cycle in cycles.values())
assert min(found.shares()["in-phase"], found.shares()["anti-phase"]) > 0.1
assert certificate(eccentric.with_parameters(nu1=low, nu2=low)).others == ()
