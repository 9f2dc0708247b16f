"""Main program: the parser of the command line, and what the process prints and returns."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Sequence

from masking.app.cli import rig_verbs, verbs
from masking.app.cli.terminal import INTERRUPTED, NOTHING_SAVED, printable
from masking.app.cli.verb import Call, Verb, VerbParser, add_verbs
from masking.errors import NO_PLACE, RENAMED, DeclarationError, MaskingError, Problem

VERBS: tuple[Verb, ...] = (*verbs.VERBS, *rig_verbs.VERBS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status: 0 done, 1 a run that stopped, 2 something to correct first.

    After an interrupt it is 130, after a defect of this program 70.
    """
    with printable():
        return _done(arguments)


def _done(arguments: Sequence[str] | None) -> int:
    given = _with_units(sys.argv[1:] if arguments is None else [*arguments])
    parser = _parser()
    call: Call | None = None
    try:
        chosen, unknown = parser.parse_known_args(given)
        if unknown:
            renamed = [_renamed(text) for text in unknown if _renamed(text)]
            parser.error(", ".join(renamed) or f"unrecognized arguments: {' '.join(unknown)}")
        if arguments is None:  # in a process of its own, which an interrupt may end in the midst of compiled code
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        call = Call(chosen.verb, vars(chosen))
        status: int = call.verb.act(call)
        sys.stdout.flush()
    except MaskingError as error:
        _refuse(str(error), error.problems if isinstance(error, DeclarationError) else (), given)
        return error.exit_status
    except KeyboardInterrupt:
        print(call.verb.interrupted.format(out=call.out) if call else NOTHING_SAVED, file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # the last catch: an input ends in a sentence, whatever is wrong
        if not isinstance(error, OSError) or error.errno not in NO_PLACE:
            from masking.app.cli import defects  # whose libraries would take most of the time of a start

            sentence, status = defects.said(error, given)
            _refuse(sentence, (), given)
            return status
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        with contextlib.suppress(OSError):
            print(f"masking: what it says cannot be written ({error.strerror}); make room", file=sys.stderr)
        return MaskingError.exit_status
    return status


def _refuse(sentence: str, problems: Sequence[Problem], given: Sequence[str]) -> None:
    """Print an error, for programs where JSON is asked for, and for people."""
    if any(text.partition("=")[0] == "--json" for text in given):
        print(json.dumps({"error": sentence, "problems": [p.as_dict() for p in problems]}, indent=2))
    print(sentence if problems else f"masking: {sentence}", file=sys.stderr)


def _with_units(given: Sequence[str]) -> list[str]:
    """Arguments, with the unit behind a rate in one with it: `--resample 200 Hz`."""
    made = list[str]()
    for text in given:
        if text in {"Hz", "kHz"} and made[-2:-1] == ["--resample"]:
            made[-1] += f" {text}"
        else:
            made.append(text)
    return made


def _renamed(argument: str) -> str:
    """Message of an option that has another name now; empty for any other argument."""
    option = argument.partition("=")[0]
    name = RENAMED.get(option.removeprefix("--").replace("-", "_"), "") if option.startswith("--") else ""
    return f"{option} is called --{name.replace('_', '-')} now" if name else ""


def _parser() -> VerbParser:
    parser = VerbParser(prog="masking", description="Make an actuated rig move as if it were another machine.")
    add_verbs(parser, "verb", VERBS)
    return parser
