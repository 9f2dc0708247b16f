"""The command line: each verb, its JSON, its exit status, its messages."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import masking
from masking.app import cli
from masking.app.cli import terminal
from masking.app.cli.main_program import VERBS
from masking.control.exports.target_text import c_name
from masking.model.declaration import catalogue, registry

SHORT = """\
name: short
plant: ideal
virtual: duffing
controller: {rate: continuous}
duration: 20
"""


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return path


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    status = cli.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_list_names_every_packaged_file(capsys):
    status, out, _ = run(capsys, "list", "--json")
    entries = json.loads(out)
    assert status == 0
    for kind in ("model", "plant", "experiment", "dictionary"):
        assert [e["name"] for e in entries if e["kind"] == kind] == catalogue.names(kind)
    assert {"duffing", "huygens", "setup", "discs"} <= {e["name"] for e in entries}


def test_list_loads_no_heavy_package():
    code = (
        "import sys; from masking.app import cli; cli.main(['list']);"
        "sys.exit(any(m in sys.modules for m in ('numpy.linalg', 'sympy.core', 'numba.core', 'pydantic.main')))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_an_interrupt_while_packages_load_is_told_in_one_line(tmp_path):
    code = (
        "import signal, sys; from masking.app.cli import main\n"
        "class Pressed:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'masking.app.workflows.discover': signal.raise_signal(signal.SIGINT)\n"
        f"sys.meta_path.insert(0, Pressed()); sys.argv = {['masking', 'discover', 'r.csv', '--model', 'setup']!r}\n"
        "sys.exit(main())"
    )
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "masking: interrupted; nothing was saved\n")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_of_a_verb_waits_for_a_package_that_is_loading():
    code = (
        "import signal, time; from masking.app.cli import terminal\n"
        "signal.signal(signal.SIGINT, signal.SIG_DFL); terminal.raise_interrupts()\n"
        "load = 'signal.raise_signal(signal.SIGINT); time.sleep(0.2)'\n"
        "exec(compile(load, '<frozen importlib._bootstrap>', 'exec')); print('loaded')\n"
        "try: time.sleep(30)\n"
        "except KeyboardInterrupt: print('interrupted')\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.stdout, ended.stderr) == ("loaded\ninterrupted\n", "")


def test_show_gives_table_4_2_beside_table_b_1(capsys):
    status, out, _ = run(capsys, "show", "setup", "--json")
    content = json.loads(out)
    assert status == 0
    assert content["values"]["w1"] == 12.5521  # Table B.1
    assert content["dimensionless"]["w1"] == pytest.approx(0.9443, abs=5e-5)  # Table 4.2
    assert "latex" in content["accelerations"]["x1''"]


def test_show_typesets_equations_and_parameters(capsys):
    status, out, _ = run(capsys, "show", "duffing")
    assert status == 0
    assert "coupled Duffing oscillators" in out
    assert "x1'' = " in out
    assert "cubic stiffness of oscillator 1" in out


def test_show_of_an_experiment_has_the_four_blocks(capsys, short):
    status, out, _ = run(capsys, "show", short)
    assert status == 0
    for letter in "TDLG":
        assert f"\n{letter}: " in out
    blocks = json.loads(run(capsys, "show", short, "--json")[1])["blocks"]
    assert blocks["T"] == {"x1": "x1", "x2": "x2", "x3": "x3"}
    assert blocks["G"]["dx3''/du3"] == "c3"


def test_show_has_inputs_that_are_series_by_their_names(capsys):
    blocks = json.loads(run(capsys, "show", "cart_felt", "--json")[1])["blocks"]
    assert blocks["D"] == {"x''": "(F(t) - c*x' - k*x)/m"}


def test_show_of_a_plant(capsys):
    status, out, _ = run(capsys, "show", "linear_rig", "--kind", "plant")
    assert status == 0
    assert "s3  x3       x 200 V/m  V  position sensor" in out
    assert "power" in out
    assert [line.split() for line in out.splitlines() if "delay " in line] == [["delay", "delay", "samples", "=", "1"]]
    assert "e = 0.05" in out


@pytest.mark.parametrize(
    "experiments",
    [
        # tests/examples/test_examples.py runs all of them
        pytest.param(["cart_sensors", "duffing_enoc", "huygens_rig"], id="some experiments"),
        pytest.param(catalogue.names("experiment"), id="all experiments", marks=pytest.mark.search),
    ],
)
def test_check_passes_everything_that_is_packaged(capsys, experiments):
    names = [name for kind in ("model", "plant", "dictionary") for name in catalogue.names(kind)] + experiments
    status, out, _ = run(capsys, "check", *names)
    assert status == 1, out  # no problems, but duffing_enoc asks for more than the rig has
    assert out.count("a sound") >= len(names)
    assert out.count("a sound experiment") >= len(experiments)


def test_check_tells_all_problems_with_their_places(capsys, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(
        "name: bad\ncoordinates: {x: {unit: m}}\nparameters:\n  k: {value: 1, unit: N/m}\n  m: {value: -1, unit: kg, "
        "bounds: [0, null]}\nequations:\n  m*x'': -k*y - 2*x'\n",
        encoding="utf-8",
    )
    status, out, _ = run(capsys, "check", path)
    assert status == 2
    assert f"{path}:5:" in out
    assert "m = -1 kg is below its lower bound 0" in out
    assert f"{path}:7:13: " in out
    assert "'y'" in out


def test_check_tells_wrong_dimensions(capsys, tmp_path):
    path = tmp_path / "units.yaml"
    path.write_text(
        "name: units\ncoordinates: {x: {unit: m}}\nparameters:\n  w: {value: 1, unit: rad/s}\n"
        "equations:\n  x'': -w*x\n",
        encoding="utf-8",
    )
    status, out, _ = run(capsys, "check", path)
    assert status == 2
    assert "m/s**2" in out
    assert "m/s" in out


def test_check_tells_effects_that_do_not_fit_a_plant(capsys, tmp_path):
    path = tmp_path / "worn.yaml"
    (packaged,) = registry.load_plant("linear_rig").files
    text = Path(packaged).read_text(encoding="utf-8")
    text = text.replace("effect: noise", "effect: noize").replace(
        "at: spring2, parameters: {fc", "at: spring2, parameters: {f"
    )
    path.write_text(text, encoding="utf-8")
    status, out, _ = run(capsys, "check", path)
    assert status == 2
    assert "effects.noise.effect: there is no effect 'noize'; did you mean 'noise'?" in out
    assert "effects.friction2: the effect dry_friction needs fc" in out


@pytest.mark.parametrize("kind", ["model", "plant", "experiment", "dictionary"])
def test_schema_describes_the_packaged_files(capsys, kind):
    status, out, _ = run(capsys, "schema", kind)
    properties = json.loads(out)["properties"]
    assert status == 0
    for name in catalogue.names(kind):
        keys = set(yaml.safe_load(catalogue.find(kind, name).read_text(encoding="utf-8")))
        assert keys <= set(properties)


def test_run_saves_a_recording_and_a_report(capsys, short, tmp_path):
    out = tmp_path / "out"
    status, printed, _ = run(capsys, "run", short, "--out", out)
    assert status == 0
    assert "The ideal rig moved as coupled Duffing oscillators" in printed
    assert {"recording.parquet", "manifest.json", "report.html"} <= {p.name for p in out.iterdir()}
    recording = masking.Recording.load(out)
    assert max(recording.manifest["masking_error"].values()) < 1e-6
    (out / "report.html").unlink()
    status, printed, _ = run(capsys, "report", out, "--json")
    assert status == 0
    assert Path(json.loads(printed)["report"]).is_file()


def test_set_changes_a_parameter_of_the_virtual_system(capsys, short, tmp_path):
    status, printed, _ = run(capsys, "run", short, "--set", "w3=0.6", "--out", tmp_path / "out", "--json")
    assert status == 0
    assert max(json.loads(printed)["masking_error"].values()) < 1e-6
    assert masking.Recording.load(tmp_path / "out").manifest["parameters"]["w3"] == 0.6


def test_check_with_other_values_says_what_it_says_of_a_file_with_them(capsys, tmp_path):
    """A file that has these values is the truth."""
    written, other = tmp_path / "a.yaml", tmp_path / "b.yaml"
    other.write_text(SHORT, encoding="utf-8")
    written.write_text(f"{SHORT}parameters: {{w1: 2, z3: 0.2}}\n", encoding="utf-8")
    _, wanted, _ = run(capsys, "check", written, "--json")
    _, found, _ = run(capsys, "check", other, "--set", "w1=2", "--set", "z3=0.2", "--json")
    _, declared, _ = run(capsys, "check", other, "--json")
    assert json.loads(found)[0] | {"file": str(written)} == json.loads(wanted)[0]
    assert json.loads(found) != json.loads(declared)
    status, found, _ = run(capsys, "check", "duffing", "tue_rig", "--set", "w9=1", "--set", "self=2")
    assert status == 2
    assert "w9: coupled Duffing oscillators has no parameter 'w9'; did you mean" in found  # the model
    assert "'self' is not a parameter of coupled Duffing oscillators" in found  # the experiment
    assert "--set: values of a plant stand in its file; change them there" in found


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "duffin"], "there is no experiment 'duffin'; did you mean 'duffing'?"),
        (["run", "duffing", "--set", "w3"], "'w3' is not a change of a parameter; write it as in --set w3=0.6"),
        (["run", "duffing", "--set", "w9=1"], "'w9' is not a parameter of coupled Duffing oscillators; did you mean"),
        (["run", "duffing", "--plant", "idea"], "there is no plant 'idea'; did you mean 'ideal'?"),
        (["show", "huigens"], "there is no model, plant, experiment or dictionary 'huigens'; did you mean 'huygens'?"),
        (["report", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line_with_status_2(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert said in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "now"),
    [
        (["--between", "straight"], "--between is called --hold now"),
        (["--horizon=0.2"], "--horizon is called --shooting-interval now"),
        (["--fidelity"], "--fidelity is called --masking-error now"),
        (["--colour"], "unrecognized arguments: --colour"),
        (["--hold", "straight"], "choose from"),
    ],
)
def test_an_option_that_was_renamed_is_refused_with_its_new_name(capsys, option, now):
    with pytest.raises(SystemExit) as caught:
        cli.main(["discover", "record", "--model", "setup", *option])
    assert caught.value.code == 2
    assert now in capsys.readouterr().err


@pytest.mark.parametrize("verb", [one.name for one in VERBS])
def test_every_verb_has_help(capsys, verb):
    with pytest.raises(SystemExit) as caught:
        cli.main([verb, "--help"])
    assert caught.value.code == 0
    assert f"usage: masking {verb}" in capsys.readouterr().out


def test_an_unknown_verb_is_refused(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["dance"])
    assert caught.value.code == 2
    assert "dance" in capsys.readouterr().err


def test_the_wheel_carries_models_plants_and_examples():
    text = (Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8")
    for folder in ("models", "plants", "examples", "dictionaries"):
        assert f'"{folder}" = "masking/shipped/{folder}"' in text


@pytest.mark.parametrize(
    ("mass", "said"),
    [
        ("0", "the matrix of the accelerations is singular at the declared values; look for a mass that is 0 (m = 0)"),
        ("-0.2", "the kinetic energy is not positive at the declared values"),
    ],
)
def test_check_refuses_masses_that_cannot_be(capsys, tmp_path, mass, said):
    path = tmp_path / "pendulum.yaml"
    path.write_text(
        f"name: pendulum\ncoordinates: {{th: {{initial: 0.1}}}}\nparameters: {{m: {mass}, g: 9.81}}\n"
        "lagrangian: m*(th'**2/2 + g*cos(th))\n",
        encoding="utf-8",
    )
    status, out, _ = run(capsys, "check", path)
    assert status == 2
    assert said in out


def test_a_transform_that_is_not_invertible_is_refused(capsys, tmp_path):
    path = tmp_path / "flat.yaml"
    path.write_text(SHORT + "transform: {matrix: [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}\n", encoding="utf-8")
    status, out, _ = run(capsys, "check", path)
    assert status == 2
    assert "transform: not invertible: x1, x2, x3 do not move independently" in out
    assert "none depends on x2" in out


def test_an_unstable_sampled_loop_is_told_as_such_and_keeps_the_last_recording(capsys, short, tmp_path):
    out = tmp_path / "out"
    assert run(capsys, "run", short, "--out", out)[0] == 0
    before = (out / "recording.parquet").read_bytes()
    short.write_text(
        SHORT.replace("continuous", "20 Hz, observer: exact").replace("duration: 20", "duration: 2000"),
        encoding="utf-8",
    )
    status, printed, err = run(capsys, "run", short, "--out", out, "--overwrite")
    assert status == 1
    assert printed == ""
    assert "the masked rig became unstable and grew without bound" in err
    assert "raise controller.rate, or try 'rate: continuous'" in err
    assert f"{out} still holds the run of " in err
    assert (out / "recording.parquet").read_bytes() == before


def test_a_folder_that_cannot_be_written_is_refused_before_the_run(capsys, short, tmp_path):
    occupied = tmp_path / "occupied"
    occupied.write_text("mine", encoding="utf-8")
    status, _, err = run(capsys, "run", short, "--out", occupied)
    assert status == 2
    assert f"{occupied} is a file; name a folder to save in" in err
    assert occupied.read_text(encoding="utf-8") == "mine"


def test_progress_is_written_in_lines_where_there_is_no_terminal(monkeypatch, capsys):
    with terminal.Bar("reading") as bar:
        bar.tell("screening", 0.2)  # too soon after the beginning
        monkeypatch.setattr(terminal, "APART", -1.0)
        bar.tell("fitting", 0.3)
        bar.tell("screening once more", 0.2)  # a search that begins anew
    assert capsys.readouterr().err == " 30%  fitting\n 30%  screening once more\n"


def test_export_says_what_was_written_and_what_is_wrong(capsys, short, tmp_path):
    status, printed, _ = run(capsys, "export", short, "--to", "c", "--set", "w3=0.6", "--out", tmp_path / "c", "--json")
    content = json.loads(printed)
    assert status == 0
    assert content["kind"] == "law"
    assert all(Path(file).is_file() for file in content["files"])
    names = {Path(file).name for file in content["files"]}
    assert {c_name("short") + end for end in (".h", ".c", "_linux.c")} <= names  # short is a keyword of C
    status, _, error = run(capsys, "export", "duffing", "--kind", "model", "--to", "c", "--rate", "0")
    assert status == 2
    assert "--rate: 0 is no positive number; give one, such as 1000" in error


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that takes nothing, /dev/full")
def test_a_full_disk_behind_standard_output_is_said_in_a_line():
    command = [sys.executable, "-m", "masking", "show", "duffing"]
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        ran = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        assert (ran.returncode, ran.stderr.count("\n")) == (1, 1)
        assert "make room" in ran.stderr
        ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=full, text=True, check=False)
        assert (ran.returncode, ran.stdout[:1] != "") == (0, True)
