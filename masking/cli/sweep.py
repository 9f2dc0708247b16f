"""The verb sweep: many runs of an experiment as rows of a table, on all cores or on several machines."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from masking.cli.options import NAMED, Verb, add_json, add_out, answer
from masking.cli.progress import INTERRUPTED, Bar, raise_interrupts
from masking.cli.runs import change
from masking.errors import DeclarationError, Problem

MERGE = "merge"


def _add(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.epilog = (
        "VALUES are LOW:HIGH:NUMBER, LOW:HIGH:NUMBER:log, A,B,C, normal:MEAN:DEVIATION, uniform:LOW:HIGH or "
        "loguniform:LOW:HIGH, each after x: for multiples of the declared value; plant=fit:FILE draws from the "
        "covariance of a fit. NAME is a parameter, coordinate or velocity of the virtual system, EFFECT.PARAMETER of "
        "the plant, plant.PARAMETER of its model, or a number of the experiment such as duration; several with commas "
        "between them get the same value. The same command goes on where an earlier one was ended. 'masking sweep "
        "merge FOLDER... --out DIR' puts parts together."
    )
    sub.add_argument("names", metavar="EXPERIMENT", nargs="+", help=f"{NAMED}; or merge, and the folders of parts")
    sub.add_argument("--over", metavar="NAME=VALUES", action="append", default=[], help="what varies, and how")
    sub.add_argument("--runs", metavar="N", type=int, help="runs that are drawn at each point of the grid")
    sub.add_argument("--seed", metavar="N", type=int, default=0, help="of what is drawn (default: 0)")
    text = "of each run: alpha, eps, tau_s, phase, verdict, end, period, chi, peak, used, chi.X, peak.V, maxima.X"
    text += ", section.X@Y"
    sub.add_argument("--measure", metavar="NAME", action="append", default=[], help=text)
    sub.add_argument("--sampling", choices=("random", "latin", "sobol"), default="random", help="of what is drawn")
    sub.add_argument("--virtual", action="store_true", help="integrate the virtual system by itself, without a rig")
    text = "with --virtual: follow the last grid up and down, each run from the end of the one before"
    sub.add_argument("--continuation", action="store_true", help=text)
    sub.add_argument("--trajectories", action="store_true", help="keep the virtual motion of each run")
    sub.add_argument("--gpu", action="store_true", help="with --virtual: let a GPU of NVIDIA make the runs, with CuPy")
    sub.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="change a virtual parameter")
    sub.add_argument("--duration", metavar="TIME", type=float, help="of each run, in units of virtual time")
    sub.add_argument("--part", metavar="K/N", default="1/1", help="make the K-th of N parts, on a machine each")
    sub.add_argument("--workers", metavar="N", type=int, help="processes (default: the number of cores)")
    sub.add_argument("--dask", metavar="ADDRESS", help="scheduler of dask, whose workers make the runs")
    add_out(sub, "results/EXPERIMENT_sweep")


def _sweep(chosen: argparse.Namespace) -> int:
    """Run an experiment many times with other values, and measure each run."""
    from masking.workflows.sweep import merge_sweeps, sweep

    if chosen.names[0] == MERGE:
        out = Path(chosen.out or "results/merged_sweep")
        found = merge_sweeps(*chosen.names[1:], out=out, overwrite=chosen.overwrite)
        return answer(chosen.json, found.as_dict(), f"{found}\npage: {out / 'sweep.html'}")
    if len(chosen.names) > 1:
        message = f"one experiment is swept, not {len(chosen.names)}"
        raise DeclarationError(
            Problem(None, chosen.names[1], message, "name one, or 'merge' before the folders of parts")
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
                gpu=chosen.gpu,
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
        print(f"masking: interrupted; the runs that are done are in {out}, the same command goes on", file=sys.stderr)
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
