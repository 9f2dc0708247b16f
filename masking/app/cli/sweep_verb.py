"""The verb sweep: many runs of an experiment as rows of a table, on all cores or on several machines."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from masking.app.cli.options import NAMED, Verb, add_json, add_out, answer
from masking.app.cli.progress import INTERRUPTED, Bar, raise_interrupts
from masking.app.cli.run_verbs import change
from masking.errors import DeclarationError, Problem

MERGE = "merge"


def _add(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.epilog = (
        "NAME is a parameter, coordinate or velocity of the virtual system; EFFECT.PARAMETER of the plant; "
        "plant.PARAMETER of its model; or a number of the experiment, such as duration. Several names with commas "
        "between them get the same value. VALUES are a grid, LOW:HIGH:NUMBER or LOW:HIGH:NUMBER:log; a list, A,B,C; or "
        "a distribution, normal:MEAN:DEVIATION, uniform:LOW:HIGH or loguniform:LOW:HIGH; with x: in front they "
        "multiply the declared value. plant=fit:FILE draws from the covariance of a fit. If a sweep is interrupted, "
        "the same command makes the runs that are missing. 'masking sweep merge FOLDER... --out DIR' puts parts "
        "together."
    )
    sub.add_argument("names", metavar="EXPERIMENT", nargs="+", help=f"{NAMED}; or 'merge', and the folders of parts")
    sub.add_argument("--over", metavar="NAME=VALUES", action="append", default=[], help="what varies: see below")
    sub.add_argument("--runs", metavar="N", type=int, help="how many times values are drawn at each point of the grid")
    sub.add_argument("--seed", metavar="N", type=int, default=0, help="seed of all that is drawn (default: 0)")
    text = "what is measured: alpha, eps, tau_s, phase, verdict, end, period, chi, peak, used, chi.X, peak.V, maxima.X"
    text += ", section.X@Y"
    sub.add_argument("--measure", metavar="NAME", action="append", default=[], help=text)
    sub.add_argument("--sampling", choices=("random", "latin", "sobol"), default="random", help="how values are drawn")
    sub.add_argument("--virtual", action="store_true", help="integrate the virtual system by itself, without a rig")
    text = "with --virtual: follow the last grid up, then down; each run begins where the one before it ended"
    sub.add_argument("--continuation", action="store_true", help=text)
    sub.add_argument("--trajectories", action="store_true", help="keep the virtual motion of each run, too")
    sub.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="change a virtual parameter")
    sub.add_argument("--duration", metavar="TIME", type=float, help="duration of each run, in units of virtual time")
    sub.add_argument("--part", metavar="K/N", default="1/1", help="make the K-th of N parts, one on each machine")
    sub.add_argument("--workers", metavar="N", type=int, help="number of processes (default: the number of cores)")
    sub.add_argument("--dask", metavar="ADDRESS", help="scheduler of a dask cluster, whose workers make the runs")
    add_out(sub, "results/EXPERIMENT_sweep")


def _sweep(chosen: argparse.Namespace) -> int:
    """Run an experiment many times with other values, and measure each run."""
    from masking.app.workflows.sweep import merge_sweeps, sweep

    if chosen.names[0] == MERGE:
        out = Path(chosen.out or "results/merged_sweep")
        found = merge_sweeps(*chosen.names[1:], out=out, overwrite=chosen.overwrite)
        return answer(chosen.json, found.as_dict(), f"{found}\npage: {out / 'sweep.html'}")
    if len(chosen.names) > 1:
        message = f"a sweep has one experiment, not {len(chosen.names)}"
        raise DeclarationError(
            Problem(None, chosen.names[1], message, "name one; or write 'merge' before the folders of parts")
        )
    out = Path(chosen.out or f"results/{Path(chosen.names[0]).stem}_sweep")
    raise_interrupts()
    try:
        with Bar("running") as bar:
            found = sweep(
                chosen.names[0],
                over=dict(_over(text) for text in chosen.over),
                runs=chosen.runs,
                seed=chosen.seed,
                measure=[name.strip() for text in chosen.measure for name in text.split(",")],
                sampling=chosen.sampling,
                virtual=chosen.virtual,
                continuation=chosen.continuation,
                trajectories=chosen.trajectories,
                changes=dict(change(text) for text in chosen.set),
                duration=chosen.duration,
                part=_part(chosen.part),
                workers=chosen.workers,
                dask=chosen.dask,
                out=out,
                overwrite=chosen.overwrite,
                tell=bar.tell,
            )
    except KeyboardInterrupt:
        print(f"masking: interrupted; {out} has the finished runs, the same command makes the others", file=sys.stderr)
        return INTERRUPTED
    return answer(chosen.json, found.as_dict(), f"{found}\npage: {out / 'sweep.html'}")


def _over(text: str) -> tuple[str, str]:
    name, equals, values = text.partition("=")
    if not equals or not values:
        message = f"'{text}' does not say what varies and how"
        raise DeclarationError(Problem(None, "--over", message, "write it as in --over mu1=0.01:0.2:50"))
    return name.strip(), values.strip()


def _part(text: str) -> tuple[int, int]:
    try:
        k, n = map(int, text.split("/"))
    except ValueError:
        message = f"'{text}' is no part"
        raise DeclarationError(Problem(None, "--part", message, "write it as in --part 1/4")) from None
    return k, n


VERBS = (Verb("sweep", _add, _sweep),)
