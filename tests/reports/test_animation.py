"""Drawings that models declare, and animations: pages, pictures and films of a recording."""

import base64
import contextlib
import json
import math
import re
import struct
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest

import masking
from masking.app.cli import main
from masking.errors import DeclarationError, RecordError
from masking.lab.records.recording import Recording
from masking.model.declaration import catalogue, registry
from masking.model.modelling.scales import Units
from masking.reports import animation_frames
from masking.reports.animation import Animation, Drawing

MODEL = """
name: a pendulum
coordinates: {th: {unit: rad, initial: 0.1}, x: {unit: m, initial: 0}}
parameters: {l: {value: 2, unit: m}, w: {value: 1, unit: rad/s}}
equations: {th'': -w**2*th, x'': -w**2*x + l*th*w**2}
drawing:
"""
DRAWN = [name for name in catalogue.names("model") if registry.load_model(name).drawing]


def load(tmp_path, *shapes):
    path = tmp_path / "model.yaml"
    path.write_text(MODEL + "".join(f"  - {shape}\n" for shape in shapes), encoding="utf-8")
    return registry.load_model(path)


def recorded(model="huygens", plant="setup", rows=201):
    """A recording of two systems, which swing by sines."""
    t = np.linspace(0.0, 20.0, rows)
    columns, declarations = {"t": t}, {"plant": {"parameters": {"l": 4}}}
    for prefix, key, name in (
        ("rig", "plant_model", plant),
        ("virtual", "virtual", model),
        ("ideal", "virtual", model),
    ):
        declared = registry.load_model(name)
        declarations[key] = declared.canonical()
        for i, coordinate in enumerate(declared.coordinates):
            columns[f"{prefix}.{coordinate}"] = 0.3 * np.sin(2.0 * np.pi * t / 2.0 + i)
    columns["input.u1"] = np.cos(t)
    values = {name: p.value for name, p in registry.load_model(model).parameters.items()}
    manifest = {
        "name": "<b>",
        "declarations": declarations,
        "parameters": values,
        "virtual_name": "clocks",
        "time_scale": 0.5,
    }
    return Recording(columns, manifest)


@pytest.fixture
def run(tmp_path):
    return recorded().save(tmp_path / "run")


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (
            "bodie: {at: [x, 0], size: [l, l]}",
            r"7:5: drawing.0.bodie: the key 'bodie' is not known; did you mean 'body'\?",
        ),
        ("body: {at: [x, 0], siz: [l, l]}", r"drawing.0.body.siz: the key 'siz' is not known; did you mean 'size'\?"),
        ("body: {at: [xx, 0], size: [l, l]}", r"7:17: drawing.0.body.at.0: unknown symbol 'xx'; did you mean 'x'\?"),
        ("body: {at: [x', 0], size: [l, l]}", r"drawing.0.body.at.0: 'x'' may not be used here"),
        ("body: {at: [x, 0]}", r"drawing.0.body.size: the key 'size' is missing"),
        ("body: {at: [x], size: [l, l]}", r"drawing.0.body.at"),
        ("{}", r"drawing.0: a shape is of one kind, not none; write one of body, spring, rod, ground, arm, disc"),
        ("{rod: {ends: [[0, 0], [x, 0]]}, spring: {ends: [[0, 0], [x, 0]]}}", "of one kind, not spring and rod"),
        ("rod: {ends: [[0, 0], ['interpolate(x/l, 0, 0, 1, 1, 2, 2, 3, 3)', 0]]}", "a drawing takes no tables"),
    ],
)
def test_a_wrong_shape_is_named_with_its_place(tmp_path, shape, said):
    with pytest.raises(DeclarationError, match=said):
        load(tmp_path, shape)


@pytest.mark.parametrize(
    ("shapes", "said"),
    [
        (
            ["body: {at: [x, w], size: [l, l]}"],
            "drawing.0.body.at.1: the drawing begins with lengths in m, this is 1/s",
        ),
        (["arm: {pivot: [x, 0], length: l, angle: l}"], "an angle must be a number without unit, not m"),
    ],
)
def test_lengths_of_a_drawing_go_together_and_angles_are_numbers(tmp_path, capsys, shapes, said):
    load(tmp_path, *shapes)
    assert main(["check", str(tmp_path / "model.yaml")]) == 2
    assert said in capsys.readouterr().out


def test_a_child_replaces_the_drawing_of_what_it_extends(tmp_path):
    load(tmp_path, "rod: {ends: [[0, 0], [x, 0]]}")
    child = tmp_path / "child.yaml"
    child.write_text("extends: model.yaml\n", encoding="utf-8")
    assert registry.load_model(child).drawing[0].kinds == ["rod"]
    child.write_text("extends: model.yaml\ndrawing:\n- spring: {ends: [[0, 0], [x, 0]]}\n", encoding="utf-8")
    assert [shape.kinds for shape in registry.load_model(child).drawing] == [["spring"]]


