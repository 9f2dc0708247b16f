"""The verb stability: equilibria, modes, and what the energy of a system proves."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from masking.cli.progress import Bar, raise_interrupts
from masking.errors import DeclarationError, Problem
from masking.workflows import verbs


def add_stability(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verb stability."""
    text = "find the equilibria and modes of a model or an experiment, and what its energy proves of all its motions"
    sub = found.add_parser("stability", help=text, description=f"{text[0].upper()}{text[1:]}.")
    sub.add_argument("name", metavar="MODEL_OR_EXPERIMENT", help="a YAML file, or a name that 'masking list' shows")
    sub.add_argument("--kind", choices=verbs.STUDIED, help="which, where the name stands for both (default: the model)")
    sub.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="change a parameter of the system"
    )
    text = "look for equilibria, and prove what is not proved everywhere, with this coordinate or velocity in between"
    sub.add_argument("--box", metavar="NAME=LOW:HIGH", action="append", default=[], help=text)
    text = "find the largest Lyapunov exponent of the motion from the initial state over this time: is it chaotic?"
    sub.add_argument("--exponent", metavar="TIME", type=float, help=text)
    sub.add_argument("--out", metavar="DIR", help="where to save (default: results/NAME_stability)")
    text = "print JSON, or write it to a file; give it after MODEL_OR_EXPERIMENT"
    sub.add_argument("--json", metavar="FILE", nargs="?", const=True, default=False, help=text)
    sub.set_defaults(verb=_stability)


def _stability(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or f"results/{Path(chosen.name).stem}_stability")
    verbs.check_folder(out)
    if chosen.json and chosen.json is not True:
        verbs.check_folder(Path(chosen.json).parent)
    changes = {name: numbers[0] for name, numbers in (_numbers("--set", text, 1) for text in chosen.set)}
    box = {name: (numbers[0], numbers[1]) for name, numbers in (_numbers("--box", text, 2) for text in chosen.box)}
    raise_interrupts()
    with Bar("deriving") as bar:
        settings = {"kind": chosen.kind, "changes": changes, "box": box, "exponent": chosen.exponent}
        found = verbs.stability(chosen.name, **settings, out=out, tell=bar.tell)
    result = json.dumps(found.as_dict(), indent=2, ensure_ascii=False, allow_nan=False)
    if chosen.json is True:
        print(result)
        return 0
    if chosen.json:
        Path(chosen.json).write_text(result + "\n", encoding="utf-8")
    print(found)
    print(f"page: {out / 'stability.html'}")
    return 0


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
