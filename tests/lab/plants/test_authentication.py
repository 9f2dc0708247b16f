"""Frames with tags: nobody drives a plant who does not have its key, and nothing counts twice."""

import hashlib
import os
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from masking.app import cli
from masking.errors import PlantLostError, PlantMismatchError, PlantRefusedError, WireError
from masking.lab.plants import adapters, wire
from masking.lab.plants.authentication import TAG, AuthenticatedHub, AuthenticatedLine, Key
from masking.lab.plants.interface import Settings
from masking.lab.plants.udp import UdpPlant
from masking.lab.plants.wire import Kind
from masking.lab.records.recording import Recording
from tests.lab.plants.test_wire import LOCKSTEP, RUN, MassSpring, damped, line, served
from tests.support.rig_runs import run_rig

pytestmark = pytest.mark.realtime

SECRET, OTHER = b"a key for the tests of the rig", b"another key, which nobody has here"
PEER = ("10.0.0.1", 5)


class Wire:
    """Both ends of a line in this process; what was sent stays in `sent`."""

    address, is_local = "udp://10.0.0.2:5005", False

    def __init__(self):
        self.waiting, self.sent = deque(), []

    def send(self, frame, peer=PEER):
        self.sent.append(frame)

    def waits(self, seconds):
        return bool(self.waiting)

    def receive(self):
        if not self.waiting:
            raise BlockingIOError
        return self.waiting.popleft()

    def close(self):
        pass


class Both:
    """A server and a controller that may have the same key, and what goes between them."""

    def __init__(self, server=SECRET, controller=SECRET):
        self.there, self.here = Wire(), Wire()
        self.hub, self.line = AuthenticatedHub(self.there, Key(server)), AuthenticatedLine(self.here, Key(controller))

    def received(self, tagged):
        """Return what the server makes of a datagram: a frame, or nothing."""
        self.there.waiting.append((tagged, PEER))
        try:
            return self.hub.receive()[0]
        except (WireError, OSError):
            return None

    def said(self, frame):
        """Send a frame of the controller; return its datagram and what the server makes of it."""
        self.line.send(frame)
        return self.here.sent[-1], self.received(self.here.sent[-1])

    def heard(self, tagged):
        """Return what the controller makes of a datagram."""
        self.here.waiting.append(tagged)
        try:
            return self.line.receive()
        except (WireError, OSError):
            return None

    def opened(self, session):
        """Open a session; return the datagrams of the controller, the last of which the server took."""
        hello = wire.encode(Kind.HELLO, session, text="{}")
        first, found = self.said(hello)
        assert found is None
        assert self.heard(self.there.sent[-1]) is None
        assert self.received(self.here.sent[-1]) == hello
        return [first, self.here.sent[-1]]


def command(session, index, value=1.0):
    return wire.encode(Kind.COMMAND, session, index, values=np.full(2, value))


# --- the tag ----------------------------------------------------------------------------------------------------------


def test_the_tag_is_that_of_the_standard_under_keys_of_session_and_direction():
    # By hand, with hashlib's one-pass form: BLAKE2b of RFC 7693 with a key.
    both = Both()
    _, sealed = both.opened(7)
    challenge = both.there.sent[-1]
    nonce = wire.decode(challenge[:-TAG]).text.encode()
    assert len(bytes.fromhex(nonce.decode())) == 16
    shared = hashlib.blake2b(SECRET).digest()
    number = (7).to_bytes(8, "little")

    def tag(frame, way, given):
        key = hashlib.blake2b(way + number + given, key=shared).digest()
        return hashlib.blake2b(frame, key=key, digest_size=16).digest()

    assert challenge[-TAG:] == tag(challenge[:-TAG], b"to the controller", b"")
    assert sealed[-TAG:] == tag(sealed[:-TAG], b"to the plant", nonce)
    both.hub.send(command(7, 3), PEER)
    assert both.there.sent[-1][-TAG:] == tag(both.there.sent[-1][:-TAG], b"to the controller", nonce)


def test_frames_of_a_session_come_through_both_ways():
    both = Both()
    both.opened(7)
    for index in range(3):
        assert both.said(command(7, index))[1] == command_of(both)
        both.hub.send(command(7, index), PEER)
        assert both.heard(both.there.sent[-1]) == both.there.sent[-1][:-TAG]


def command_of(both):
    return both.here.sent[-1][:-TAG]


MUTATED = Both()
SENT = [*MUTATED.opened(7), *(MUTATED.said(command(7, index))[0] for index in range(3))]
OLD = Both()
SAID = tuple(MUTATED.there.sent)
BEFORE = [*OLD.opened(7), *(OLD.said(command(7, index))[0] for index in range(3))]  # of a server that was started anew


