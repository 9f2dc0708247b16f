"""What a notebook shows of models, experiments and recordings, and what pandas, xarray and parquet get of them."""

import math
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import masking
from masking.errors import RecordError
from masking.inference.discovery.discovery_result import Discovery, Named, SimulationError
from masking.inference.estimation.fit import Fit
from masking.lab.records.recording import Recording

COLUMNS = {"virtual.x1": {"unit": "m", "meaning": "displacement"}, "t": {"unit": "s"}, "input.u": {"unit": "1"}}
FAST = """
name: fast
coordinates: {{x: {{unit: m, initial: 1e-3}}}}
parameters: {{w: {{value: {w}, unit: rad/s}}}}
equations: {{x'': -w**2*x}}
"""


@pytest.fixture
def recording():
    t = np.linspace(0.0, 1.0, 11)
    columns = {"t": t, "virtual.x1": np.sin(t), "virtual.x1'": np.cos(t), "ideal.x1": np.sin(t), "input.u": 0.0 * t}
    return Recording(columns, {"name": "<demo>", "columns": COLUMNS, "masking_error": {"x1": 0.0123}})


class Markup(HTMLParser):
    """Collects tags and fails where they are not closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.words = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.seen.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_names_of_a_prefix_and_of_all_columns(recording):
    assert recording.names() == ("t", "virtual.x1", "virtual.x1'", "ideal.x1", "input.u")
    assert recording.names("virtual") == ("x1",)


def test_units_are_those_of_the_manifest_and_numbers_have_none(recording):
    assert recording.units == {"virtual.x1": "m", "t": "s"}
    assert recording.meanings == {"virtual.x1": "displacement"}
    assert Recording({"t": [0.0, 1.0]}, {"columns": "broken"}).units == {}


def test_fields_of_the_table_carry_units_and_older_tables_load(recording, tmp_path):
    table = pq.read_table(recording.save(tmp_path) / "recording.parquet")
    assert table.schema.field("virtual.x1").metadata == {b"unit": b"m", b"meaning": b"displacement"}
    assert table.schema.field("input.u").metadata is None
    old = pa.schema([field.remove_metadata() for field in table.schema], table.schema.metadata)
    pq.write_table(table.cast(old), tmp_path / "old.parquet")
    assert Recording.load(tmp_path / "old.parquet").units == recording.units


def test_pandas_gets_the_time_as_index_and_the_units(recording):
    pytest.importorskip("pandas", reason="pandas is optional")
    frame = recording.to_pandas()
    assert frame.index.name == "t"
    assert frame["virtual.x1"].to_numpy() == pytest.approx(np.sin(recording.t))
    assert frame.attrs["units"]["virtual.x1"] == "m"


def test_xarray_gets_units_as_attributes(recording):
    pytest.importorskip("xarray", reason="xarray is optional")
    dataset = recording.to_xarray()
    assert dataset["virtual.x1"].attrs == {"units": "m", "long_name": "displacement"}
    assert dataset["t"].attrs == {"units": "s"}
    assert dataset.sizes == {"t": 11}


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_a_package_that_is_not_installed_is_named(recording, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(RecordError, match=rf"to_{name} needs the package {name}: pip install 'masking\[notebook\]'"):
        getattr(recording, f"to_{name}")()


def test_a_plot_has_a_row_for_each_prefix_and_its_axes_say_the_unit(recording):
    figure = recording.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ["virtual (m)", "input"]
    assert figure.axes[-1].get_xlabel() == "time (s)"
    assert len(figure.axes[0].lines) == 2  # virtual and ideal
    assert recording.plot("virtual.x1").axes[0].lines[0].get_ydata() == pytest.approx(np.sin(recording.t))
    assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(RecordError, match=r"no column or prefix 'virtal'; did you mean 'virtual'\?"):
        recording.plot("virtal")


def test_a_recording_is_shown_with_its_columns_escaped(recording):
    shown = Markup(recording._repr_html_())
    assert "<demo>" in shown.words
    assert {"virtual.x1", "displacement", "m"} <= set(shown.words)
    assert any("chi: x1 0.012" in text for text in shown.words)


def test_a_model_is_shown_with_equations_and_values_in_declared_units():
    model = masking.load_model("setup")
    shown = Markup(model._repr_html_())
    assert shown.seen.count("mtr") == 4  # three equations and the energy
    assert {"12.5521", "rad/s", "\N{DIAERESIS}", "\N{GREEK SMALL LETTER MU}"} <= set(shown.words)
    assert repr(model) == "<Model experimental set-up: coordinates x1, x2, x3; inputs u1, u2, u3; 13 parameters>"


def test_a_component_is_shown_with_its_outputs():
    model = masking.load_model(Path(__file__).parents[2] / "examples" / "measured" / "dc_motor.yaml")
    assert Markup(model._repr_html_()).seen.count("mtr") == len(model.states) + len(model.outputs)


def test_an_experiment_is_shown_in_a_line_and_in_a_table():
    experiment = masking.Experiment.load("duffing")
    assert len(repr(experiment)) < 200
    assert {"ideal rig", "coupled Duffing oscillators"} <= set(Markup(experiment._repr_html_()).words)


def test_a_fit_is_shown_with_its_intervals():
    """1.96 standard deviations are half a 95 % interval."""
    twin = SimpleNamespace(
        declaration=SimpleNamespace(name="rig"),
        model=SimpleNamespace(declaration=SimpleNamespace(parameters={"w1": SimpleNamespace(unit="rad/s")})),
    )
    found = Fit(twin=twin, names=("w1",), values=np.array([12.5]), covariance=np.array([[0.01]]), chi={"s1": 0.02},
                floor={"s1": 0.01}, sigma=np.array([1.0]), rounds=3)  # fmt: skip
    assert repr(found) == "<Fit w1 = 12.5; chi s1 0.02>"
    assert {"12.5", "0.2", "rad/s"} <= set(Markup(found._repr_html_()).words)


def test_a_discovery_is_shown_with_its_causes():
    gap = SimulationError(({}, {}), ({"s": 0.5}, {"s": 0.01}), {}, {"s": 0.009}, {})
    cause = Named("dry_friction", "beam", {"fc": (0.5, 0.01)}, 0.98)
    found = SimpleNamespace(
        effects=(cause,), unnamed=None, simulation_error=gap, verdict="effect",
        twin=SimpleNamespace(declaration=SimpleNamespace(name="rig")),
    )  # fmt: skip
    shown = Markup(Discovery._repr_html_(found))
    assert {"dry friction", "beam", "0.5", "0.01", "0.98", "verdict: effect", "0.009"} <= set(shown.words)


@pytest.mark.parametrize("frequency", [5.0, 0.1])
def test_a_system_in_si_units_is_recorded_as_fast_as_it_moves(tmp_path, frequency):
    """Without scales a unit of virtual time is a second, in which this system oscillates `frequency` times."""
    (tmp_path / "fast.yaml").write_text(FAST.format(w=2.0 * math.pi * frequency), encoding="utf-8")
    rig = FAST.format(w=1.0).replace(
        "equations: {x'': -w**2*x}", "inputs: {u: {unit: V}}\nequations: {x'': c*u - w**2*x}"
    )
    rig = rig.replace("parameters: {", "parameters: {c: {value: 1, unit: m/s**2/V}, ")
    (tmp_path / "model.yaml").write_text(rig, encoding="utf-8")
    (tmp_path / "rig.yaml").write_text("name: rig\nmodel: model.yaml\n", encoding="utf-8")
    text = "plant: rig.yaml\nvirtual: fast.yaml\nduration: 2\ncontroller: {rate: continuous}\n"
    (tmp_path / "run.yaml").write_text(text, encoding="utf-8")
    made = masking.run(tmp_path / "run.yaml", budget=False)
    per_period = (len(made) - 1) / 2.0 / frequency
    assert per_period == pytest.approx(max(40.0, 10.0 / frequency), rel=0.01)
    assert re.fullmatch(r"<Recording run: \d+ samples of \d+ columns, t = 0 to 2>", repr(made))
