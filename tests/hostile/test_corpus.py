"""Hostile and broken declarations: each is refused with its place, and nothing is executed."""

import sys

import numpy as np
import pytest

from masking.errors import DeclarationError, Place, RecordError
from masking.lab.records import readers
from masking.model.declaration import registry
from masking.model.declaration.expression import Expression
from masking.model.declaration.strict_yaml import loads
from tests.hostile import corpora, judge
from tests.hostile.corpus import EXECUTE, MARKER, MODELS, NUMBERS, SYNTAX, YAML

FORBIDDEN = (
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "subprocess.Popen",
    "exec",
    "import",
    "socket.",
    "ctypes.",
    "pty.",
)


class Watch:
    """Python's own audit events while `is_on`: what is executed, imported, started or written."""

    is_on = False
    events: list[str] = []  # noqa: RUF012  (one watch for the whole process: an audit hook cannot be taken away)

    @classmethod
    def hook(cls, event: str, args: tuple[object, ...]) -> None:
        if cls.is_on and (event.startswith(FORBIDDEN) or (event == "open" and args[1] not in {"r", "rb", None})):
            cls.events.append(f"{event} {args}")


sys.addaudithook(Watch.hook)


def refusal(call, *args):
    """Run a call that must be refused, watched, and give its problems."""
    Watch.events.clear()
    Watch.is_on = True
    try:
        call(*args)
    except DeclarationError as error:
        return error.problems
    finally:
        Watch.is_on = False
        assert not Watch.events, Watch.events
    return pytest.fail("was not refused")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    assert not (tmp_path / MARKER).exists()


def shown(text):
    return ascii(text)[:40]


def test_the_watch_sees_what_is_executed():
    Watch.events.clear()
    Watch.is_on = True
    eval("1 + 1")  # noqa: S307  (proves that the watch works)
    Watch.is_on = False
    assert Watch.events


def test_corpus_is_large_and_has_no_doubles():
    assert len(EXECUTE + SYNTAX + NUMBERS + YAML + MODELS) >= 220
    for part in (EXECUTE + SYNTAX + NUMBERS, YAML, MODELS):
        assert len(part) == len(set(part))


@pytest.mark.parametrize("text", EXECUTE + SYNTAX + NUMBERS, ids=shown)
def test_expression_is_refused_with_its_place(text):
    (problem,) = refusal(Expression, text, Place("hostile.yaml", 3, 7), "energy")
    assert problem.place is not None
    assert (problem.place.file, problem.place.line) == ("hostile.yaml", 3)
    assert 7 <= problem.place.column <= 7 + len(text)
    assert str(problem).startswith("hostile.yaml:3:")
    assert "^" in problem.excerpt
    assert problem.message.isprintable()


@pytest.mark.parametrize("text", YAML, ids=shown)
def test_yaml_is_refused_with_its_place(text):
    for problem in refusal(loads, text, "hostile.yaml"):
        assert problem.place is not None
        assert problem.place.file == "hostile.yaml"
        assert 1 <= problem.place.line <= text.count("\n") + 2
        assert problem.message


@pytest.mark.parametrize("text", MODELS, ids=shown)
def test_model_is_refused_with_its_place(text, tmp_path):
    path = tmp_path / "hostile.yaml"
    path.write_text(text, encoding="utf-8")
    for problem in refusal(registry.load_model, path):
        assert problem.place is not None, problem
        assert problem.place.file == str(path)
        assert problem.message


def test_the_harmless_neighbours_are_read():
    for text in ("x**64", "2*x", "x'", "where(x > 0, 1, 2)", "(((x)))", "sin(pi)", "1e308", "x/1e-300", "e"):
        Expression(text)
    for text in (
        "a: 'on'",
        "a: 0",
        "a: 0.5",
        "a: '010'",
        "a: yesterday",
        "a: N",
        "a: 1e3",
        "a: null",
        "a: true",
        "a: x'' + y",
        "y: 1",
        "n: 1",
        "a: y",
        "a: n",
        "a: Y",
        "\ufeffa: 1",
    ):
        loads(text)