def test_numbers_of_a_shape_are_those_of_its_expressions(tmp_path):
    model = load(tmp_path, "arm: {pivot: [x, 1.5*l], length: l, angle: th, bob: l/10}")
    drawing = Drawing("", "m", ("th", "x"), model.drawing, {"l": 2.0, "w": 1.0})
    assert drawing.numbers(0.0, [0.3, 0.7]) == [[0.7, 3.0, 2.0, 0.3, 0.2]]


ENDS = "['-x**2 + sin(t)', 'where(x > 0, abs(th), 2)*l'], ['atan2(x, 2)*l', 'max(x, 1, th) - heaviside(th)']"


def test_the_code_of_a_page_computes_the_same_numbers(tmp_path):
    """Its JavaScript is a Python expression, too, but for the choice `a ? b : c`."""
    drawing = Drawing("", "m", ("th", "x"), load(tmp_path, f"rod: {{ends: [{ENDS}]}}").drawing, {"l": 2.0, "w": 1.0})
    code = drawing.code().removeprefix("(q,t)=>")
    code = re.sub(r"\((\(q\[1\]>0\.0\))\?(.*?):(2\.0)\)", r"((\2) if \1 else \3)", code)
    functions = {name: getattr(math, name) for name in ("sin", "atan2", "pow")} | {"abs": abs, "max": max}
    for t, q in ((0.2, [0.3, 0.7]), (1.0, [-0.3, -0.7])):
        found = eval(code, {"Math": SimpleNamespace(**functions), "q": q, "t": t})  # noqa: S307  # made above
        assert found[0] == pytest.approx(drawing.numbers(t, q)[0])


@pytest.mark.parametrize("name", DRAWN)
def test_packaged_drawings_move_with_every_coordinate(name):
    model = registry.load_model(name)
    values = Units.of(model).parameter_values({}, dimensionless=False)
    used = {name for shape in model.drawing for _, x in shape.formulas for name in x.names}
    names = (*model.coordinates, *(name for name in model.states if name in used))
    drawing = Drawing(model.name, "", names, model.drawing, values)
    rest = drawing.numbers(0.0, [0.0] * len(names))
    for i in range(len(names)):
        assert drawing.numbers(0.0, [0.001 * (j == i) for j in range(len(names))]) != rest


def test_the_set_up_the_discs_and_the_pendula_are_drawn():
    assert {"setup", "duffing", "discs", "discs_eccentric", "huygens", "pendula", "setup_springs"} <= set(DRAWN)


def test_a_small_motion_is_magnified_and_a_large_one_is_not():
    t = np.linspace(0.0, 2.0 * np.pi, 241)
    model = registry.load_model("huygens")
    drawing = Drawing("", "", tuple(model.coordinates), model.drawing, {})
    for size, factor in ((0.02, 20), (0.5, 1)):
        motion = size * np.column_stack([np.sin(t), np.sin(t), 0.0 * t])
        (left, right, bottom, top), found = drawing.view(t, motion)
        assert found == factor
        assert left < -2.6 < 1.6 < right  # the wall, and the end of the beam
        assert bottom < -0.12 - 1.13 * math.cos(factor * size) < 0.12 < top


def test_a_page_needs_no_other_file_and_holds_the_motion(run):
    page = masking.animate(run)
    assert page == run / "animation.html"
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"https?://|<link|<script[^>]+src|@import|url\(", text)
    assert "&lt;b&gt;" in text
    assert "<b>" not in text
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])
    t = np.frombuffer(base64.b64decode(data["t"]), "<f4")
    rig, virtual = data["scenes"]
    assert (rig["unit"], [s["kind"] for s in virtual["shapes"]]) == ("", ["ground", "spring", "body", "arm", "arm"])
    th2 = virtual["q"][1]
    series = np.frombuffer(base64.b64decode(th2["data"]), "<i2") / 32767 * th2["size"]
    assert series == pytest.approx(0.3 * np.sin(np.pi * t + 1.0), abs=2e-5)
    assert [trace["title"] for trace in data["traces"]] == ["motion", "inputs"]


def test_a_page_of_a_record_from_elsewhere_runs_nothing_of_it(tmp_path):
    recording = recorded("setup")
    recording.manifest["parameters"]["l"] = "</script><script>alert(1)</script>"
    recording.manifest["columns"] = {"virtual.x1": {"unit": "<img src=x>"}, "input.u1": {"unit": "<img src=y>"}}
    text = masking.animate(recording.save(tmp_path / "run")).read_text(encoding="utf-8")
    assert "alert(1)" not in text
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])
    assert not [line for trace in data["traces"] for line in trace["lines"] if "<img" in line["label"] + trace["unit"]]


def test_parameters_of_the_rig_are_those_of_its_plant_file(run):
    rig, _ = Animation(Recording.load(run)).scenes
    assert rig.drawing.parameters["l"] == pytest.approx(0.004)


