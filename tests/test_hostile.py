"""Hostile and broken declarations: each is refused with its place, and nothing is executed."""

import sys

import pytest
from hostile.corpus import EXECUTE, MARKER, MODELS, NUMBERS, SYNTAX, YAML

from masking.declaration import registry
from masking.declaration.expression import Expression
from masking.declaration.strict_yaml import loads
from masking.errors import DeclarationError, Place

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
