"""Adapters: found by the scheme of an address, the rules of a plant kept by each, and an experiment on each.

The rig is a cart on a spring: by its twin, by MuJoCo, as an FMU, behind a serial line, and on a stub of NI-DAQmx.
"""

import importlib
import json
import os
import re
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from masking.app import cli
from masking.control.exports.fmu_unit import has_binary, write
from masking.control.exports.rig_units import twin_unit
from masking.control.rig.twin import Twin
from masking.errors import PlantError, PlantLostError, PlantMismatchError
from masking.lab.plants import adapters, address, conformance, operating_system, zero_after_kill
from masking.lab.plants.controller_session import Allowed
from masking.lab.plants.interface import Holding, Settings
from masking.lab.plants.serve import Serving
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.wire import Kind, Splitter, decode, encode, to_stream
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from tests.support import nidaqmx_stub

pytestmark = pytest.mark.realtime

MASS, STIFFNESS, DAMPING = 0.5, 200.0, 0.4
RATE = 500.0
MODEL = {
    "name": "cart on a spring",
    "coordinates": {"x": {"unit": "m"}},
    "inputs": {"F": {"unit": "N"}},
    "parameters": {
        "m": {"value": MASS, "unit": "kg"},
        "k": {"value": STIFFNESS, "unit": "N/m"},
        "c": {"value": DAMPING, "unit": "N*s/m"},
    },
    "equations": {"x''": "(F - k*x - c*x')/m"},
}
RIG = {
    "name": "cart with an encoder and a voice coil",
    "kind": "simulated",
    "model": "cart.yaml",
    "sensors": {"x": {"measures": "x", "unit": "m"}},
    "limits": {"inputs": {"F": {"max": 5, "unit": "N"}}},
}
VIRTUAL = {
    "name": "hardening oscillator",
    "coordinates": {"x": {"initial": 0.01, "unit": "m"}},
    "parameters": {"w": {"value": 15, "unit": "rad/s"}, "b": {"value": 1e6, "unit": "1/m**2/s**2"}},
    "equations": {"x''": "-w**2*x - b*x**3"},
}
EXPERIMENT = {
    "name": "the cart as a hardening oscillator",
    "virtual": "hardening.yaml",
    "controller": {"rate": "500 Hz", "observer": {"kind": "disturbance", "noise": 1e-6}, "homing": 1},
    "initial": {"x": 0.01},
    "duration": 1,
}
DELAYED = {**RIG, "effects": {"delay": {"effect": "delay", "parameters": {"samples": 1}}}}
FILES = {
    "cart.yaml": MODEL,
    "rig.yaml": RIG,
    "delayed.yaml": DELAYED,
    "hardening.yaml": VIRTUAL,
    "experiment.yaml": {**EXPERIMENT, "plant": "rig.yaml"},
    "delayed_experiment.yaml": {**EXPERIMENT, "plant": "delayed.yaml"},
}
MJCF = f"""
<mujoco model="cart">
  <option timestep="0.0015" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="track" type="slide" axis="1 0 0" stiffness="{STIFFNESS}" damping="{DAMPING}"/>
      <geom type="box" size="0.1 0.05 0.05" mass="{MASS}" contype="0" conaffinity="0"/>
      <site name="tip"/>
    </body>
  </worldbody>
  <actuator><motor name="coil" joint="track" ctrlrange="-5 5"/></actuator>
  <sensor>
    <accelerometer site="tip"/>
    <framepos name="where" objtype="site" objname="tip"/>
    <jointpos name="encoder" joint="track"/>
  </sensor>
  <keyframe><key name="pulled" qpos="0.02"/></keyframe>
</mujoco>
"""
NEEDS_FMU = pytest.mark.skipif(not has_binary(), reason="FMUs get no binary on this machine")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files of the rig."""
    made = tmp_path_factory.mktemp("cart")
    for name, content in FILES.items():
        (made / name).write_text(json.dumps(content), encoding="utf-8")
    (made / "cart.xml").write_text(MJCF, encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def experiment(folder):
    return Experiment.load(folder / "experiment.yaml")


@pytest.fixture(scope="module")
def offline(experiment):
    return experiment.run()


@contextmanager
def serving(plant, where, **options):
    """Serve a plant in a thread; give its address."""
    is_ready, is_over, found = threading.Event(), threading.Event(), []

    def ready(served_at):
        found.append(served_at)
        is_ready.set()

    thread = threading.Thread(
        target=lambda: rig_run.serve(plant, where, Serving(**options), stop=is_over.is_set, ready=ready), daemon=True
    )
    thread.start()
    assert is_ready.wait(60.0)
    try:
        yield found[0]
    finally:
        is_over.set()
        thread.join(20.0)


@pytest.fixture
def card(monkeypatch):
    """Return a card of a stub of NI-DAQmx."""
    made = nidaqmx_stub.Card(MASS, STIFFNESS, DAMPING)
    for name, module in nidaqmx_stub.stub(made).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "masking.lab.plants.nidaqmx", raising=False)
    return made


NI = "nidaqmx://Dev1?sensors=x:ai0&actuators=F:ao0"


@pytest.fixture(scope="module")
def fmus(folder, experiment):
    """Return FMUs of the twin, of FMI 2.0 and 3.0."""
    pytest.importorskip("fmpy", reason="fmpy is not installed: pip install 'masking[fmu]'")
    return write(twin_unit(experiment.twin, "cart", RATE), folder)


def needs_mujoco():
    return pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'masking[mujoco]'")


# --- addresses and entry points ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "scheme", "place", "options"),
    [
        ("serial:///dev/ttyACM0?baud=9600", "serial", "/dev/ttyACM0", {"baud": "9600"}),
        ("serial:COM3", "serial", "COM3", {}),
        ("MUJOCO:sub%20folder/a.xml", "mujoco", "sub folder/a.xml", {}),
        ("nidaqmx://Dev1?a=1&b=", "nidaqmx", "Dev1", {"a": "1", "b": ""}),
    ],
)
def test_an_address_is_split(text, scheme, place, options):
    found = address.parse(text, ("a", "b", "baud"))
    assert (found.scheme, found.place, dict(found.options)) == (scheme, place, options)


def test_what_no_address_is_has_no_scheme():
    assert [address.scheme_of(text) for text in ("rig.yaml", "C:\\rig.yaml", "tue_rig", "", "127.0.0.1:5")] == [""] * 5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "",
            "'' is no address of a plant; write it as udp://127.0.0.1:5005, or with another scheme that is installed:",
        ),
        ("udp", "'udp' is no address of a plant"),
        ("udp:", "'udp:' is no address of a plant; write it as udp://127.0.0.1:5005"),
        (
            "telepathy://him",
            "no adapter has the scheme 'telepathy'; install the package that has it; there are fmu, mujoco,",
        ),
        ("serial:///dev/x?bauds=1", "'bauds' is no option of this address; did you mean 'baud'?"),
        ("serial:///dev/x?baud=1&baud=2", "'baud' is no option of this address; give it once"),
        ("serial:///dev/x?baud=fast", "baud is 'fast'; give a positive number"),
        ("serial:?baud=1", "is no address of a plant; write it as serial:///dev/ttyACM0"),
    ],
)
def test_a_wrong_address_is_refused_with_what_to_write(text, said):
    with pytest.raises(PlantMismatchError) as refused:
        adapters.connect(text)
    assert said in str(refused.value)


def test_every_adapter_of_the_package_is_an_entry_point():
    assert {"fmu", "mujoco", "nidaqmx", "serial", "udp"} <= set(adapters.schemes()), "install the package anew"


OUTSIDE = """
from masking.lab.plants.interface import Sample
from masking.lab.plants.stepped import SteppedPlant
import numpy as np