@st.composite
def mutated(draw):
    """A datagram that was sent, and changed in at least one place; also pieces of two, and what was sent back."""
    whole = bytearray(draw(st.sampled_from([*SENT, *SAID])))
    how = draw(st.sampled_from(["bytes", "cut", "longer", "spliced", "resealed"]))
    if how in {"bytes", "resealed"}:
        for _ in range(draw(st.integers(1, 4))):
            at = draw(st.integers(0, len(whole) - 1))
            whole[at] ^= draw(st.integers(1, 255))
    elif how == "cut":
        del whole[draw(st.integers(0, len(whole) - 1)) :]
    elif how == "longer":
        whole += draw(st.binary(min_size=1, max_size=40))
    else:
        other, at = draw(st.sampled_from(SENT)), draw(st.integers(0, len(whole)))
        whole[at:] = other[at:]
    if how == "resealed":  # with the right check sum, which needs no key
        body = bytes(whole[: -TAG - 4])
        whole[-TAG - 4 : -TAG] = wire.zlib.crc32(body).to_bytes(4, "little")
    return bytes(whole)


@settings(max_examples=2000, deadline=None)
@given(mutated())
def test_no_frame_without_the_right_tag_comes_through(datagram):
    if datagram in SENT[1:]:  # the first hello is only challenged
        assert MUTATED.received(datagram) == datagram[:-TAG]
    else:
        assert MUTATED.received(datagram) is None


@given(st.binary(max_size=200))
def test_noise_comes_through_neither_way(noise):
    assert MUTATED.received(noise) is None
    assert MUTATED.heard(noise) is None


def test_what_was_recorded_elsewhere_is_refused():
    for datagram in [*BEFORE, *OLD.there.sent]:  # of a server before this one, with the same key and number
        assert MUTATED.received(datagram) is None
    for datagram in SAID:  # what the server itself said, sent back
        assert MUTATED.received(datagram) is None
    other = Both()
    other.opened(8)
    sent = other.said(command(8, 0))[0]
    renumbered = sent[:8] + (7).to_bytes(8, "little") + sent[16:]
    assert MUTATED.received(renumbered) is None


def test_a_controller_with_another_key_or_none_is_refused_and_knows_why():
    both = Both(controller=OTHER)
    _, found = both.said(wire.encode(Kind.HELLO, 7, text="{}"))
    answer = wire.decode(both.there.sent[-1])
    assert found is None
    assert answer.kind is Kind.REFUSE
    assert answer.text == "its key is another one, or none was given; give the server's by --key FILE"
    assert both.heard(both.there.sent[-1]) is None  # which a controller with a key does not believe
    for frame in (command(7, 0), wire.encode(Kind.START, 7), wire.encode(Kind.BYE, 7), wire.encode(Kind.STOP, 7)):
        assert both.said(frame)[1] is None
        assert both.received(frame) is None
    assert len(both.there.sent) == 1  # nothing else is answered


# --- the key ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "rig.key"
    path.write_bytes(SECRET + b"\n")
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o602, 0o777])
def test_a_key_that_others_can_use_is_refused(key, mode, capsys):
    key.chmod(mode)
    said = f"the key {key} has mode {mode:04o}, so that others can use it; 'chmod 600 {key}'"
    with pytest.raises(PlantMismatchError) as caught:
        Key.read(key)
    assert str(caught.value) == said
    assert cli.main(["rig", "serve", "ideal", "--sessions", "0", "--key", str(key)]) == 2
    assert capsys.readouterr().err == f"masking: {said}\n"


