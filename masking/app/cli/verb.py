"""Verbs of the command line, and calls of them."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from masking.app.cli import arguments
from masking.app.cli.terminal import NOTHING_SAVED, Bar, raise_interrupts
from masking.app.workflows.settings_keywords import Parameter, parameters


@dataclass(frozen=True)
class Verb:
    """A verb of the command line."""

    name: str  # as it is typed
    text: str  # its help
    # `module:name` below `masking`, whose parameters are the arguments; imported if the verb is asked for, since it may
    # load packages. By default that of the verb's name in a module of its name in `app.workflows`.
    function: str = ""
    # does it, and returns the exit status; by default what the function returns is printed
    act: Callable[[Call], int] = lambda call: call.answered()
    # folder of the results by default, with the names of arguments in braces; empty where the function has one
    out: str = ""
    doing: str = ""  # what the progress bar says; empty where the verb takes no time
    interrupted: str = NOTHING_SAVED  # what an interrupt leaves, with `{out}`
    flags: Mapping[str, str] = field(default_factory=dict)  # options without a value that are its own, with their help
    page: str = ""  # file of the page in that folder; empty where the text says where it is, or there is none
    numbers: str = ""  # file of the JSON in that folder, which `--json` prints, or writes to another file
    metavars: Mapping[str, str] = field(default_factory=dict)  # placeholders of arguments by their parameters
    note: str = ""  # below the help
    # those of the function's parameters that are arguments; by default all
    select: Callable[[dict[str, Parameter]], dict[str, Parameter]] = dict
    verbs: tuple[Verb, ...] = ()  # of a group

    def loaded(self) -> Callable[..., Any]:
        """The function that does it."""
        module, _, name = (self.function or f"app.workflows.{self.name}:{self.name}").partition(":")
        found: Callable[..., Any] = getattr(importlib.import_module(f"masking.{module}"), name)
        return found

    def parameters(self) -> dict[str, Parameter]:
        """Parameters of the function that does it."""
        return self.select(parameters(self.loaded()))


def verb(function: str = "", **settings: Any) -> Callable[[Callable[[Call], int]], Verb]:  # noqa: ANN401  # of `Verb`
    """Decorator: the verb that a function does, of the function's name, and with its docstring as help."""

    def made(act: Callable[[Call], int]) -> Verb:
        text = " ".join((act.__doc__ or "").split())
        return Verb(act.__name__.strip("_"), text, function, act, **settings)

    return made


class VerbParser(argparse.ArgumentParser):
    """Parser that gets the arguments of its verb once these are asked for, since that loads packages."""

    verb: Verb | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # noqa: ANN401
        """As that of argparse."""
        if self.verb is not None:
            verb, self.verb = self.verb, None
            _add_arguments(self, verb)
        return super().parse_known_args(args, namespace)


def add_verbs(parser: argparse.ArgumentParser, title: str, verbs: tuple[Verb, ...]) -> None:
    """Add verbs to a parser."""
    found = parser.add_subparsers(title=f"{title}s", metavar=title.upper(), required=True, parser_class=VerbParser)
    for verb in verbs:
        text = verb.text.removesuffix(".")
        sub = found.add_parser(
            verb.name, help=f"{text[0].lower()}{text[1:]}", description=verb.text, argument_default=argparse.SUPPRESS
        )
        sub.verb = verb


def _add_arguments(sub: argparse.ArgumentParser, verb: Verb) -> None:
    if verb.verbs:
        add_verbs(sub, "procedure" if verb.name == "measure" else "verb", verb.verbs)
        return
    sub.epilog = verb.note
    arguments.add(sub, verb.parameters(), verb.metavars, {"out": verb.out} if verb.out else {})
    for name, text in verb.flags.items():
        sub.add_argument(f"--{name}", action="store_true", help=text)
    if verb.numbers:
        text = "print JSON, or write it to a file; give it after the other arguments"
        sub.add_argument("--json", metavar="FILE", nargs="?", const=True, help=text)
    else:
        sub.add_argument("--json", action="store_true", help="print JSON")
    sub.set_defaults(verb=verb)


@dataclass(frozen=True)
class Call:
    """Call of a verb from the command line, with the arguments that are written, by their parameters."""

    verb: Verb
    written: Mapping[str, Any]

    @property
    def out(self) -> Path:
        """Folder of the results."""
        stems = {name: Path(text).stem for name, text in self.written.items() if isinstance(text, str)}
        return Path(self.written.get("out") or self.verb.out.format(**stems))

    def do(self, *first: object, **more: object) -> Any:  # noqa: ANN401  # what the function returns
        """Call the function of the verb, with a progress bar; `more` replaces arguments that are written."""
        known = self.verb.parameters()
        given, positional = dict[str, Any](arguments.columns(self.written)), [*first]
        for name, text in self.written.items():
            if name in known:
                given.setdefault(name, arguments.value(known[name], text))
        if self.verb.out:
            given |= {"out": self.out}
        given |= more
        for name, parameter in known.items():
            if name in given and parameter.is_repeated:
                positional += given.pop(name)
            elif name in given and arguments.is_positional(parameter):
                positional.append(given.pop(name))
        if not self.verb.doing:
            return self.verb.loaded()(*positional, **given)
        if self.verb.out:
            self.prepare()
        with Bar(self.verb.doing) as bar:
            callbacks = {"progress": bar, "tell": bar.tell, "say": bar.say}
            given |= {name: callback for name, callback in callbacks.items() if name in known}
            return self.verb.loaded()(*positional, **given)

    def prepare(self) -> None:
        """Refuse folders that cannot be written, of results and of JSON, before any work; let signals interrupt."""
        from masking.app.workflows.output_folders import check_folder

        check_folder(self.out)
        if isinstance(self.written.get("json"), str):
            check_folder(Path(self.written["json"]).parent)
        raise_interrupts()

    def answered(self, out: str | Path | None = None) -> int:
        """Do the verb, print its result and its page, and return the exit status 0; `out` may be another folder."""
        found = self.do(**({"out": Path(out)} if out else {}))
        if not self.verb.page:
            return self.answer(found, found)
        page = Path(out or self.out) / self.verb.page
        return self.answer(found if self.verb.numbers else {**found.as_dict(), "page": page}, f"{found}\npage: {page}")

    def answer(self, content: object, text: object) -> int:
        """Print the result of a verb, as JSON for programs or as text for people, and return the exit status 0."""
        wanted = self.written.get("json", False)
        if wanted:
            from masking.display.json_text import json_text

            file = self.out / self.verb.numbers
            numbers = file.read_text(encoding="utf-8") if self.verb.numbers else json_text(content)
            if wanted is True:
                print(numbers, end="")
                return 0
            Path(wanted).write_text(numbers, encoding="utf-8")
        print(text)
        return 0
