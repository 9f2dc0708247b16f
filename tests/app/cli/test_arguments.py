"""Arguments of a verb that are made from the signature and the docstring of a function."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import pytest

from masking.app.cli import arguments
from masking.app.workflows.settings_keywords import parameters
from masking.errors import DeclarationError, RecordError


def turn(
    wheel: str | Path,
    *others: str | Path,
    speed: float,
    count: int = 2,
    way: Literal["left", "right"] | None = None,
    is_slow: bool = False,
    budget: bool | None = None,
    changes: Mapping[str, float] | None = None,
    box: Mapping[str, tuple[float, float]] | None = None,
    inputs: Sequence[str] = (),
    validation: Sequence[str | Path] = (),
    columns: Mapping[str, str] | Sequence[str] | None = None,
    part: tuple[int, int] = (1, 1),
    page: int | None = None,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Turn wheels.

    Args:
        wheel: that turns.
        others: that turn, too.
        speed: in 1/s,
            100 % at most.
        count: of turns.
        way: of turning.
        is_slow: whether it takes its time.
        budget: whether to say where the time went.
        changes: of parameters.
        box: in which it turns.
        inputs: that turn it.
        validation: other `records`.
        columns: of the file.
        part: of the wheels.
        page: port.
        out: folder of the results; by default nothing is saved.
        progress: called with the fraction done.
    """


KNOWN = parameters(turn)


def parser():
    found = argparse.ArgumentParser(argument_default=argparse.SUPPRESS)
    arguments.add(found, KNOWN, {"wheel": "WHEEL_1"}, {"out": "results/{wheel}"})
    return found


def read(*words):
    written = vars(parser().parse_args(words))
    found = {name: arguments.value(KNOWN[name], text) for name, text in written.items() if name in KNOWN}
    return found | arguments.columns(written)


def test_only_what_is_written_is_passed():
    assert read("a", "b", "--speed", "3") == {"wheel": "a", "others": ["b"], "speed": 3.0}


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        (["--count", "7"], "count", 7),
        (["--way", "left"], "way", "left"),
        (["--is-slow"], "is_slow", True),
        (["--no-budget"], "budget", False),
        (["--set", "k=2", "--set", " m = 1e3"], "changes", {"k": 2.0, "m": 1e3}),
        (["--box", "x'=-1:2.5"], "box", {"x'": (-1.0, 2.5)}),
        (["--input", "V1, V2", "--input", "V3"], "inputs", ("V1", "V2", "V3")),
        (["--validate", "a,b.csv", "--validate", "c"], "validation", ["a,b.csv", "c"]),
        (["--columns", "t,V1"], "columns", ("t", "V1")),
        (["--map", "t=time,V1=u"], "columns", {"t": "time", "V1": "u"}),
        (["--part", "2/3"], "part", (2, 3)),
        (["--page"], "page", 0),
        (["--page", "80"], "page", 80),
        (["--out", "here"], "out", "here"),
    ],
)
def test_a_value_has_the_type_of_its_parameter(words, name, value):
    assert read("a", "b", "--speed", "3", *words)[name] == value


def test_help_is_that_of_the_docstring_with_the_default():
    text = " ".join(parser().format_help().split())
    assert "WHEEL_1 that turns" in text
    assert "--speed NUMBER in 1/s, 100 % at most" in text
    assert "--count N of turns (default: 2)" in text
    assert "--validate VALIDATION other 'records'" in text
    assert "--out DIR folder of the results (default: results/wheel)" in text
    assert "--progress" not in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "k"], "--set: 'k' is not a change of a parameter; write it as in --set w3=0.6"),
        (["--set", "k=1:2"], "--set: 'k=1:2' is not a change of a parameter"),
        (["--box", "x=1"], "--box: 'x=1' cannot be read; write it as in --box x1=-2:2"),
        (["--part", "1"], "--part: '1' is no part; write it as in --part 1/4"),
    ],
)
def test_what_cannot_be_read_is_said_with_an_example(words, said):
    with pytest.raises(DeclarationError) as caught:
        read("a", "b", "--speed", "3", *words)
    assert str(caught.value).startswith(said)


def test_columns_are_renamed_or_named():
    with pytest.raises(RecordError, match="--map renames columns and --columns names those that have no names"):
        read("a", "b", "--speed", "3", "--map", "t=time", "--columns", "t")


def test_a_keyword_without_a_default_is_required(capsys):
    with pytest.raises(SystemExit):
        read("a", "b")
    assert "the following arguments are required: --speed" in capsys.readouterr().err