def test_a_key_that_is_none_is_refused(tmp_path):
    remedy = "make one with 'openssl rand -hex 32 > FILE; chmod 600 FILE'"
    with pytest.raises(PlantMismatchError, match=rf"nothing cannot be read \(No such file or directory\); {remedy}"):
        Key.read(tmp_path / "nothing")
    with pytest.raises(PlantMismatchError, match="is no file"):
        Key.read(tmp_path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(PlantMismatchError, match="is no file"):  # and does not wait
        Key.read(tmp_path / "pipe")
    for content in (b"", b"short", b" " * 40, b"x" * 5000):
        path = tmp_path / "key"
        path.write_bytes(content)
        path.chmod(0o600)
        with pytest.raises(PlantMismatchError, match=f"it has 16 to 4096: {remedy}"):
            Key.read(path)


def test_a_key_is_not_shown(key):
    assert SECRET.decode() not in repr(vars(Key.read(key))) + repr(Key.read(key))


def test_a_key_is_for_plants_with_frames(key):
    with pytest.raises(
        PlantMismatchError, match=r"fmu:x\.fmu has no frames that a key could stand for; leave out --key"
    ):
        adapters.connect("fmu:x.fmu", Key.read(key))


# --- over the wire ----------------------------------------------------------------------------------------------------


class Hostile:
    """A line that sends, beside each frame, what somebody without the key makes of those before, from the same port."""

    def __init__(self, bare):
        self.bare, self.generator = bare, np.random.default_rng(1)
        self.sent, self.count = [], 0

    def send(self, datagram):
        for old in [self.sent[i] for i in self.generator.integers(0, max(1, len(self.sent)), 3) if self.sent]:
            changed = bytearray(old)
            changed[self.generator.integers(0, len(changed))] ^= 1 << self.generator.integers(0, 8)
            self.bare.send(bytes(changed))
            self.count += 1
        for frame in (command(0, 0, 9.0), wire.encode(Kind.BYE, wire.session_of(datagram))):
            self.bare.send(frame)
            self.count += 1
        self.sent.append(datagram)
        self.bare.send(datagram)

    def __getattr__(self, name):
        return getattr(self.bare, name)


class Attacked(UdpPlant.__mro__[1]):
    """A plant over a line on which somebody else sends, too."""

    def __init__(self, address, key):
        super().__init__(address, patience=20.0, key=key)

    def open_line(self):
        self.hostile = Hostile(UdpPlant(self._address).open_line())
        return self.hostile


def test_a_run_under_attack_is_the_run_without_bit_for_bit(tmp_path, key):
    here = run_rig(damped, MassSpring(), **RUN)
    shared = Key.read(key)
    with served(MassSpring(), clock="lockstep", record=tmp_path, key=shared) as (address, folders):
        plant = Attacked(address, shared)
        there = run_rig(damped, plant, **RUN)
        count = plant.hostile.count
    assert here.reason == there.reason == "finished"
    for name in ("times", "index", "sensors", "demanded", "applied"):
        assert getattr(here, name).tobytes() == getattr(there, name).tobytes(), name
    own = Recording.load(folders[0]).manifest
    assert (own["end"], own["latch"]) == ("bye", None)
    assert count - 20 <= own["counters"]["unauthenticated"] <= count  # but for those before the start
    assert own["counters"]["commands"] == 300
    assert set(own["counters"]) == {"unauthenticated", "commands", "overruns"}


def test_what_is_sent_again_counts_once(tmp_path, key):
    shared = Key.read(key)
    with served(MassSpring(), sessions=2, clock="lockstep", record=tmp_path, key=shared) as (address, folders):
        first = UdpPlant(address, patience=20.0, key=shared)
        first.configure(LOCKSTEP)
        bare, sent = first._line._line, []
        send = bare.send
        bare.send = lambda datagram: (sent.append(datagram), send(datagram))
        first.activate()
        hello = first._line._tags[0].add(first._line._hello)
        for _ in range(5):
            first.write(first.read().index, np.ones(2))
            send(sent[-1])
        with line(address) as elsewhere:  # a hello, a command and a good-bye from another place
            for datagram in (hello, *sent):
                elsewhere.send(datagram)
        first.read()
        first.deactivate()
        again = UdpPlant(address, patience=20.0, key=shared)
        with line(address) as elsewhere:
            elsewhere.send(hello)  # of the session that is over
            elsewhere.settimeout(20.0)
            refused = wire.decode(elsewhere.recv(65535)[:-TAG])
            assert refused.kind is Kind.REFUSE
        run_rig(damped, again, **{**RUN, "samples": 20})
    counters = Recording.load(folders[0]).manifest["counters"]
    assert counters["commands"] == 5
    assert counters["duplicate"] >= 4
    assert Recording.load(folders[1]).manifest["end"] == "bye"


def test_with_another_key_or_none_a_controller_is_refused(key):
    shared = Key.read(key)
    with served(MassSpring(), sessions=None, key=shared) as (address, _):
        with pytest.raises(PlantRefusedError, match="its key is another one, or none was given; give the server's by"):
            UdpPlant(address).configure(Settings(1000.0))
        with pytest.raises(
            PlantRefusedError, match="answers, but not with this key; give both sides the same --key FILE"
        ):
            UdpPlant(address, key=Key(OTHER), patience=0.3).configure(Settings(1000.0))
        plant = UdpPlant(address, key=shared)
        plant.configure(Settings(1000.0))
        plant.deactivate()
    with served(MassSpring(), sessions=None) as (address, _):
        said = f"no plant answers at {address}; start it with 'masking rig serve PLANT --address {address} --key FILE'"
        with pytest.raises(PlantLostError, match=said):
            UdpPlant(address, key=shared, patience=0.3).configure(Settings(1000.0))


def test_beyond_this_machine_a_plant_is_served_with_a_key(key):
    from masking.lab.plants.serve import Serving, serve

    with pytest.raises(PlantMismatchError, match=r"is reached from other machines.*give --key FILE, and the same to"):
        serve(MassSpring(), "udp://0.0.0.0:0", Serving(sessions=0))
    found = []
    serve(MassSpring(), "udp://0.0.0.0:0", Serving(sessions=0, key=Key.read(key)), ready=found.append)
    for host in ("127.0.0.1", "localhost", "127.0.0.2"):
        serve(MassSpring(), f"udp://{host}:0", Serving(sessions=0), ready=found.append)
    assert len(found) == 4