@pytest.mark.parametrize("change", [{}, {"declarations": None}, {"declarations": {"virtual": {"name": "x"}}}])
def test_a_system_without_a_drawing_gets_bodies_on_lines(tmp_path, change):
    recording = recorded("setup_lagrangian")
    recording.manifest.update(change)
    folder = recording.save(tmp_path / "run")
    assert "No drawing is declared" in masking.animate(folder).read_text(encoding="utf-8")
    scene = Animation(recording).scenes[-1]
    assert [shape.label for shape in scene.drawing.shapes if shape.kinds == ["body"]] == ["x1", "x2", "x3"]


def test_the_speed_shows_a_period_in_a_second_or_two(run):
    """The first coordinate has a period of 2 s, which is played as fast as it is."""
    shown = Animation(Recording.load(run))
    assert shown.period == pytest.approx(2.0, rel=0.01)
    assert shown.speed == 1.0


@pytest.mark.parametrize(("ending", "begins"), [("png", b"\x89PNG"), ("gif", b"GIF8"), ("svg", b"<?xml")])
def test_pictures_and_films_are_written(run, tmp_path, monkeypatch, ending, begins):
    monkeypatch.setattr(animation_frames, "_LONGEST", 0.1)
    file = masking.animate(f"{run}@1:3", out=tmp_path / "new" / f"a.{ending}")
    assert file.read_bytes().startswith(begins)
    if ending == "svg":
        ET.parse(file)  # noqa: S314  # our own
    with pytest.raises(RecordError, match=rf"holds an earlier result, a\.{ending}"):
        masking.animate(run, out=file)


@pytest.mark.skipif(not animation_frames.films.FFMpegWriter.isAvailable(), reason="there is no ffmpeg")
def test_ffmpeg_writes_an_mp4(run, tmp_path, monkeypatch):
    monkeypatch.setattr(animation_frames, "_LONGEST", 0.5)
    film = masking.animate(f"{run}@1:3", out=tmp_path / "a.mp4").read_bytes()
    assert film[4:8] == b"ftyp"  # ISO/IEC 14496-12, 4.3: the box that such a file begins with
    # The header of the movie (8.2.2, version 0): its time scale and its duration, half a second at 20 frames a second.
    scale, duration = struct.unpack(">II", film[film.index(b"mvhd") + 16 :][:8])
    assert duration / scale == pytest.approx(0.5)


def test_settings_in_the_current_folder_do_not_name_the_program_that_films(run, tmp_path, monkeypatch):
    mark, program = tmp_path / "mark", tmp_path / "own"
    program.write_text(f"#!/bin/sh\ntouch {mark}\n")
    program.chmod(0o755)
    monkeypatch.setattr(animation_frames, "_LONGEST", 0.1)
    with matplotlib.rc_context({"animation.ffmpeg_path": str(program)}), contextlib.suppress(RecordError):
        masking.animate(f"{run}@1:3", out=tmp_path / "a.mp4")
    assert not mark.exists()


def test_what_cannot_be_animated_is_told(capsys, run, tmp_path, monkeypatch):
    assert main(["animate", str(run), "--out", str(tmp_path / "a.avi")]) == 2
    assert "an animation ends in .html, .png, .svg, .gif or .mp4" in capsys.readouterr().err
    assert main(["animate", str(run), "--out", str(tmp_path / "a.png"), "--at", "99"]) == 2
    assert "at 99 s there is nothing: the recording goes from 0 s to 20 s" in capsys.readouterr().err
    still = Recording({"t": [0.0, 1.0], "sensor.s": [0.0, 1.0]}, {}).save(tmp_path / "still")
    assert main(["animate", str(still)]) == 2
    assert "the recording holds no motion to animate" in capsys.readouterr().err
    odd = Recording({"t": [0.0, 1.0], "rig.left mass": [0.0, 1.0]}, {}).save(tmp_path / "odd")
    assert main(["animate", str(odd)]) == 2
    assert "one of left mass is no name of a coordinate; rename its columns" in capsys.readouterr().err
    monkeypatch.setattr(animation_frames.films.FFMpegWriter, "isAvailable", lambda *_: False)
    assert main(["animate", str(run), "--out", str(tmp_path / "a.mp4")]) == 2
    assert "an mp4 file needs ffmpeg, which is not installed; write a .gif or .html file" in capsys.readouterr().err


def test_the_command_prints_the_file(capsys, run):
    assert main(["animate", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"animation": str(run / "animation.html")}


def test_a_recording_in_memory_is_shown_by_a_notebook(run, tmp_path, monkeypatch):
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    tags = []
    reader = HTMLParser()
    reader.handle_starttag = lambda tag, attributes: tags.append((tag, dict(attributes)))
    reader.feed(masking.animate(Recording.load(run))._repr_html_())
    ((tag, attributes),) = tags
    assert tag == "iframe"
    assert attributes["srcdoc"] == masking.animate(run).read_text(encoding="utf-8")
    assert list(empty.iterdir()) == []
    assert masking.animate(Recording.load(run), out="a.png").read_bytes().startswith(b"\x89PNG")
