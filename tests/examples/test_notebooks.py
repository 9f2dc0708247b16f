"""The cells of each example notebook run in their order, show what they end in, and are saved without outputs."""

import ast
import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples" / "notebooks").glob("*.ipynb"))


def shown(value):
    """What a notebook shows of a value, by the methods that IPython asks for, or its line."""
    for name in ("_repr_html_", "_repr_png_", "_repr_latex_"):
        made = getattr(value, name, None)
        if made is not None and (content := made()):
            return content
    return repr(value)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_its_first_cell_to_its_last(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    names, cells = {"__name__": "__main__"}, [c for c in content["cells"] if c["cell_type"] == "code"]
    for cell in cells:
        assert cell["outputs"] == []
        assert cell["execution_count"] is None
        tree = ast.parse("".join(cell["source"]))
        if is_value := isinstance(tree.body[-1], ast.Expr):
            tree.body[-1] = ast.Assign([ast.Name("_", ast.Store())], tree.body[-1].value)
        exec(compile(ast.fix_missing_locations(tree), path.name, "exec"), names)  # noqa: S102  # our own
        assert not is_value or (shown(names["_"]) and len(repr(names["_"])) < 1000), "".join(cell["source"])
    assert "assert " in "".join(cells[-1]["source"])


def test_there_are_notebooks_and_no_pages_of_them():
    assert [path.stem for path in NOTEBOOKS] == ["lecture", "record"]
