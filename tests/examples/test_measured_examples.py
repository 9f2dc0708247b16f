"""The examples of measured records: each file holds its command and what comes out, which these tests hold it to.

`python -m tests.examples.test_measured_examples [NAME ...]` writes the results of the commands into the files.
"""

import contextlib
import io
import json
import os
import re
import sys
import tempfile
import textwrap
from pathlib import Path

import pytest

from masking.app import cli
from masking.model.declaration.quantities import percent
from masking.model.effects.dictionary import EFFECTS
from masking.reports.text import capital, listed
from tests.benchmarks import measured
from tests.benchmarks.official import DATA, ROOT

EXAMPLES = sorted((ROOT / "examples" / "measured").glob("*.yaml"))
RESULT = "# Result: "
WIDTH = 118
NO_NAME = "The model misses something that is not in the dictionary"
VERDICTS = {
    "none": "Nothing is missing, with the parameters adjusted",
    "parameter": "No effect is missing, but {0} {1} off",
    "named": "{0} {1} missing",
    "ambiguous": "{0} {1} missing, or what this record cannot tell from that",
    "unknown": "The nearest in the dictionary {1} {0}, which {2} more than noise",
}


def found(example, folder):
    """Return the numbers that the command gives, run where the data are."""
    copy = Path(folder) / "data"
    copy.mkdir()
    measured.prepared(copy)
    with contextlib.chdir(copy), contextlib.redirect_stdout(io.StringIO()) as out:
        assert cli.main([*measured.command(example), "--out", str(Path(folder) / "found"), "--json"]) == 0
    return json.loads(out.getvalue())


def sentence(numbers):
    """Return the result as the file has it: verdict, names, and the validation error before and after."""
    known = {name: effect.spoken for name, effect in EFFECTS.items()}  # a parameter is none of them
    pairs = [(known.get(one["name"], one["name"]), one["on"]) for one in numbers["effects"]]
    names = [f"{name} in {on}" if on else name for name, on in pairs]
    before, after = (numbers["simulation_error"]["validation"][which] for which in ("before", "after"))
    errors = [f"{name} from {percent(before[name])} to {percent(after[name])}" for name in before]
    what = VERDICTS[numbers["verdict"]].format(
        listed(names), *(("is", "leaves") if len(names) == 1 else ("are", "leave"))
    )
    return f"{capital(what) if names else NO_NAME}. On unseen data the error goes down: {listed(errors)}."


def result(example):
    """Return the result that stands in a file."""
    _, _, after = example.read_text(encoding="utf-8").partition(RESULT)
    lines = after.partition("\nname: ")[0].splitlines()
    return " ".join(line.removeprefix("# ") for line in lines)


def with_result(text, new):
    """Return the text of a file with another result."""
    before, _, after = text.partition(RESULT)
    lines = textwrap.wrap(RESULT + new, WIDTH, subsequent_indent="# ", break_on_hyphens=False)
    return before + "\n".join(lines) + "\nname: " + after.partition("\nname: ")[2]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_each_has_its_result(example):
    assert re.fullmatch(r"[A-Z].+\. On unseen data the error goes down: .+ from .+ to .+\.", result(example))


@pytest.mark.search
@pytest.mark.skipif(not DATA.exists(), reason=f"the measurements are not at {DATA}")
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_the_command_gives_the_result(example, tmp_path):
    numbers = found(example, tmp_path)
    before, after = (numbers["simulation_error"]["validation"][which] for which in ("before", "after"))
    assert all(after[name] <= before[name] for name in before)
    assert result(example).partition(". ")[0] == sentence(numbers).partition(". ")[0]


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "Agg")
    for path in [one for one in EXAMPLES if not sys.argv[1:] or one.stem in sys.argv[1:]]:
        with tempfile.TemporaryDirectory() as place:
            found_out = sentence(found(path, place))
        path.write_text(with_result(path.read_text(encoding="utf-8"), found_out), encoding="utf-8")
        print(path.stem, found_out, flush=True)
