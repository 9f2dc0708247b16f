"""Hostile tables of text: each with the numbers that it stands for, or with the line that it is refused at."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np

from tests.hostile.cases import COLUMNS, SECRET, Either, Read, RecordCase, Refused, T, X, Y, written

CELLS = [
    "1_000", "1_0.5",
    "#N/A", "#NUM!", "#DIV/0!", "#REF!", "#NV", "0x10", "0x1p3", "0b1", "0o7", "1e400", "-1e400",
    "1e999999999", "", "nan", "NaN", "-nan", "inf", "-inf", "Infinity", "NA",
    "N/A", "null", "None", "true", "1 000",
    "1'000", "1\u00a0000", "\u0661\u0662", "\uff11", "\u22121", "1e", "e5", "--1", "+-1", "1-2", "+", ".",
    "-.", "1.2.3",
    "1.000.5", "1j", "1d5", "1D+05", "1f", "1L", "1 V", "5%", "$5", "(5)", "=1+1", "=cmd|' /C calc'!A0", "1e5e5",
    "1e5.5",
    "1/2", "1*2", "<b>1</b>", "OVL", "----", "1\u0301", "\u00bd", "1\\", "\\x31", "1e+", "'1'", "`1`", "{1}", "[1]",
    "1:30", "2024-01-01", "12:00:00", "open('hostile_marker','w')", "__import__('os')",
]  # fmt: skip
PARTS = [
    "a:b", "1_0:2_0", "0x1:2", "1e400:", ":1e400", "nan:", ":inf", "1:2:3", "1", "-", ":::", "1;2", "1,5:2", "2:1",
    "1:1",
    "\u0661:2", "1 :a", "--1:2", "0:1e9", "-5:1", "1e999:2e999", "9" * 400 + ":", "${HOME}:1", "`id`:2", "1:2@3:x",
    ".:1", "+:1", "1:2#", "0.01:0.02",
]  # fmt: skip


def table(separator: str, line: str = "\n", comma: bool = False) -> list[str]:
    rows = [separator.join(COLUMNS)]
    for row in zip(*COLUMNS.values(), strict=True):
        cells = [repr(float(one)) for one in row]
        rows.append(separator.join(one.replace(".", ",") if comma else one for one in cells) + line[1:])
    return rows


def cases() -> Iterator[RecordCase]:
    yield from _honest()
    yield from _cells()
    yield from _structure()
    yield from _bytes()
    yield from _clocks()
    yield from _parts()
    yield from _places()


def _honest() -> Iterator[RecordCase]:
    """The same numbers in every way of writing them that is read."""
    styles = product([",", ";", "\t", " "], ["\n", "\r\n", "\r"], [b"", b"\xef\xbb\xbf"], ["", "# ", "% of today\n"])
    for separator, line, mark, before in styles:
        for comma in (False, True)[: 1 + (separator == ";")]:
            text = before + "\n".join(table(separator, comma=comma)) + "\n"
            data = mark + text.replace("\n", line).encode()
            name = f"honest {separator!r} {line!r} {mark!r} {before!r} {comma}"
            yield RecordCase(name, written("a.csv", data), Read(COLUMNS))
    quoted = "\n".join(",".join(f'"{cell}"' for cell in row.split(",")) for row in table(","))
    yield RecordCase("honest, quoted", written("a.csv", quoted), Read(COLUMNS))
    remarks = [f"{row}  # remark, of one" if i % 3 == 1 else row for i, row in enumerate(table(","))]
    yield RecordCase("honest, remarks", written("a.csv", "\n".join(remarks)), Read(COLUMNS))
    trailing = "\n".join(f"{row},," for row in table(","))
    yield RecordCase("honest, empty cells at the end", written("a.csv", trailing), Read(COLUMNS))
    for head in ("t;x;y", "t\tx\ty", "t,x,y\ns,m,m", "of today\n\nt,x,y"):
        rows = "\n".join([head, *table(",")[1:]])
        yield RecordCase(f"honest, below {head!r}", written("a.csv", rows), Read(COLUMNS))
    blank = "\n\n  \n".join(table(","))
    yield RecordCase("honest, empty lines", written("a.csv", blank), Read(COLUMNS))
    out = table(",")
    out.insert(7, "#0.5,1.0,2.0")
    yield RecordCase("honest, a row that is taken out", written("a.csv", "\n".join(out)), Read(COLUMNS))
    tiny = ["t,x,y", "0,1e-320,5e-324", "1,1.7976931348623157e308,-0.0", "2,+.5,5."]
    numbers = {"t": [0.0, 1.0, 2.0], "x": [1e-320, 1.7976931348623157e308, 0.5], "y": [5e-324, -0.0, 5.0]}
    arrays = {name: np.array(values) for name, values in numbers.items()}
    yield RecordCase("honest, extreme numbers", written("a.csv", "\n".join(tiny)), Read(arrays))


def _cells() -> Iterator[RecordCase]:
    random = np.random.default_rng(20)
    for number, (cell, separator) in enumerate(product(CELLS, [",", ";", "\t"])):
        rows = table(separator)
        line, column = int(random.integers(1, len(rows))), number % 3
        cells = rows[line].split(separator)
        cells[column] = cell
        rows[line] = separator.join(cells)
        words = (f"line {line + 1} ",)
        yield RecordCase(
            f"cell {cell!r} {separator!r}",
            written("a.csv", "\n".join(rows) + "\n"),
            Refused(words),
            {"needed": ("x", "y")},
        )
    for cell in ("1_000", "#N/A", "0x10", "1e400", "nan", "OVL"):  # in a column that is not needed, which is left out
        rows = table(",")
        cells = rows[5].split(",")
        rows[5] = ",".join([*cells[:2], cell])
        yield RecordCase(
            f"cell {cell!r} where it does not count",
            written("a.csv", "\n".join(rows)),
            Read({"t": T, "x": X}),
            {"needed": ("x",)},
        )


def _structure() -> Iterator[RecordCase]:
    for separator, line in product([",", ";", "\t", " "], [2, 17, 41]):
        for what, change in {
            "one cell more": lambda row, s: f"{row}{s}7.5",
            "one cell less": lambda row, s: row.rpartition(s)[0],
            "another separator": lambda row, s: row.replace(s, "|"),
            "two rows in one": lambda row, s: f"{row}{s}{row}",
            "cut off": lambda row, s: row[:3],
            "a quote that is not closed": lambda row, s: f'"{row}',
            "a cell of two lines": lambda row, s: row.replace(s, f'{s}"1\n2"', 1),
        }.items():
            rows = table(separator)
            rows[line - 1] = change(rows[line - 1], separator)
            yield RecordCase(
                f"{what} {separator!r} line {line}",
                written("a.csv", "\n".join(rows) + "\n"),
                Refused((f"line {line}",)),
                {"needed": ("x", "y")},
            )
    commas = "\n".join(["t,x,y", *(row.replace(";", ",") for row in table(";", comma=True)[1:])])
    yield RecordCase("decimal commas between commas", written("a.csv", commas), Refused(("line 2 has 6 cells",)))
    mixed = table(";")
    mixed[9] = mixed[9].replace(".", ",")
    yield RecordCase("points and commas", written("a.csv", "\n".join(mixed)), Refused(("line 10", "decimal comma")))
    thousands = table(";")
    thousands[3] = "0.25;1.000,5;2"
    yield RecordCase(
        "thousands", written("a.csv", "\n".join(thousands)), Refused(("line 4", "1.000,5")), {"needed": ("x", "y")}
    )
    for head, words in {
        "t,x,x": "'x' appears more than once",
        "t,t,y": "'t' appears more than once",
        "t,x": "line 2 has 3 cells",
        "a,b,c": "no column t",
        "1,2,3": "the first line holds numbers",
        '"t,x,y': "line 1: a quote is not closed",
        "": "the first line holds numbers",
        "t,x,y,z": "line 2 has 3 cells",
    }.items():
        rows = [head, *table(",")[1:]]
        yield RecordCase(f"header {head!r}", written("a.csv", "\n".join(rows)), Refused((words,)))
    for name, text, words in (
        ("empty", "", "empty"),
        ("blank", "  \n\n", "empty"),
        ("remarks only", "% a\n// b\n", "empty"),
        ("header only", "t,x,y\n", "no samples"),
        ("html", "<html><body>not found</body></html>", ""),
        ("python", "import os\nos.system('touch hostile_marker')\n", ""),
        ("a long line", "t,x,y\n" + "1" * 10**6, "line 2 has 1 cell"),
        ("a long number", "t,x,y\n0,1,2\n1," + "9" * 10**6 + ",2", "line 3"),
        ("many columns", ",".join(f"c{i}" for i in range(20_000)) + "\n" + "1," * 19_999 + "1", "no column t"),
        ("many quotes", '"' * 99_999, "line 1"),
        ("many separators", "t,x,y\n" + "," * 10**6, "line 2 holds nothing"),
    ):
        yield RecordCase(name, written("a.csv", text), Refused((words,)), {"needed": ("x",)} if "t,x,y" in text else {})


def _bytes() -> Iterator[RecordCase]:
    text = "\n".join(table(",")) + "\n"
    for code in ("utf-16", "utf-16-le", "utf-16-be", "utf-32"):
        words = ("UTF-16",) if code in {"utf-16", "utf-32"} else ("line 1, character 2 is U+0000",)
        words = ("line 1, character 1 is U+0000",) if code == "utf-16-be" else words
        yield RecordCase(code, written("a.csv", text.encode(code)), Refused(words))
    for byte in (0x00, 0x01, 0x07, 0x08, 0x0B, 0x0C, 0x1B, 0x1C, 0x1D, 0x1E, 0x1F, 0x7F):
        spoiled = text.encode()
        at = spoiled.index(b"\n", 200) + 3
        spoiled = spoiled[:at] + bytes([byte]) + spoiled[at:]
        line = spoiled[:at].count(b"\n") + 1
        yield RecordCase(
            f"byte {byte:02x}", written("a.csv", spoiled), Refused((f"line {line}, character 3 is U+{byte:04X}",))
        )
    for byte in (0x80, 0xB5, 0xC0, 0xFF):
        spoiled = text.encode().replace(b"x", bytes([byte]), 1)
        yield RecordCase(
            f"byte {byte:02x} in the names", written("a.csv", spoiled), Refused(("line 1, character 3 is not UTF-8",))
        )
    for character in "\u2028\u2029\u0085":
        spoiled = text.replace("\n", character, 3)
        yield RecordCase(
            f"line ends {ord(character):04x}", written("a.csv", spoiled), Refused(("line 1, character 6",))
        )
    random = np.random.default_rng(21)
    for number in range(60):
        data = bytes(random.integers(0, 256, int(random.integers(1, 400)), dtype=np.uint8))
        yield RecordCase(f"noise {number}", written(f"a{['.csv', '.txt', '.dat'][number % 3]}", data), Refused())


def _clocks() -> Iterator[RecordCase]:
    rows = table(",")

    def with_time(values: list[str]) -> str:
        return "\n".join([rows[0], *(f"{t},{row.partition(',')[2]}" for t, row in zip(values, rows[1:], strict=True))])

    times = [repr(float(t)) for t in T]
    for name, values in {
        "back": [*times[:20], *times[10:30]],
        "twice": [*times[:9], times[8], *times[10:]],
        "constant": ["1.0"] * len(T),
        "reversed": times[::-1],
        "not told apart": [f"{1e17 + i:.1f}" for i in range(len(T))],
    }.items():
        words = "lets its unit be ns" if name == "not told apart" else "must increase strictly"
        yield RecordCase(f"clock {name}", written("a.csv", with_time(values)), Refused((words,)))
    for name, values in {"infinite": ["1e400"], "missing": [""], "a text": ["12:00:00"]}.items():
        yield RecordCase(f"clock {name}", written("a.csv", with_time([*times[:-1], *values])), Refused(("line 41",)))
    gap = T.copy()
    gap[20:] += 1e12
    held = Read({"t": gap, "x": X, "y": Y})
    yield RecordCase("clock with a gap", written("a.csv", with_time([repr(float(t)) for t in gap])), held)
    for dt in (0.0, -1.0, float("nan"), float("inf")):
        yield RecordCase(f"dt {dt}", written("a.csv", "\n".join(rows)), Refused(("positive",)), {"dt": dt})


def _parts() -> Iterator[RecordCase]:
    for part in PARTS:

        def make(folder: Path, part: str = part) -> str:
            return f"{written('a.csv', chr(10).join(table(',')))(folder)}@{part}"

        yield RecordCase(f"part {part!r}", make, Refused())


def _places() -> Iterator[RecordCase]:
    """What is no file, or not the one that it seems to be."""

    def pipe(folder: Path) -> Path:
        os.mkfifo(folder / "a.csv")
        return folder / "a.csv"

    def loop(folder: Path) -> Path:
        (folder / "a.csv").symlink_to(folder / "a.csv")
        return folder / "a.csv"

    def endless(folder: Path) -> Path:
        (folder / "a.csv").symlink_to("/dev/zero")
        return folder / "a.csv"

    def hole(folder: Path) -> Path:
        (folder / "a.csv").touch()
        os.truncate(folder / "a.csv", 2**36)
        return folder / "a.csv"

    def inside(folder: Path) -> Path:
        (folder / "a.csv").mkdir()
        return folder / "a.csv"

    def secret(folder: Path) -> Path:
        return written("secret", SECRET)(folder)

    yield RecordCase("a pipe", pipe, Refused(("no regular file",)))
    yield RecordCase("a link to itself", loop, Refused(("no such record",)))
    yield RecordCase("a link to /dev/zero", endless, Refused(("no regular file",)))
    yield RecordCase("a hole of 64 GiB", hole, Refused(("bytes",)))
    yield RecordCase("a folder with the name of a file", inside, Refused(("no such record",)))
    yield RecordCase("a file without an ending", secret, Refused(("files are not read",)))
    for name in ("a\x00b.csv", "a" * 5000 + ".csv", "nowhere/a.csv", "~nobody/a.csv", "", "@", "@1:2", "/"):
        yield RecordCase(f"path {name[:20]!r}", lambda _, name=name: name, Refused())
    for kind in ("exe", "pkl", "npy", "xlsx", "py", "zip"):
        yield RecordCase(f".{kind}", written(f"a.{kind}", "\n".join(table(","))), Refused(("files are not read",)))
    for kind in ("parquet", "mat", "h5", "npz", "json", "tdms", "mf4", "mcap"):
        yield RecordCase(f"text as .{kind}", written(f"a.{kind}", "\n".join(table(","))), Refused())
        yield RecordCase(f"nothing as .{kind}", written(f"a.{kind}", b""), Refused())
    yield RecordCase("json with a hole", lambda f: _holed(f / "a.json"), Refused(("bytes",)))
    yield RecordCase("parquet with a hole", lambda f: _holed(f / "a.parquet"), Refused())
    yield RecordCase("numpy with a hole", lambda f: _holed(f / "a.npz"), Refused())
    yield RecordCase(
        "either", written("a.txt", "t x\n0 1\n1 2\n"), Either({"t": np.arange(2.0), "x": np.arange(1.0, 3.0)})
    )


def _holed(path: Path) -> Path:
    path.touch()
    os.truncate(path, 2**36)
    return path
