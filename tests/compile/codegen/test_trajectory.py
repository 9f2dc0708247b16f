"""A trajectory is read in a line, drawn in its units, and a table of pandas."""

import sys

import numpy as np
import pytest

import masking
from masking.errors import ModelError, RecordError

TIMES = np.linspace(0.0, 2.0, 21)
MIXED = """
name: mixed
coordinates:
  x: {unit: mm, initial: 1}
  th: {unit: rad, initial: 0.1}
equations: {x'': -x/T**2, th'': -th/T**2}
parameters: {T: {value: 1, unit: s}}
scales: {time: {value: T, unit: s}, length: {value: 0.01, unit: m}}
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    file = tmp_path_factory.mktemp("mixed") / "mixed.yaml"
    file.write_text(MIXED, encoding="utf-8")
    return masking.load_model(file)


@pytest.fixture(scope="module")
def moved(model):
    return model.simulate(TIMES)


def test_a_line_says_what_moves_and_for_how_long(moved, model):
    assert repr(moved) == "<Trajectory of x, th: 21 times, t = 0 to 2>"
    several = model.simulate(TIMES, ensemble={"x": [1.0, 2.0]})
    assert repr(several) == "<Trajectory of x, th: 2 runs of 21 times, t = 0 to 2>"
    assert "2 runs of 21 times" in several._repr_html_()
    assert "rad" in moved._repr_html_()


def test_states_are_in_si_units_or_in_scales(moved, model):
    assert moved.units == {"t": "s", "x": "m", "x'": "m/s", "th": "rad", "th'": "rad/s"}
    assert moved["x"] == pytest.approx(1e-3 * np.cos(TIMES), abs=1e-9)
    scaled = model.dimensionless().simulate(TIMES)
    assert scaled.units == {"t": "", "x": "", "x'": "", "th": "rad", "th'": "rad"}
    assert scaled["x"] == pytest.approx(0.1 * np.cos(TIMES))


def test_coordinates_of_one_unit_share_axes(moved):
    figure = moved.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ["(m)", "(rad)"]
    assert figure.axes[-1].get_xlabel() == "time (s)"
    assert figure._repr_png_().startswith(b"\x89PNG")
    alike = masking.load_model("van_der_pol").simulate(TIMES).plot()
    assert (len(alike.axes), alike.axes[0].get_ylabel()) == (1, "")
    one = moved.plot("x'", "x")
    assert one.axes[0].lines[0].get_ydata() == pytest.approx(-1e-3 * np.sin(TIMES), abs=1e-9)
    assert [axes.get_ylabel() for axes in one.axes] == ["(m/s)", "(m)"]


def test_pandas_gets_all_states(moved, monkeypatch):
    pytest.importorskip("pandas", reason="pandas is optional")
    frame = moved.to_pandas()
    assert [*frame.columns] == ["x", "th", "x'", "th'"]
    assert frame.index.to_numpy() == pytest.approx(TIMES)
    assert frame.attrs["units"]["x'"] == "m/s"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(RecordError, match=r"needs the package pandas: pip install 'masking\[notebook\]'"):
        moved.to_pandas()


def test_a_state_that_is_none_is_refused(moved):
    for ask in (moved.__getitem__, moved.plot):
        with pytest.raises(ModelError, match=r"there is no state 'y'; .*x"):
            ask("y")
    with pytest.raises(ModelError, match="there is no state 't'"):
        moved.plot("t")


def test_runs_of_an_ensemble_are_taken_one_by_one(model):
    several = model.simulate(TIMES, ensemble={"x": [1.0, 2.0]})
    second = several.run(1)
    assert second["x"] == pytest.approx(2e-3 * np.cos(TIMES), abs=1e-9)
    assert len(second.plot().axes) == 2
    for ask in (several.plot, several.to_pandas):
        with pytest.raises(ModelError, match=r"name one of 2 runs, such as trajectory\.run\(0\)"):
            ask()
    for number in (2, -1):
        with pytest.raises(ModelError, match=rf"there is no run {number}: <Trajectory of x, th: 2 runs"):
            several.run(number)