class Spring(SteppedPlant):
    def __init__(self, address):
        super().__init__(("x",), ("F",))
    def begin(self, settings):
        self.x = 0.0
    def step(self, command):
        self.x = command[0] / 200.0
    def readings(self):
        return np.array([self.x])
    def end(self):
        pass

class Deaf(Spring):
    def write(self, index, command):
        self._life.need_active("write")

def broken(address):
    raise ZeroDivisionError("of a driver")

def lacking(address):
    import a_library_that_nobody_has
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Return a function that installs a package with adapters, without pip, and forgets it after the test."""

    def install(name, *lines):
        (tmp_path / f"{name}.py").write_text(OUTSIDE, encoding="utf-8")
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\nProvides-Extra: lacking\n"
        (info / "METADATA").write_text(metadata, encoding="utf-8")
        entries = "\n".join(["[masking.plants]", *lines]) + "\n"
        (info / "entry_points.txt").write_text(entries, encoding="utf-8")
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()

    return install


def test_an_adapter_outside_of_the_package_is_found(installed, capsys):
    installed("their_rig", "spring = their_rig:Spring")
    assert "spring" in adapters.schemes()
    plant = adapters.connect("spring:here")
    assert type(plant).__module__ == "their_rig"
    assert cli.main(["rig", "check", "spring:here"]) == 0
    said = capsys.readouterr().out
    assert said.endswith("spring:here conforms\n")
    assert said.count("passes  ") == len(conformance.RULES)


def test_the_adapter_of_the_documentation_is_found_and_keeps_the_rules(tmp_path, installed, monkeypatch, capsys):
    text = (Path(__file__).parents[3] / "docs" / "adapter.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"^```python\n# (my_\w+)\.py\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    (entry,) = re.findall(
        r'^```toml\n\[project.entry-points."masking.plants"\]\n(\S+) = "(\S+)"\n```$', text, re.MULTILINE
    )
    for name, block in blocks.items():
        (tmp_path / f"{name}.py").write_text(block, encoding="utf-8")
        monkeypatch.delitem(sys.modules, name, raising=False)
    installed("my_package", " = ".join(entry))
    assert cli.main(["rig", "check", "my-rig:lab", "--amplitude", "0.001"]) == 0
    assert capsys.readouterr().out.endswith("my-rig:lab conforms\n")


def test_the_guide_shows_what_a_check_prints():
    text = (Path(__file__).parents[3] / "docs" / "connect.md").read_text(encoding="utf-8")
    shown = re.findall(r"^    passes  (.+)$", text, re.MULTILINE)
    assert shown == [str(rule.__doc__).removesuffix(".") for rule in conformance.RULES]


def test_a_check_prints_what_fails(installed, capsys):
    installed("their_rig", "deaf = their_rig:Deaf")
    assert cli.main(["rig", "check", "deaf:here"]) == 1
    said = capsys.readouterr().out
    assert "fails  A command is finite\n        a command of nan was accepted; it must be refused with a Plant" in said
    assert said.endswith("deaf:here does not conform\n")
    assert cli.main(["rig", "check", "deaf:here", "--json"]) == 1
    rules = json.loads(capsys.readouterr().out)["rules"]
    assert len(rules) == len(conformance.RULES)
    assert rules[1] == {"rule": "A configured plant names its channels", "broken": []}


@pytest.mark.parametrize(
    ("lines", "where", "said", "kind"),
    [
        (
            ["spring = their_rig:Spring", "udp = their_rig:Spring"],
            "udp://127.0.0.1:1",
            "with the scheme 'udp'; uninst",
            0,
        ),
        (["broken = their_rig:broken"], "broken:it", "their_rig:broken failed: ZeroDivisionError: of a driver", 1),
        (["lacking = their_rig:lacking"], "lacking:it", "pip install 'their_rig[lacking]'", 0),
        (["gone = not_their_rig:Spring"], "gone:it", "No module named 'not_their_rig'); install what it needs", 0),
        (["gone = their_rig:Gone"], "gone:it", "their_rig:Gone failed: AttributeError", 1),
    ],
    ids=["twice", "broken", "extra", "module", "name"],
)
def test_an_adapter_that_cannot_be_used_is_named(installed, lines, where, said, kind):
    installed("their_rig", *lines)
    with pytest.raises([PlantMismatchError, PlantError][kind]) as refused:
        adapters.connect(where)
    assert said in str(refused.value)


def test_a_missing_library_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    monkeypatch.delitem(sys.modules, "masking.lab.plants.serial", raising=False)
    with pytest.raises(
        PlantMismatchError, match=r"adapter of masking cannot be loaded .*; pip install 'masking\[serial\]'"
    ):
        adapters.connect("serial:COM1")


def test_a_plant_is_served_only_where_frames_can_go(folder):
    with pytest.raises(PlantMismatchError, match=r"cannot be served at; use udp://127\.0\.0\.1:5005 or serial:pty"):
        rig_run.serve(folder / "rig.yaml", f"mujoco:{folder / 'cart.xml'}", Serving())


def test_the_amplitude_of_a_check_is_within_the_limits(capsys):
    check = ["rig", "check", "udp://127.0.0.1:9", "--plant", "tue_rig"]
    assert cli.main([*check, "--amplitude", "0.43"]) == 2
    assert "the amplitude is 0.43, where the plant file allows 0.42; give less" in capsys.readouterr().err


@pytest.mark.parametrize("amplitude", ["0", "-1", "nan", "inf"])
def test_the_amplitude_of_a_check_is_a_positive_number(amplitude, capsys):
    assert cli.main(["rig", "check", "udp://127.0.0.1:9", "--amplitude", amplitude]) == 2
    assert "give a positive number in the actuators' units" in capsys.readouterr().err


def test_a_check_of_a_plant_that_does_not_answer_says_so_once(capsys):
    assert cli.main(["rig", "check", "udp://127.0.0.1:9"]) == 1
    assert capsys.readouterr().err.startswith("masking: no plant answers at udp://127.0.0.1:9; start it with")


# --- every adapter keeps the rules, and runs the experiment -----------------------------------------------------------


def ran(folder, where, out, *options, name="experiment.yaml"):
    """Run the experiment through the command line; return chi and why the run ended."""
    command = ["rig", "run", str(folder / name), "--plant", where, "--out", str(out), "--json", *options]
    assert cli.main(command) == 0
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    return manifest["masking_error"]["x"], manifest["rig"]["end"]


def assert_same(out, offline, within):
    """Compare the sensors of a run with those offline, in parts of the largest."""
    from masking.lab.records.recording import Recording

    found, expected = Recording.load(out)["sensor.x"], offline["sensor.x"]
    assert len(found) == len(expected)
    assert np.max(np.abs(found - expected)) <= within * np.max(np.abs(expected))


def test_mujoco_is_a_plant(folder, offline, tmp_path, capsys):
    needs_mujoco()
    where = f"mujoco:{folder / 'cart.xml'}?sensors=x:encoder&actuators=F:coil"
    assert cli.main(["rig", "check", where]) == 0
    chi, end = ran(folder, where, tmp_path / "out", "--lockstep")
    assert end == "finished"
    assert chi < 1e-5
    assert_same(tmp_path / "out", offline, 1e-6)  # two engines; that of MuJoCo has steps of 1 ms


def test_mujoco_in_real_time(folder, tmp_path, capsys):
    needs_mujoco()
    where = f"mujoco:{folder / 'cart.xml'}?sensors=x:encoder&actuators=F:coil"
    chi, end = ran(folder, where, tmp_path / "out")
    assert end == "finished"
    assert chi < 1e-2


def test_names_of_an_mjcf_file(folder):
    needs_mujoco()
    where = f"mujoco:{folder / 'cart.xml'}"
    plant = adapters.connect(where)
    assert plant.sensors == ("where", "where.1", "where.2", "encoder")  # the accelerometer has no name
    assert plant.actuators == ("coil",)
    pulled = adapters.connect(f"{where}?sensors=encoder,y:where&key=pulled")
    pulled.configure(Settings(RATE))
    pulled.activate()
    assert pulled.read().values.tolist() == [0.02, 0.02]
    pulled.deactivate()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("?sensors=encodr", "there is no 'encodr' for sensors; did you mean 'encoder'?"),
        ("?actuators=a:coil,a:coil", "let each name stand once"),
        ("?sensors=encoder,", "write them as a,b or as name:a,other:b"),
        ("?key=pushed", "there is no keyframe 'pushed'; there are pulled"),
    ],
)
def test_what_an_mjcf_file_does_not_have_is_refused(folder, options, said):
    needs_mujoco()
    with pytest.raises(PlantMismatchError) as refused:
        adapters.connect(f"mujoco:{folder / 'cart.xml'}{options}")
    assert said in str(refused.value)


@pytest.mark.parametrize("content", [None, "<mujoco><nonsense/></mujoco>", "no xml", "<mujoco/>"])
def test_a_file_that_is_no_mjcf_is_refused(tmp_path, content):
    needs_mujoco()
    path = tmp_path / "rig.xml"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(PlantMismatchError, match=r"rig\.xml: "):
        adapters.connect(f"mujoco:{path}")


def test_a_simulation_that_blows_up_is_lost(tmp_path, monkeypatch):
    needs_mujoco()
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes a log
    (tmp_path / "cart.xml").write_text(MJCF.replace('stiffness="200.0"', 'stiffness="1e9"'), encoding="utf-8")
    plant = adapters.connect(f"mujoco:{tmp_path / 'cart.xml'}?key=pulled&sensors=encoder")
    plant.configure(Settings(RATE))
    plant.activate()
    with pytest.raises(PlantError, match=r"became unstable at .* s; give it a shorter timestep"):
        for _ in range(100):
            plant.write(plant.read().index, np.zeros(1))
    plant.deactivate()


@NEEDS_FMU
@pytest.mark.filterwarnings("ignore")  # fmpy's own
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_is_a_plant(folder, fmus, offline, version, tmp_path):
    where = f"fmu:{fmus[version - 2]}?actuators=F"
    assert cli.main(["rig", "check", where, "--rate", f"{RATE:g}"]) == 0
    chi, end = ran(folder, where, tmp_path / "out", "--lockstep")
    assert end == "finished"
    assert chi < 1e-5
    assert_same(tmp_path / "out", offline, 1e-12)


@NEEDS_FMU
@pytest.mark.filterwarnings("ignore")  # fmpy's own
def test_an_fmu_says_what_it_cannot(fmus, tmp_path):
    plant = adapters.connect(f"fmu:{fmus[0]}?actuators=F")
    plant.configure(Settings(333.0))
    plant.activate()
    with pytest.raises(PlantError, match=r"has stopped \(FMICallException: .*\); a step of another length may do"):
        plant.write(plant.read().index, np.zeros(1))
    plant.deactivate()
    with pytest.raises(PlantMismatchError, match="there is no 'G' for actuators"):
        adapters.connect(f"fmu:{fmus[0]}?actuators=G")
    with pytest.raises(PlantMismatchError, match=r"there is no file 'none\.fmu'"):
        adapters.connect("fmu:none.fmu")
    (tmp_path / "text.fmu").write_text("no archive", encoding="utf-8")
    with pytest.raises(PlantMismatchError, match="no FMU that fmpy reads"):
        adapters.connect(f"fmu:{tmp_path / 'text.fmu'}")


def test_a_card_is_a_plant(folder, card, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(zero_after_kill, "Holding", type(None))  # this card is in no other process
    assert cli.main(["rig", "check", NI]) == 0
    assert not any(card.outputs.values())
    assert not card.taken
    chi, end = ran(folder, NI, tmp_path / "out", name="delayed_experiment.yaml")
    assert end == "finished"
    assert chi < 1e-2
    assert max(np.abs(card.written)) > 0.1
    assert_same(tmp_path / "out", Experiment.load(folder / "delayed_experiment.yaml").run(), 1e-8)  # Runge-Kutta
    assert not any(card.outputs.values())


def test_the_outputs_of_a_card_that_another_process_left_are_put_to_zero(card):
    plant = adapters.connect(NI)
    assert isinstance(plant, Holding)
    card.outputs["ao0"] = 1.5
    adapters.connect(plant.address).rest()
    assert not any(card.outputs.values())
    assert not card.taken


def test_a_card_counts_edges_and_says_what_is_wrong(card):
    plant = adapters.connect(NI + "&range=2")
    settings = Settings(1000.0, watchdog=0.02)
    plant.configure(settings)
    plant.activate()
    assert plant.read().index == 0
    plant.write(0, np.array([9.0]))
    assert plant.telemetry() == {"applied.F": 2.0}
    card.skipped = 3
    assert plant.read().index == 4
    card.skipped = 25
    with pytest.raises(PlantLostError, match="no command for 30 samples; its outputs are zero, start anew"):
        plant.read()
    assert not any(card.outputs.values())
    plant.configure(settings)
    plant.activate()
    card.broken = "The cable\nis off."
    with pytest.raises(PlantLostError, match=r"Dev1: The cable is off\.; look at the card"):
        plant.read()
    plant.deactivate()
    with pytest.raises(PlantMismatchError, match="Dev1 keeps its own time; leave out lockstep"):
        plant.configure(Settings(1000.0, lockstep=True))
    with pytest.raises(PlantMismatchError, match=r"too high\.; correct the address or controller\.rate"):
        plant.configure(Settings(1e5))
    with pytest.raises(PlantMismatchError, match="does not exist"):
        adapters.connect(NI.replace("ai0", "ai9")).configure(settings)
    with pytest.raises(PlantMismatchError, match="name the actuators, as in nidaqmx://"):
        adapters.connect("nidaqmx://Dev1?sensors=ai0")
    assert not card.taken


# --- serial -----------------------------------------------------------------------------------------------------------

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo terminals")


@pytest.fixture
def pyserial():
    pytest.importorskip("serial", reason="pyserial is not installed: pip install 'masking[serial]'")
    return importlib.import_module("masking.lab.plants.serial")


@needs_pty
def test_a_twin_behind_a_serial_line_is_a_plant(pyserial, folder, offline, tmp_path, capsys):
    with serving(folder / "rig.yaml", "serial:pty", clock="lockstep") as where:
        assert where.startswith("serial:///dev/")
        assert cli.main(["rig", "check", where, "--lockstep"]) == 0
        chi, end = ran(folder, where, tmp_path / "out", "--lockstep")
    assert end == "finished"
    assert chi < 1e-5
    assert_same(tmp_path / "out", offline, 0.0)


@needs_pty
def test_a_twin_behind_a_serial_line_keeps_time(pyserial, folder):
    with serving(folder / "delayed.yaml", "serial:pty", allowed=Allowed(watchdog=5.0)) as where:
        assert cli.main(["rig", "check", where]) == 0
        delayed = Experiment.load(folder / "delayed_experiment.yaml")
        found = rig_run.run(
            delayed, adapters.connect(where), rig_run.RunSettings(watchdog=5.0)
        )  # both sides are in this process
    assert found.manifest["rig"]["end"] == "finished"
    assert found.manifest["masking_error"]["x"] < 0.1


def test_a_plant_of_another_program_is_served(folder):
    needs_mujoco()
    with serving(f"mujoco:{folder / 'cart.xml'}?sensors=encoder", "udp://127.0.0.1:0", clock="lockstep") as where:
        assert conformance.check(lambda: adapters.connect(where), Settings(1000.0, 1.0, lockstep=True)) == []


@needs_pty
def test_a_port_that_is_not_there_or_does_not_answer_is_named(pyserial):
    with pytest.raises(PlantLostError, match=r"serial:///dev/nothing cannot be reached \(.*\); look at its name and"):
        adapters.connect("serial:///dev/nothing").configure(Settings(1000.0))
    with pytest.raises(PlantMismatchError, match=r"serial:///dev/nothing cannot be served \(.*\); choose another port"):
        adapters.listen("serial:///dev/nothing")
    number, other = os.openpty()
    try:
        silent = pyserial.SerialPlant(f"serial://{os.ttyname(other)}", patience=0.3)
        with pytest.raises(PlantLostError, match="look at its cable, its baud rate, and the program on the board"):
            silent.configure(Settings(1000.0))
    finally:
        os.close(number)
        os.close(other)


@needs_pty
def test_a_cable_that_is_pulled_out_is_a_lost_plant(pyserial, folder):
    plant = SimulatedPlant(Twin.load(folder / "rig.yaml"))
    hub = adapters.listen("serial:pty")
    serving_thread = threading.Thread(target=lambda: play(hub, plant))
    serving_thread.start()
    remote = adapters.connect(hub.address)
    remote.configure(Settings(RATE, lockstep=True))
    remote.activate()
    assert remote.read().index == 0
    serving_thread.join(20.0)
    hub.close()
    with pytest.raises(PlantLostError, match="is gone"):
        for _ in range(3):
            remote.write(0, np.zeros(1))
            remote.read()
    remote.deactivate()


def play(hub, plant):
    """Accept one controller and send it one sample."""
    from masking.lab.plants.wire import channels_text

    kind = None
    while kind is not Kind.START:
        assert hub.waits(20.0)
        received, peer = hub.receive()
        frame = decode(received)
        kind = frame.kind
        if kind is Kind.HELLO:
            text = channels_text(plant.sensors, plant.actuators)
            hub.send(encode(Kind.ACCEPT, frame.session, text=text), peer)
    hub.send(encode(Kind.SENSORS, frame.session, 0, values=np.zeros(1)), peer)


class Slow:
    """A port that takes a few bytes at a time, or none."""

    def __init__(self):
        self.sent, self.room = b"", 10

    def write(self, data):
        taken = data[: self.room]
        self.sent += taken
        return len(taken)


def test_a_frame_goes_out_whole_or_not_at_all(pyserial):
    port = Slow()
    line = pyserial.SerialLine(port)
    line.send(b"a" * 30)
    for _ in range(2):
        with pytest.raises(BlockingIOError):
            line.send(b"b" * 30)
    port.room = 1000
    line.send(b"c")
    assert Splitter().feed(port.sent) == [b"a" * 30, b"c"]


@pytest.mark.parametrize(
    ("frame", "stream"),
    [  # Cheshire and Baker's rules by hand
        (b"\0", "01 01 00"),
        (b"\0\0", "01 01 01 00"),
        (b"\x11\x22\0\x33", "03 11 22 02 33 00"),
        (b"\x11\0\0\0", "02 11 01 01 01 00"),
        (bytes(range(1, 255)), "ff " + bytes(range(1, 255)).hex() + " 00"),
        (bytes(range(255)), "01 ff " + bytes(range(1, 255)).hex() + " 00"),
        (bytes(range(1, 256)), "ff " + bytes(range(1, 255)).hex() + " 02 ff 00"),
        (bytes(range(2, 256)) + b"\0", "ff " + bytes(range(2, 256)).hex() + " 01 01 00"),
    ],
)
def test_frames_on_a_stream(frame, stream):
    assert to_stream(frame) == bytes.fromhex(stream)
    assert Splitter().feed(to_stream(frame)) == [frame]


@given(st.lists(st.binary(min_size=1, max_size=600), max_size=4), st.binary(max_size=40), st.integers(1, 50))
def test_frames_are_found_behind_whatever_came_before(frames, noise, size):
    data = noise + b"\0" + b"".join(map(to_stream, frames))
    splitter = Splitter()
    found = [frame for i in range(0, len(data), size) for frame in splitter.feed(data[i : i + size])]
    assert found[len(found) - len(frames) :] == frames


def test_a_stream_without_an_end_takes_no_memory():
    splitter = Splitter()
    for _ in range(100):
        splitter.feed(b"x" * 10_000)
    assert splitter.feed(b"\0" + to_stream(b"frame"))[-1] == b"frame"


# --- the machine ------------------------------------------------------------------------------------------------------


def test_signals_that_a_system_does_not_have_are_left_out(monkeypatch):
    import signal

    kept = {name: getattr(signal, name) for name in ("SIGHUP",) if hasattr(signal, name)}
    try:
        for name in kept:
            monkeypatch.delattr(signal, name)
        found = importlib.reload(operating_system).STOPPING
        assert [number.name for number in found] == ["SIGINT", "SIGTERM"]
    finally:
        monkeypatch.undo()
        importlib.reload(operating_system)
    assert [number.name for number in operating_system.STOPPING][:2] == ["SIGINT", "SIGTERM"]


def test_a_system_without_priorities_says_so(monkeypatch):
    monkeypatch.setattr(operating_system.sys, "platform", "plan9")
    with operating_system.undisturbed(priority=True) as note:
        assert note == "not permitted here: real-time priority on this system; ticks may be late"
    with operating_system.undisturbed(priority=False) as note:
        assert note == ""
