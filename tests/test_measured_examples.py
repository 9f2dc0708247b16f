"""The examples of measured records: each file holds its command and what comes out, which these tests hold it to.

`python -m tests.test_measured_examples [NAME ...]` writes the results of the commands into the files.
"""

import contextlib
import io
import json
import os
import shlex
import sys
import tempfile
from pathlib import Path

import pytest

from masking import cli
from masking.declaration import registry
from masking.declaration.quantities import percent
from tests.benchmarks import official

ROOT, DATA = official.ROOT, official.DATA
EXAMPLES = sorted((ROOT / "examples" / "measured").glob("*.yaml"))
RESULT = "# Result: "


def command(example, out):
    """Return the words of the command in a file, for the files of this place."""
    lines = [line[1:].strip() for line in example.read_text(encoding="utf-8").splitlines() if line.startswith("#   ")]
    words = shlex.split(" ".join(lines).replace("\\", ""))[1:]
    return [str(example) if word == example.name else word for word in words] + ["--out", str(out), "--json"]


def found(example, folder):
    """Return the numbers that the command gives, run where the data are."""
    copy = Path(folder) / "data"
    copy.mkdir()
    for one in DATA.iterdir():
        (copy / one.name).symlink_to(one)
    (copy / "coupled_drives").unlink()
    (copy / "coupled_drives").mkdir()
    official.drives(copy / "coupled_drives")
    with contextlib.chdir(copy), contextlib.redirect_stdout(io.StringIO()) as out:
        assert cli.main(command(example, Path(folder) / "found")) == 0
    return json.loads(out.getvalue())


def sentence(numbers):
    """Return the result as the file has it: verdict, names, and the validation error before and after."""
    names = ", ".join(f"{one['name']} ({one['on']})" if one["on"] else one["name"] for one in numbers["effects"])
    before, after = (numbers["simulation_error"]["validation"][which] for which in ("before", "after"))
    errors = ", ".join(f"{name} {percent(before[name])} -> {percent(after[name])}" for name in before)
    return f"{numbers['verdict']}: {names or 'no name'}; error on unseen data {errors}"


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_each_is_a_model_with_a_command_and_its_result(example, tmp_path):
    assert registry.load_model(example).name == example.stem
    assert command(example, tmp_path)[0] == "discover"
    (result,) = (line for line in example.read_text(encoding="utf-8").splitlines() if line.startswith(RESULT))
    assert result.removeprefix(RESULT).partition(":")[0] in {"none", "parameter", "named", "ambiguous", "unknown"}


@pytest.mark.search
@pytest.mark.skipif(not DATA.exists(), reason=f"the measurements are not at {DATA}")
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_the_command_gives_the_result(example, tmp_path):
    numbers = found(example, tmp_path)
    before, after = (numbers["simulation_error"]["validation"][which] for which in ("before", "after"))
    assert all(after[name] <= before[name] for name in before)
    known = sentence(numbers).partition(";")[0]
    assert f"{RESULT}{known};" in example.read_text(encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "Agg")
    for path in [one for one in EXAMPLES if not sys.argv[1:] or one.stem in sys.argv[1:]]:
        with tempfile.TemporaryDirectory() as place:
            result = sentence(found(path, place))
        text = [
            f"{RESULT}{result}" if line.startswith(RESULT.strip()) else line for line in path.read_text().splitlines()
        ]
        path.write_text("\n".join(text) + "\n", encoding="utf-8")
        print(path.stem, result, flush=True)