@pytest.mark.parametrize(("kind", "least"), [("records", 1000), ("declarations", 1500)])
def test_one_in_some_of_the_corpus(kind, least):
    """Nothing is executed, read wrongly, ends in a traceback, or takes more than 10 s or 1 GiB.

    All of it: `python -m tests.benchmarks.hostile`.
    """
    names = [corpora.name(case) for case in corpora.of(kind, is_sample=False)]
    assert len(names) >= least
    assert len(names) == len(set(names))
    verdicts = judge.run(kind, is_sample=True)
    assert not [verdict for verdict in verdicts if verdict.wrong]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("1,2,3,4", "line 3 has 4 cells, but 3 columns have a name: '4' is in none; are there decimal commas"),
        ("1,2", "line 3 has 2 cells, but 3 columns have a name: 'y' has none; is it cut off"),
        ("1,1_000,3", "line 3 holds '1_000' in column 'x' (t = 1 s), not a number"),
        ("#N/A,2,3", "line 3 holds '#N/A' in column 't', not a number"),
        ("1,#N/A,3", "line 3 holds '#N/A' in column 'x' (t = 1 s), not a number"),
        ("1,0x10,3", "line 3 holds '0x10' in column 'x' (t = 1 s), not a number"),
        ("1,1e400,3", "line 3 holds '1e400' in column 'x' (t = 1 s), no finite number"),
        ("1,,3", "line 3 holds nothing in column 'x' (t = 1 s), not a number"),
        ('1,"2\n2",3', "line 3: a quote is not closed in it; a cell is on one line"),
        ("1,2\0,3", "line 3, character 4 is U+0000, which no text holds; is it damaged, or in UTF-16?"),
        ("0,2,3", "column 't' must increase strictly: row 1 is 0 after 0"),
    ],
)
def test_a_line_of_a_table_is_refused_with_its_number(tmp_path, row, words):
    path = tmp_path / "a.csv"
    path.write_text(f"t,x,y\n0,1,2\n{row}\n2,3,4\n")
    with pytest.raises(RecordError) as refused:
        readers.read(path, needed=("x", "y"))
    assert str(refused.value).startswith(f"{path}: ")
    assert words in str(refused.value)


def test_decimal_commas_stand_between_semicolons_alone(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t;x\n0,5;1,25\n1,5;-2,5e-3\n")
    np.testing.assert_array_equal(readers.read(path)["x"], [1.25, -2.5e-3])
    path.write_text("t;x\n0.5;1,25\n")
    with pytest.raises(
        RecordError, match=r"line 2 holds '0\.5' and line 2 holds '1,25'; write all numbers with a decimal"
    ):
        readers.read(path)


def test_a_definition_that_doubles_is_named(tmp_path):
    path = tmp_path / "a.yaml"
    lines = "".join(f"  a{i}: a{i - 1} + a{i - 1}\n" for i in range(1, 23))
    head = "name: m\ncoordinates: {x: a}\nparameters: {k: 1}\ndefinitions:\n  a0: k*x\n"
    path.write_text(f"{head}{lines}equations: {{x'': -a22}}\n")
    with pytest.raises(DeclarationError) as refused:
        registry.load_model(path)
    assert str(refused.value) == (
        f"{path}:17:8: definitions.a12: with its definitions written out it has 16383 operations and operands; at most "
        "10000 are allowed: a definition that holds another one twice doubles it"
    )


def test_a_file_that_is_no_declaration_is_not_shown(tmp_path):
    (tmp_path / "secret").write_text("root:x:0:0:root:/root:/bin/sh\n")
    (tmp_path / "linked.yaml").symlink_to(tmp_path / "secret")
    path = tmp_path / "a.yaml"
    for name in (str(tmp_path / "secret"), "linked.yaml"):
        path.write_text(f"plant: {name}\nvirtual: duffing\nduration: 1\n")
        with pytest.raises(DeclarationError) as refused:
            registry.assemble(registry.load_experiment(path))
        assert str(refused.value) == (
            f"{path}:1:8: plant: {name} is no declaration: its name does not end in .yaml; name a .yaml file"
        )
