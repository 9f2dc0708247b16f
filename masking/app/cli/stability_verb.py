"""The verb stability: equilibria, modes, and what the energy of a system proves."""

from __future__ import annotations

import argparse
from pathlib import Path

from masking.app.cli.options import NAMED, Verb, add_json, add_out, answer, prepare
from masking.app.cli.progress import Bar
from masking.app.workflows.choices import STUDIED
from masking.errors import DeclarationError, Problem


def _add(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("name", metavar="MODEL_OR_EXPERIMENT", help=NAMED)
    sub.add_argument("--kind", choices=STUDIED, help="which, if the name stands for both (default: the model)")
    sub.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="change a parameter of the system"
    )
    text = "range of a coordinate or velocity in which to look for equilibria, and to prove what is not proved globally"
    sub.add_argument("--box", metavar="NAME=LOW:HIGH", action="append", default=[], help=text)
    text = "find the largest Lyapunov exponent of the motion from the initial state over this time: is it chaotic?"
    sub.add_argument("--exponent", metavar="TIME", type=float, help=text)
    add_out(sub, "results/NAME_stability")
    add_json(sub, after="MODEL_OR_EXPERIMENT")


def _stability(chosen: argparse.Namespace) -> int:
    """Find the equilibria and modes of a model or an experiment, and what its energy proves of all its motions."""
    from masking.app.workflows.stability import stability

    out = Path(chosen.out or f"results/{Path(chosen.name).stem}_stability")
    changes = {name: numbers[0] for name, numbers in (_numbers("--set", text, 1) for text in chosen.set)}
    box = {name: (numbers[0], numbers[1]) for name, numbers in (_numbers("--box", text, 2) for text in chosen.box)}
    prepare(chosen.json, out)
    with Bar("deriving") as bar:
        found = stability(
            chosen.name,
            kind=chosen.kind,
            changes=changes,
            box=box,
            exponent=chosen.exponent,
            out=out,
            overwrite=chosen.overwrite,
            tell=bar.tell,
        )
    numbers = (out / "stability.json").read_text(encoding="utf-8")
    return answer(chosen.json, numbers, f"{found}\npage: {out / 'stability.html'}")


def _numbers(option: str, text: str, count: int) -> tuple[str, list[float]]:
    """Read NAME=NUMBER, or NAME=LOW:HIGH."""
    name, equals, rest = text.partition("=")
    try:
        numbers = [float(x) for x in rest.split(":")]
        if not equals or len(numbers) != count:
            raise ValueError(text)
    except ValueError:
        mend = "write it as in --set z3=0.1" if count == 1 else "write it as in --box x1=-2:2"
        raise DeclarationError(Problem(None, option, f"'{text}' cannot be read", mend)) from None
    return name.strip(), numbers


VERBS = (Verb("stability", _add, _stability),)
