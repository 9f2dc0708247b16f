"""Hostile declarations: the lists of the corpus, and what is packaged with one thing in it that must be refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from masking.errors import DeclarationError, MaskingError, Place, Problem
from masking.lab.runs import batch_plan
from masking.model.declaration import catalogue, registry
from masking.model.declaration.expression import Expression
from masking.model.declaration.strict_yaml import loads
from tests.hostile.cases import SECRET
from tests.hostile.corpus import EXECUTE, MODELS, NUMBERS, SYNTAX, YAML

LOADERS = {
    "model": registry.load_model,
    "plant": registry.load_plant,
    "experiment": registry.load_experiment,
    "dictionary": registry.load_dictionary,
    "batch": batch_plan.load,
}
SCALARS = [
    "1_000", "0x10", "010", "0b11", "1e400", "-1e999", ".inf", "-.inf", ".nan", "nan", "1:30", "yes", "off",
    "2001-01-01", "!!python/object/apply:os.system ['touch hostile_marker']", "!!int 3", "&a 3", "*a", "'\t'", "\u0661",
    "\u22121", "1 + __import__('os').getpid()", "open('hostile_marker', 'w')", "1/0", "{}[0]", "x.__class__", "9**9**9",
]  # fmt: skip
NUMBER = re.compile(r"(?<=: )-?\d+(?:\.\d+)?(?:e-?\d+)?(?=[,}\n])")


@dataclass(frozen=True)
class Case:
    """A declaration.

    Args:
        name: says what is hostile.
        kind: `expression`, `yaml`, or one of the catalogue.
        text: of the file, or of the expression.
        line: at which a problem must be; 0 for any.
        is_honest: whether it must be read.
        may_be_read: whether it may be read, too.
    """

    name: str
    kind: str
    text: str | bytes
    line: int = 0
    is_honest: bool = False
    may_be_read: bool = False


def cases() -> Iterator[Case]:
    for kind, texts in {"expression": EXECUTE + SYNTAX + NUMBERS, "yaml": YAML, "model": MODELS}.items():
        for number, text in enumerate(texts):
            yield Case(f"{kind} {number}: {ascii(text)[:60]}", kind, text)
    yield from _chains()
    yield from _references()
    random = np.random.default_rng(23)
    scalars = 0
    for kind in catalogue.KINDS:
        for name in catalogue.names(kind):
            text = catalogue.find(kind, name).read_text(encoding="utf-8")
            for what, change in CHANGES.items():
                made, line = change(text, random)
                yield Case(f"{kind} {name}: {what}", kind, made, line)
            marked = b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()
            yield Case(f"{kind} {name}: honest", kind, marked, is_honest=True)
            cut = text[: int(random.integers(1, len(text)))]
            yield Case(f"{kind} {name}: cut off", kind, cut, may_be_read=True)
            places = [*NUMBER.finditer(text)]
            for _ in range(min(3, len(places))):
                place, scalar = places[int(random.integers(len(places)))], SCALARS[scalars % len(SCALARS)]
                scalars += 1
                line = text[: place.start()].count("\n") + 1
                made = f"{text[: place.start()]}{scalar}{text[place.end() :]}"
                yield Case(f"{kind} {name}: {scalar[:30]!a} in line {line}", kind, made, line)


Change = Callable[[str, np.random.Generator | None], tuple[str | bytes, int]]


def _at_end(line: str) -> Change:
    return lambda text, _: (f"{text.rstrip()}\n{line}\n", text.rstrip().count("\n") + 2)


def _inserted(what: str) -> Change:
    def change(text: str, random: np.random.Generator | None) -> tuple[str, int]:
        assert random is not None
        at = int(random.integers(1, len(text) - 1))
        return f"{text[:at]}{what}{text[at:]}", text[:at].count("\n") + 1

    return change


def _twice(text: str, _: np.random.Generator | None) -> tuple[str, int]:
    key = next(line for line in text.split("\n") if re.match(r"\w+:", line)).partition(":")[0]
    return _at_end(f"{key}: again")(text, _)


def _other_code(code: str, line: int) -> Change:
    return lambda text, _: (text.encode(code), line)


CHANGES: dict[str, Change] = {
    "a key twice": _twice,
    "an unknown key": _at_end("zz_unknown: 1"),
    "an anchor": _at_end("zz: &a [1, 2]"),
    "a merge key": _at_end("<<: {a: 1}"),
    "a second document": _at_end("---\na: 1"),
    "a Python object": _at_end("zz: !!python/object/apply:os.system ['touch hostile_marker']"),
    "NUL": _inserted("\0"),
    "a bell": _inserted("\x07"),
    "a mark that reverses text": _inserted("\u2028"),
    "UTF-16": _other_code("utf-16", 1),
    "deep": _at_end("zz: " + "[" * 300 + "]" * 300),
}


def _chains() -> Iterator[Case]:
    """Definitions that double, each in few characters."""
    head = "name: m\ncoordinates: {x: a}\nparameters: {k: 1}\ndefinitions:\n  a0: k*x\n"
    for text in (
        "A + A",
        "A*A",
        "sin(A) + cos(A)",
        "(A + 1)*(A + 2)",
        "A + A*x",
        "exp(A)/(1 + A)",
        "A*A*A",
        "where(A > 0, A, 1)",
    ):
        for count in (14, 22, 60, 300):
            lines = [f"  a{i}: {text.replace('A', f'a{i - 1}')}" for i in range(1, count + 1)]
            body = "\n".join([*lines, f"equations: {{x'': -a{count}}}", ""])
            yield Case(f"{count} definitions {text}", "model", head + body)
            lagrangian = "\n".join([*lines, f"lagrangian: x'**2/2 - a{count}", ""])
            yield Case(f"{count} definitions {text}, in a Lagrangian", "model", head + lagrangian)
    for count in (22, 300):
        forward = "\n".join(f"  a{i}: a{i + 1} + a{i + 1}*x" for i in range(count))
        last = f"\n  a{count}: x\nequations: {{x'': -a0}}\n"
        yield Case(f"{count} definitions, backwards", "model", head.replace("  a0: k*x\n", "") + forward + last)
        values = "\n".join(f"  k{i}: k{i - 1} + k{i - 1}" for i in range(1, 1100))
        text = f"name: m\ncoordinates: {{x: a}}\nparameters:\n  k0: 1\n{values}\nequations: {{x'': -k{count}*x}}\n"
        yield Case(f"parameters that overflow, {count}", "model", text)


def _references() -> Iterator[Case]:
    """Files that are no declarations in the place of one: nothing of them is shown."""
    plant = catalogue.find("plant", "ideal").read_text(encoding="utf-8")
    line = 1 + plant[: plant.index("\nmodel: ") + 1].count("\n")
    for path in (
        "SECRET",
        "SECRET.yaml",
        "/etc/passwd",
        "/dev/zero",
        "/dev/stdin",
        "~/.ssh/id_rsa",
        "/proc/self/environ",
        "..",
        "/",
        "a\\0b",
    ):
        yield Case(f"plant: {path}", "assembly", f"plant: '{path}'\nvirtual: duffing\nduration: 1\n", 1)
        yield Case(f"virtual: {path}", "assembly", f"plant: ideal\nvirtual: '{path}'\nduration: 1\n", 2)
        yield Case(f"model: {path}", "check", re.sub("(?m)^model: .*", f"model: '{path}'", plant), line)
        yield Case(f"extends: {path}", "model", f"name: m\nextends: '{path}'\n", 2)
        yield Case(f"own_effects: {path}", "plant", *_at_end(f"own_effects: ['{path}']")(plant, None))


def warm() -> None:
    for kind, load in LOADERS.items():
        for name in catalogue.names(kind)[:2]:
            load(name)
    from masking.model.modelling.model import Model

    _ = Model(registry.load_model("huygens_lagrangian")).equations.definitions


def judged(case: Case, folder: Path) -> tuple[str, str]:
    """Read a declaration; return what is wrong with what happened."""
    try:
        _read(case, folder)
    except DeclarationError as error:
        said = str(error)
        if case.is_honest:
            return "refused in vain", said
        return _judged_problems(case, error.problems, said)
    except MaskingError as error:
        return "not told", f"without a place: {error}"
    except BaseException as error:  # whatever it is, it must not be
        return "traceback", f"{type(error).__name__}: {error}"
    return ("", "read") if case.is_honest or case.may_be_read else ("taken silently", "")


def _judged_problems(case: Case, problems: tuple[Problem, ...], said: str) -> tuple[str, str]:
    if SECRET in said or "root:" in said:
        return "shown", said
    if not problems or not all(problem.message for problem in problems):
        return "no sentence", said
    lines = [problem.place.line for problem in problems if problem.place]
    if not lines or (case.line and case.line not in lines):
        return "not told", f"line {case.line} not in {lines}: {said[:300]}"
    return "", said


def _read(case: Case, folder: Path) -> None:
    if case.kind == "expression":
        Expression(str(case.text), Place("hostile.yaml", 3, 7), "energy")
    elif case.kind == "yaml":
        loads(str(case.text), "hostile.yaml")
    else:
        (folder / "SECRET").write_text(f"{SECRET}\nroot:x:0:0\n")
        (folder / "SECRET.yaml").symlink_to(folder / "SECRET")
        path = folder / "hostile.yaml"
        path.write_bytes(case.text if isinstance(case.text, bytes) else case.text.encode("utf-8", "surrogatepass"))
        if case.kind == "assembly":
            registry.assemble(registry.load_experiment(path))
        elif case.kind == "check":
            registry.check_plant_file(path)
        else:
            LOADERS[case.kind](path)
