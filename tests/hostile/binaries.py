"""Hostile binary records: bombs, references to other files, pickled code, and files that are cut off or changed."""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
from scipy.io import matlab

from masking.lab.records.recording import Recording
from tests.hostile.cases import COLUMNS, Either, Read, RecordCase, Refused, T, X, written
from tests.hostile.corpus import MARKER

BOMB = 400 * 2**20  # bytes that a small file unpacks to
NEEDED = {"needed": ("x", "y")}
MAPPED = {"names": {"t": "rig/time", "x": "rig/x"}, "needed": ("x",)}


class Pickled:
    """Makes the file MARKER when it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return open, (MARKER, "w")


def cases() -> Iterator[RecordCase]:
    yield from honest()
    yield from _numpy()
    yield from _matlab()
    yield from _json()
    yield from _parquet()
    yield from _hdf5()
    yield from _loggers()
    yield from _damaged()


def honest() -> Iterator[RecordCase]:
    """The same numbers in every format; those of loggers have other names."""
    for kind, write in WRITERS.items():
        is_logger = kind in {"tdms", "mf4", "mcap"}
        wanted = Read({"x": X} if is_logger else COLUMNS)
        yield RecordCase(
            f"honest .{kind}", lambda f, w=write, k=kind: w(f / f"a.{k}"), wanted, MAPPED if is_logger else NEEDED
        )


# Writers of honest files


def _npz_file(path: Path) -> Path:
    np.savez_compressed(path, **COLUMNS)
    return path


def _mat_file(path: Path) -> Path:
    scipy.io.savemat(path, COLUMNS, do_compression=True)
    return path


def _json_file(path: Path) -> Path:
    path.write_text(json.dumps({name: values.tolist() for name, values in COLUMNS.items()}))
    return path


def _parquet_file(path: Path) -> Path:
    Recording(COLUMNS, {"name": "a"}).save(path.parent / "made")
    (path.parent / "made" / "recording.parquet").rename(path)
    return path


def _hdf5_file(path: Path) -> Path:
    with h5py.File(path, "w", libver="latest") as file:  # with checksums of all that is not numbers, too
        for name, values in COLUMNS.items():
            file.create_dataset(name, data=values, compression="gzip", fletcher32=True, chunks=(10,))
    return path


def _tdms_file(path: Path) -> Path:
    import nptdms

    clock = {"wf_increment": 0.125, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", "x", X, clock)])
    return path


def _mf4_file(path: Path) -> Path:
    import asammdf

    with asammdf.MDF() as file:
        group = file.append([asammdf.Signal(X, T, name="x")])
        file.groups[group].channel_group.acq_name = "rig"
        file.append([asammdf.Signal(T, T, name="u")])
        file.save(path, compression=1)
    return path


def _mcap_file(path: Path) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(topic="/rig", message_encoding="json", schema_id=0)
        for t, x in zip(T, X, strict=True):
            writer.add_message(channel, int(t * 1e9), json.dumps({"x": float(x)}).encode(), int(t * 1e9))
        writer.finish()
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "npz": _npz_file, "mat": _mat_file, "json": _json_file, "parquet": _parquet_file, "h5": _hdf5_file,
    "tdms": _tdms_file, "mf4": _mf4_file, "mcap": _mcap_file,
}  # fmt: skip


# Each format


def _npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=True)
    return stream.getvalue()


def _npy_header(text: str, rest: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    head = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + struct.pack("<H" if version == b"\x01\x00" else "<I", len(head)) + head + rest


def _zip(members: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", kind, compresslevel=1) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return stream.getvalue()


def _numpy() -> Iterator[RecordCase]:
    def one(name: str, data: bytes | Callable[[], bytes], wanted: object, slow: bool = False) -> RecordCase:
        def make(folder: Path) -> Path:
            return written("a.npz", data() if callable(data) else data)(folder)

        return RecordCase(f"numpy: {name}", make, wanted, NEEDED, slow)  # type: ignore[arg-type]

    whole = {f"{name}.npy": _npy(values) for name, values in COLUMNS.items()}
    objects = np.array([Pickled(), 1.0], dtype=object)
    for kind in ("<f8", ">f8", "<f4", "<f2"):
        held = {name: values.astype(kind) for name, values in COLUMNS.items()}
        wanted = Read({name: values.astype(np.float64) for name, values in held.items()})
        yield one(f"of {kind}", _zip({f"{n}.npy": _npy(v) for n, v in held.items()}), wanted)
    yield one("pickled objects", _zip({**whole, "x.npy": _npy(objects)}), Refused(("Python objects",)))
    yield one("pickled objects alone", _npy(objects), Refused(("Python objects",)))
    yield one("a pickle", pickle.dumps(Pickled()), Refused(("cannot be read",)))
    yield one("a pickle in a zip", _zip({**whole, "x.npy": pickle.dumps(Pickled())}), Refused(("cannot be read",)))
    yield one("a pickle beside", _zip({**whole, "z.pkl": pickle.dumps(Pickled())}), Either(COLUMNS))
    for shape in (
        "(10**9,)",
        "(2**62,)",
        "(999999999999,)",
        "(-1,)",
        "(3, -3)",
        "(1.5,)",
        "None",
        "'a'",
        "(" * 90,
        "[]",
    ):
        head = _npy_header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}")
        yield one(f"shape {shape[:20]}", _zip({**whole, "x.npy": head}), Refused())
        yield one(f"shape {shape[:20]} alone", head, Refused())
    for kind in ("|O", "|V99", "<f16", "<c16", "<U9", "<M8[s]", "|b1", "no", "<f8'+'", "[('a', '<f8')]"):
        head = _npy_header(f"{{'descr': '{kind}', 'fortran_order': False, 'shape': (40,), }}", bytes(40 * 99))
        wanted = Read({"x": np.zeros(40)}) if kind in {"<f16", "|b1"} else Refused()
        yield one(f"kind {kind}", _zip({**whole, "x.npy": head}), wanted)
    code = _npy_header(f"{{'descr': open('{MARKER}', 'w'), 'fortran_order': False, 'shape': (40,), }}")
    yield one("code in a header", _zip({**whole, "x.npy": code}), Refused())
    yield one("a long header", _npy_header("{" + " " * 99_999, version=b"\x02\x00"), Refused())
    yield one("an unknown version", _npy_header("{}", version=b"\x09\x00"), Refused())
    flags = bytearray(_zip(whole))
    at = flags.index(b"PK\x01\x02")
    flags[at + 8] |= 1
    yield one("encrypted", bytes(flags), Refused(("cannot be read",)))
    method = bytearray(_zip(whole))
    method[method.index(b"PK\x01\x02") + 10] = 99
    yield one("unknown compression", bytes(method), Refused(("cannot be read",)))
    spoiled = bytearray(_zip(whole, zipfile.ZIP_STORED))
    spoiled[spoiled.index(X.tobytes()[:24]) + 3] ^= 4
    yield one("a changed bit", bytes(spoiled), Refused(("cannot be read",)))
    outside = _zip({**whole, "../../x.npy": _npy(X + 1.0), "/etc/x.npy": _npy(X)})
    yield one("paths that lead outside", outside, Read(COLUMNS))
    zeros = np.zeros(BOMB // 8)
    yield one("a bomb", lambda: _zip({**whole, "z.npy": _npy(zeros)}), Refused(("unpacks to", "times")), slow=True)
    small = np.zeros(BOMB // 8, dtype=np.int8)
    yield one("a bomb of bytes", lambda: _zip({**whole, "z.npy": _npy(small)}), Refused(("unpacks to", "times")))


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def _matrix(name: bytes, dimensions: tuple[int, ...], data: bytes, number: int = 6, kind: int = 9) -> bytes:
    parts = [
        _element(6, struct.pack("<II", number, 0)),
        _element(5, struct.pack(f"<{len(dimensions)}i", *dimensions)),
        _element(1, name),
        _element(kind, data),
    ]
    return _element(14, b"".join(parts))


def _mat5(*elements: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements)


def _packed(data: bytes) -> bytes:
    made = zlib.compress(data, 1)
    return struct.pack("<II", 15, len(made)) + made


def _matlab() -> Iterator[RecordCase]:
    def one(name: str, data: bytes | Callable[[], bytes], wanted: object, slow: bool = False) -> RecordCase:
        def make(folder: Path) -> Path:
            return written("a.mat", data() if callable(data) else data)(folder)

        return RecordCase(f"MATLAB: {name}", make, wanted, NEEDED, slow)  # type: ignore[arg-type]

    whole = [_matrix(name.encode(), (40, 1), values.tobytes()) for name, values in COLUMNS.items()]
    yield one("by hand", _mat5(*whole), Read(COLUMNS))
    yield one("by hand, packed", _mat5(*map(_packed, whole)), Read(COLUMNS))
    for dimensions in (
        (2**31 - 1, 1),
        (2**31 - 1, 2**31 - 1),
        (-1, 1),
        (-40, -1),
        (40,),
        (),
        (1,) * 40,
        (50, 1),
        (30, 1),
    ):
        made, wanted = _matrix(b"x", dimensions, X.tobytes()), Either(COLUMNS) if dimensions == (40,) else Refused()
        yield one(f"dimensions {dimensions[:3]}", _mat5(whole[0], made, whole[2]), wanted)
        yield one(f"dimensions {dimensions[:3]}, packed", _mat5(whole[0], _packed(made), whole[2]), wanted)
    for number in (0, 1, 2, 3, 4, 5, 16, 17, 18, 99, 255):
        made = _matrix(b"x", (40, 1), X.tobytes(), number)
        yield one(f"class {number}", _mat5(whole[0], _packed(made), whole[2]), Refused())
    for kind in (0, 1, 2, 8, 10, 11, 14, 15, 16, 99):
        made = _matrix(b"x", (40, 1), X.tobytes(), 6, kind)
        yield one(f"kind {kind}", _mat5(whole[0], _packed(made), whole[2]), Refused())
    deep = _matrix(b"x", (40, 1), X.tobytes())
    for _ in range(3000):
        deep = _element(
            14, _element(6, struct.pack("<II", 1, 0)) + _element(5, struct.pack("<2i", 1, 1)) + _element(1, b"c") + deep
        )
    yield one("cells 3000 deep", _mat5(whole[0], _packed(deep), whole[2]), Refused())
    changed = bytearray(_packed(whole[1]))
    changed[len(changed) // 2] ^= 16
    yield one("a changed bit", _mat5(whole[0], bytes(changed), whole[2]), Refused(("cannot be read",)))
    yield one("packed twice", _mat5(whole[0], _packed(_packed(whole[1])), whole[2]), Refused())
    huge = struct.pack("<iiiii", 0, 2**30, 2**30, 0, 2) + b"x\x00"
    yield one("version 4, large", huge, Refused())
    yield one("version 4, negative", struct.pack("<iiiii", 0, -5, 5, 0, 2) + b"x\x00" + bytes(99), Refused())
    yield one("an element of 4 GiB", _mat5(struct.pack("<II", 14, 2**32 - 1)), Refused())
    yield one(
        "a bomb", lambda: _mat5(_packed(_matrix(b"x", (BOMB // 8, 1), bytes(BOMB)))), Refused(("unpacks to",)), True
    )
    ones = bytes(BOMB // 8)
    yield one(
        "a bomb of bytes", lambda: _mat5(_packed(_matrix(b"x", (BOMB // 8, 1), ones, 6, 2))), Refused(("unpacks to",))
    )
    yield one("numbers of bytes", _mat5(*whole, _packed(_matrix(b"z", (40, 1), bytes(40), 6, 2))), Read(COLUMNS))
    stream = io.BytesIO()
    matlab.savemat(stream, {**COLUMNS, "text": "a", "run": {"a": X}, "cell": np.array([X, "b"], dtype=object)})
    yield one("structures beside", stream.getvalue(), Read(COLUMNS))


def _json() -> Iterator[RecordCase]:
    lists = {name: values.tolist() for name, values in COLUMNS.items()}

    def with_x(text: str) -> str:
        return json.dumps({**lists, "x": "HERE"}).replace('"HERE"', text)

    def one(name: str, text: str | bytes, wanted: object) -> RecordCase:
        return RecordCase(f"json: {name}", written("a.json", text), wanted, NEEDED)  # type: ignore[arg-type]

    numbers = json.dumps(lists["x"])
    rows = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
    yield one("samples", json.dumps(rows), Read(COLUMNS))
    yield one("a mark before", b"\xef\xbb\xbf" + json.dumps(lists).encode(), Read(COLUMNS))
    for cell in (
        "1e400", "-1e400", "NaN", "Infinity", "-Infinity", "null", '"1"', '"1e3"', "[1]", "{}", "1_000", "0x10", "1.",
        ".5",
        "+1", "01", "1" * 5000, "9" * 400, "--1", "1e", "'1'", "undefined", "1,000", "True",
    ):  # fmt: skip
        yield one(f"number {cell[:20]}", with_x(numbers.replace("[0.0", f"[{cell}")), Refused())
    for name, text in {
        "a key twice": json.dumps(lists)[:-1] + ', "x": ' + json.dumps(lists["y"]) + "}",
        "a key twice in a sample": json.dumps(rows).replace('"t": 0.125, ', '"t": 0.125, "t": 0.2, '),
        "cut off": json.dumps(lists)[:-9],
        "more behind": json.dumps(lists) + json.dumps(lists),
        "deep": "[" * 100_000,
        "deep and closed": "[" * 900 + "]" * 900,
        "deep objects": '{"a":' * 100_000,
        "a comment": "// a\n" + json.dumps(lists),
        "a comma at the end": json.dumps(lists)[:-1] + ",}",
        "UTF-16": "",
        "a text": '"x"',
        "a number": "1",
        "null": "null",
        "nothing": "",
        "one column shorter": with_x(json.dumps(lists["x"][:-1])),
        "a matrix": with_x(json.dumps([lists["x"], lists["y"]])),
        "a sample without x": json.dumps([*rows[:5], {"t": 0.6, "y": 1.0}, *rows[5:]]),
        "a name that is a method": json.dumps({"__class__": [1, 2], "__init__": [1, 2]}),
    }.items():
        yield one(name, text if name != "UTF-16" else json.dumps(lists).encode("utf-16"), Refused())
    yield one("many empty lists", "[" + "[]," * 200_000 + "[]]", Refused())


def _table(columns: dict[str, object], **options: object) -> bytes:
    stream = io.BytesIO()
    pq.write_table(pa.table(columns), stream, **options)
    return stream.getvalue()


def _parquet() -> Iterator[RecordCase]:
    def one(name: str, data: bytes | Callable[[], bytes], wanted: object, slow: bool = False) -> RecordCase:
        def make(folder: Path) -> Path:
            return written("a.parquet", data() if callable(data) else data)(folder)

        return RecordCase(f"parquet: {name}", make, wanted, NEEDED, slow)  # type: ignore[arg-type]

    for packing in ("none", "snappy", "gzip", "zstd", "brotli", "lz4"):
        yield one(f"packed by {packing}", _table(dict(COLUMNS), compression=packing), Read(COLUMNS))
    nulls = pa.array([None, *X[1:]], pa.float64())
    for name, values in {
        "texts": pa.array(["1"] * 40),
        "nulls": nulls,
        "times": pa.array(range(40), pa.timestamp("ns")),
        "truth values": pa.array([True] * 40),
        "decimals": pa.array([1] * 40).cast(pa.decimal128(30, 2)),
        "lists": pa.array([[1.0]] * 40),
        "structures": pa.array([{"a": 1.0}] * 40),
        "bytes": pa.array([b"1"] * 40),
        "dictionaries": pa.array(["1"] * 40).dictionary_encode(),
        "infinities": pa.array([np.inf] * 40),
        "empty": pa.nulls(40),
    }.items():
        yield one(name, _table({**COLUMNS, "x": values}), Refused())
    large = {**COLUMNS, "x": pa.array([2**53 + 1, *range(39)], pa.int64())}
    yield one("large integers", _table(large), Read({"x": np.array([2**53, *range(39)], float)}))
    manifest = pa.table(COLUMNS)
    for text in (b"{", b"[]", b'{"format": "masking 0"}', b"\xff", b"null", b"[" * 10_000, b'{"format": 1}'):
        stream = io.BytesIO()
        pq.write_table(manifest.replace_schema_metadata({b"masking.manifest": text}), stream)
        yield one(f"manifest {text[:12]!r}", stream.getvalue(), Refused())
    twice = pa.Table.from_arrays([pa.array(T), pa.array(X), pa.array(X)], ["t", "x", "x"])
    stream = io.BytesIO()
    pq.write_table(twice, stream)
    yield one("a column twice", stream.getvalue(), Refused(("more than once",)))
    zeros = {"t": np.zeros(BOMB // 8), "x": np.zeros(BOMB // 8), "y": np.zeros(BOMB // 8)}
    yield one("a bomb", lambda: _table(zeros, compression="zstd"), Refused(("unpacks to",)), slow=True)
    small = {name: np.zeros(BOMB // 24, np.int8) for name in COLUMNS}
    yield one("a bomb of bytes", lambda: _table(small), Refused(("unpacks to",)), slow=True)
    texts = {**COLUMNS, "x": pa.array(["a" * 10**6] * 40)}
    yield one("long texts", _table(texts), Refused(("not numbers",)))


def _hdf5() -> Iterator[RecordCase]:  # noqa: PLR0915  (one list, with what fills each file)
    def one(name: str, fill: Callable[[h5py.File], object], wanted: object, slow: bool = False) -> RecordCase:
        def make(folder: Path) -> Path:
            (folder / "secret").write_bytes(np.ones(40).tobytes())
            with h5py.File(folder / "other.h5", "w") as other:
                other["x"] = X
            with h5py.File(folder / "a.h5", "w") as file:
                file["t"], file["y"] = T, COLUMNS["y"]
                fill(file)
            return folder / "a.h5"

        return RecordCase(f"HDF5: {name}", make, wanted, NEEDED, slow)  # type: ignore[arg-type]

    def outside(file: h5py.File) -> None:
        name = Path(file.filename).with_name("secret")
        file.create_dataset("x", (40,), "f8", external=[(str(name), 0, h5py.h5f.UNLIMITED)])

    def passwords(file: h5py.File) -> None:
        file.create_dataset("x", (40,), "u1", external=[("/etc/passwd", 0, 40)])

    def virtual(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((40,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "x", (40,))
        file.create_virtual_dataset("x", layout)

    def linked(file: h5py.File) -> None:
        file["x"] = h5py.ExternalLink("other.h5", "x")

    def in_group(file: h5py.File) -> None:
        file["x"] = X
        file.create_group("a/b")["c"] = h5py.ExternalLink("/etc/passwd", "/")

    def huge(file: h5py.File) -> None:
        file.create_dataset("x", (2**40,), "f8", chunks=(2**20,))

    def several(file: h5py.File) -> None:
        file["x"] = X
        for number in range(40):
            file.create_dataset(f"z{number}", (2**21,), "f8", chunks=(2**16,))

    def nested(file: h5py.File) -> None:
        file["x"] = X
        group = file
        for _ in range(3000):
            group = group.create_group("a")

    def crowded(file: h5py.File) -> None:
        file["x"] = X
        for number in range(10_000):
            file.create_group(f"g/{number}")

    def in_circles(file: h5py.File) -> None:
        file["x"] = X
        group = file.create_group("a")
        group["all"], group["self"], group["named"] = file["/"], group, h5py.SoftLink("/a/all")

    def bomb(file: h5py.File) -> None:
        file.create_dataset("x", data=np.zeros(BOMB // 8), compression="gzip", compression_opts=1, chunks=(2**17,))

    def chunk(file: h5py.File) -> None:
        held = file.create_dataset("x", (2**20,), "f8", compression="gzip", chunks=(2**20,))
        held.id.write_direct_chunk((0,), zlib.compress(bytes(BOMB), 1))

    def loops(file: h5py.File) -> None:
        file["x"] = X
        file["loop"] = h5py.SoftLink("/loop")
        file.create_group("a")["up"] = file["/"]

    def deep(file: h5py.File) -> None:
        file["x"] = X
        held = file
        for _ in range(400):
            held = held.create_group("g")

    def of(values: object) -> Callable[[h5py.File], None]:
        return lambda file: file.__setitem__("x", values)

    whole = Read({**COLUMNS})
    yield one("honest", of(X), whole)
    yield one("stored in another file", outside, Refused(("x is stored in another file",)))
    yield one("stored in /etc/passwd", passwords, Refused(("x is stored in another file",)))
    yield one("virtual", virtual, Refused(("x is a virtual dataset",)))
    yield one("an external link", linked, Refused(("x is an external link",)))
    yield one("an external link in a group", in_group, Refused(("a/b/c is an external link",)))
    yield one("8 TiB", huge, Refused(("unpacks to",)))
    yield one("several that are large", several, Refused(("unpacks to",)))
    yield one("3000 groups in one another", nested, Refused(("nested deeper",)))
    yield one("10 000 groups", crowded, Refused(("more than 10000 groups",)))
    yield one("links in circles", in_circles, Read(COLUMNS))
    yield one("a bomb", bomb, Refused(("unpacks to",)), slow=True)
    yield one("a chunk that is a bomb", chunk, Refused(("a chunk unpacks to more",)))
    yield one("links in a circle", loops, whole)
    yield one("groups 400 deep", deep, whole)
    yield one("references", lambda file: file.create_dataset("x", (40,), h5py.ref_dtype), Refused())
    for name, values in {
        "texts": np.array([b"1"] * 40),
        "compounds": np.zeros(40, dtype=[("a", "f8"), ("b", "f8")]),
        "complex numbers": X + 1j,
        "a scalar": 1.0,
        "nothing": h5py.Empty("f8"),
        "nans": np.full(40, np.nan),
        "infinities": np.full(40, np.inf),
        "one shorter": X[:-1],
        "in three dimensions": np.zeros((40, 3, 3)),
        "opaque bytes": np.zeros(40, dtype="V8"),
    }.items():
        yield one(name, of(values), Refused())


def _loggers() -> Iterator[RecordCase]:
    def of(kind: str, name: str, change: Callable[[bytes], bytes]) -> RecordCase:
        def make(folder: Path) -> Path:
            path = WRITERS[kind](folder / f"a.{kind}")
            path.write_bytes(change(path.read_bytes()))
            return path

        return RecordCase(f"{kind}: {name}", make, Either({"x": X}), MAPPED)

    count = struct.pack("<Q", 40)
    for huge in (2**33, 2**62, 2**64 - 1):
        yield of("tdms", f"{huge} samples", lambda data, n=huge: data.replace(count, struct.pack("<Q", n)))
    yield of("tdms", "no samples", lambda data: data.replace(count, bytes(8)))
    kind = struct.pack("<IIQ", 10, 1, 40)
    for code in (0, 0x20, 0x44, 0xFFFFFFFF):
        yield of("tdms", f"type {code:x}", lambda data, c=code: data.replace(kind, struct.pack("<IIQ", c, 1, 40)))

    def longer(data: bytes, at: int, number: int) -> bytes:
        start = data.index(b"##DZ")
        return data[: start + at] + struct.pack("<Q", number) + data[start + at + 8 :]

    for number in (1, 2**33, 2**63):
        yield of("mf4", f"a block of {number} bytes", lambda data, n=number: longer(data, 32, n))
        yield of("mf4", f"a block packed in {number} bytes", lambda data, n=number: longer(data, 40, n))

    def mcap(compression: str, data: bytes, size: int) -> Callable[[Path], Path]:
        def make(folder: Path) -> Path:
            text = compression.encode()
            body = struct.pack("<QQQII", 0, 1, size, 0, len(text)) + text + struct.pack("<Q", len(data)) + data
            magic = b"\x89MCAP0\r\n"
            head = b"\x01" + struct.pack("<QII", 8, 0, 0)
            end = b"\x0f" + struct.pack("<QI", 4, 0) + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0)
            return written("a.mcap", magic + head + b"\x06" + struct.pack("<Q", len(body)) + body + end + magic)(folder)

        return make

    def packed(compression: str, size: int) -> Callable[[Path], Path]:
        def make(folder: Path) -> Path:
            import lz4.frame
            import zstandard

            by = {
                "zstd": lambda d: zstandard.ZstdCompressor(1).compress(d),
                "lz4": lz4.frame.compress,
                "": bytes,
                "xz": bytes,
            }
            return mcap(compression, by[compression](bytes(BOMB)), size)(folder)

        return make

    for compression in ("zstd", "lz4"):
        yield RecordCase(f"mcap: a bomb of {compression}", packed(compression, BOMB), Refused(), MAPPED, is_slow=True)
        yield RecordCase(
            f"mcap: a bomb of {compression} that lies", packed(compression, 100), Refused(), MAPPED, is_slow=True
        )
        yield RecordCase(f"mcap: {compression} that is none", mcap(compression, b"text", 100), Refused(), MAPPED)
    yield RecordCase("mcap: an unknown compression", mcap("xz", b"text", 4), Refused(), MAPPED)
    yield RecordCase("mcap: a chunk of 2**63 bytes", mcap("", b"", 2**63), Refused(), MAPPED)


def _damaged() -> Iterator[RecordCase]:
    """Cut off, or with some bytes changed; formats with checksums give the right numbers or none."""
    random = np.random.default_rng(22)
    for kind in WRITERS:
        given = MAPPED if kind in {"tdms", "mf4", "mcap"} else NEEDED
        checked = {"x": X} if kind == "mcap" else COLUMNS if kind in {"npz", "mat", "h5", "parquet"} else {}
        for number in range(30):
            cut = float(random.random()) if number % 3 == 0 else None
            make = partial(_spoiled, kind, cut, int(random.integers(2**31)))
            name = f"{kind} {'changed' if cut is None else 'cut off'}, {number}"
            yield RecordCase(name, make, Either(checked), given)


def _spoiled(kind: str, cut: float | None, seed: int, folder: Path) -> Path:
    """Write a file of a kind, cut off at a share of its length or with up to six bytes changed."""
    path = WRITERS[kind](folder / f"a.{kind}")
    data = bytearray(path.read_bytes())
    if cut is not None:
        del data[int(cut * len(data)) :]
    else:
        places = np.random.default_rng(seed)
        for at in places.integers(0, len(data), 1 + seed % 6):
            data[at] = int(places.integers(256))
    path.write_bytes(data)
    return path
