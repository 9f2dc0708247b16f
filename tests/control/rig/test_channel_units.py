"""Units of channels: a record in any unit gives the numbers that the plant declares; factors are those of SI."""

import numpy as np
import pytest

from masking.app.workflows import discovery_inputs
from masking.errors import RecordError
from masking.inference.estimation.identification_data import Data
from masking.lab.records.record_form import RecordForm

T = np.arange(500) / 100.0
U, Y = np.sin(9.0 * T), np.cos(3.0 * T)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    (folder / "wheel.yaml").write_text(
        "name: wheel\ncoordinates: {th: {unit: rad}}\ninputs: {M: {unit: N*m}}\n"
        "parameters: {J: {value: 1, unit: kg*m**2}, k: {value: 9, unit: N*m}}\nequations: {\"J*th''\": M - k*th}\n"
    )
    (folder / "plant.yaml").write_text(
        "name: rig\nmodel: wheel.yaml\nsensors:\n  w: {measures: th', unit: rad/s}\n  v: {measures: th', gain: "
        "{value: 1, unit: V*s/rad}, unit: V}\n  T: {measures: th, unit: K, gain: {value: 1, unit: K/rad}}\n"
        "  a: {measures: th, unit: m/s**2, gain: {value: 1, unit: m/s**2/rad}}\n"
        "  n: {measures: th}\n"
    )
    return discovery_inputs.rig(None, folder / "plant.yaml")


def data(wheel, tmp_path, heads, columns=None, **sizes):
    """Data of a record with the columns `heads`, in this order t, M, w, v, T, a, n."""
    names = ("t", "M", "w", "v", "T", "a", "n")
    table = np.column_stack([np.array(x) * sizes.get(n, 1.0) for n, x in zip(names, (T, U, *[Y] * 5), strict=True)])
    given = dict(zip(names, names, strict=True)) | heads
    path = tmp_path / "r.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(given[n] for n in names), comments="", fmt="%.17g")
    return Data.read(path, wheel, columns=columns)


@pytest.mark.parametrize(
    ("head", "column", "size"),
    [
        ({"w": "w [rpm]"}, {}, {"w": 30.0 / np.pi}),
        ({"w": "w (deg/s)"}, {}, {"w": 180.0 / np.pi}),
        ({"w": "speed (rpm)"}, {"w": "speed"}, {"w": 30.0 / np.pi}),
        ({"w": "speed (rpm)"}, {"w": "speed (rpm)"}, {"w": 30.0 / np.pi}),
        ({"w": "speed"}, {"w": "speed:rpm"}, {"w": 30.0 / np.pi}),
        ({"w": "speed [V]"}, {"w": "speed:rpm"}, {"w": 30.0 / np.pi}),
        ({"w": "w [U/min]"}, {}, {"w": 30.0 / np.pi}),
        ({"w": "w [1/min]"}, {"w": "w:turn/min"}, {"w": 30.0 / np.pi}),
        ({"M": "M [N·mm]"}, {}, {"M": 1e3}),
        ({"M": "M [Nm]"}, {}, {}),
        ({"v": "v [mV]"}, {}, {"v": 1e3}),
        ({"v": "v [Volts]"}, {}, {}),
        ({"a": "a (mm/s²)"}, {}, {"a": 1e3}),
        ({"a": "a"}, {"a": "a:gravity"}, {"a": 1.0 / 9.80665}),
        ({"n": "n [furlong]"}, {"n": "n:1"}, {}),
        ({"t": "t [ms]", "w": "w [rpm]"}, {}, {"t": 1e3, "w": 30.0 / np.pi}),
        ({"v": "v (left)"}, {"v": "v (left)"}, {}),
    ],
)
def test_columns_are_converted_to_what_the_plant_declares(wheel, tmp_path, head, column, size):
    found = data(wheel, tmp_path, head, column, **size)
    assert found.rate == pytest.approx(100.0)
    np.testing.assert_allclose(found.commands[:, 0], U, atol=1e-12)
    np.testing.assert_allclose(found.readings, np.column_stack([Y] * 5), atol=1e-12)


@pytest.mark.parametrize(
    ("head", "column", "words"),
    [
        ({"v": "v [furlongs/x]"}, {}, ("in 'furlongs/x', which is no unit", '--map "v=v:V"')),
        ({"v": "v [mm]"}, {}, ("in mm, and v is declared in V, which is of another dimension", '--map "v=v:V"')),
        ({"a": "a [g]"}, {}, ("write gravity", "--map a=a:gravity")),
        ({"w": "w [Hz]"}, {}, ("turns or radians", '--map "w=w:turn/s" or --map "w=w:rad/s"')),
        ({"w": "w [1/min]"}, {}, ("turns or radians", '--map "w=w:turn/minute" or --map "w=w:rad/minute"')),
        ({"T": "T [°C]"}, {}, ("another zero", "declare T in degC")),
        ({"n": "n [mm]"}, {}, ("declares no unit of n", "unit: mm", '--map "n=n:1"')),
        ({"w": "speed_rpm"}, {"w": "speed_rpm"}, ("--map w=speed_rpm:rpm, or --map w=speed_rpm:rad/s",)),
        ({"w": "rpm"}, {"w": "rpm"}, ("--map w=rpm:rpm, or --map w=rpm:rad/s",)),
        ({"v": "v"}, {"v": "v:1/0"}, ("in '1/0', which is no unit",)),
    ],
)
def test_a_unit_that_does_not_fit_is_refused_with_the_map_that_settles_it(wheel, tmp_path, head, column, words):
    with pytest.raises(RecordError) as refused:
        data(wheel, tmp_path, head, column)
    assert not [one for one in words if one not in str(refused.value)], str(refused.value)
    assert str(refused.value).startswith(f"{tmp_path / 'r.csv'}: ")


def test_discovery_converts_alike(wheel, tmp_path):
    data(wheel, tmp_path, {"w": "w [rpm]"}, w=30.0 / np.pi)
    made = discovery_inputs.read(wheel, tmp_path / "r.csv", None, RecordForm())
    np.testing.assert_allclose(made.record.readings[:, 0], Y, atol=1e-12)
