"""Names, titles, meanings, units and file names in what is exported, judged by gcc, g++ and a reader of XML."""

import re
import shutil
import subprocess
import unicodedata
import zipfile
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest

from masking.control.exports import fmu_unit, unit_files
from masking.control.exports.rig_units import twin_unit
from masking.control.exports.target_text import TEMPLATES, c_comment, c_macro, c_name, c_string, filled, xml_text
from masking.control.exports.unit import Channel
from masking.control.rig.twin import Twin
from tests.support.arduino import LIBRARY
from tests.support.compiled_unit import GCC, STRICT

GXX = shutil.which("g++")
needs_gcc = pytest.mark.skipif(GCC is None or GXX is None, reason="there is no gcc or no g++")
SENTINEL = re.compile(r"\binjected\b")  # stands in hostile texts alone, and nowhere in what is exported but in text
PIECES = ["injected", "int injected;", "*/", "/*", "//", "*\\\n/", "??/", "\\", '"', "'", "#define injected\n",
          "@NAME@", "@TITLE@", "@UPPER@", "]]>", "<!--", "&amp;",
          "<injected a='1'>", "%s", "{0}", "${injected}"]  # fmt: skip
ALPHABETS = {
    "punctuation": [chr(c) for c in range(0x20, 0x7F)],
    "letters": [
        chr(c)
        for c in (*range(0x41, 0x17F), *range(0x391, 0x3CA), *range(0x410, 0x450), *range(0x4E00, 0x4E40), 0xFF58)
        if unicodedata.category(chr(c)).startswith("L")
    ],
    "controls": [chr(c) for c in (*range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F),
                                  *range(0x2066, 0x206A), 0xD800, 0xDFFF, 0xFDD0, 0xFEFF, 0xFFFE, 0xFFFF, 0x10FFFF)],
}  # fmt: skip
WORDS = ["int", "main", "unit", "math", "time", "string", "stdint", "frames", "fmu_unit", "fmi2", "linux", "errno",
         "con", "a_linux", "Unit", "MATH", "x_x00000000"]  # fmt: skip


def texts(alphabet, count, seed=0):
    """Return different hostile texts: words of C, and characters of an alphabet among pieces that inject."""
    generator, found = np.random.default_rng(seed), dict.fromkeys(WORDS)
    while len(found) < count:
        letters = ALPHABETS[alphabet]
        pieces = [letters[i] for i in generator.integers(len(letters), size=generator.integers(13))]
        for _ in range(generator.integers(4)):
            pieces.insert(generator.integers(len(pieces) + 1), PIECES[generator.integers(len(PIECES))])
        found["".join(pieces)] = None
    return [*found][:count]


@cache
def plant():
    return twin_unit(Twin.load("cart"), "plant", 1000.0)


def hostile(text):
    """Return a unit with a text as its file name, its title, a note, and the names, units and meanings of channels."""
    unit, channel = plant(), Channel(text, text, text)
    return replace(
        unit,
        name=c_name(text),
        title=text,
        notes=(text,),
        ports={port: (channel,) * len(channels) for port, channels in unit.ports.items()},
        states=(channel,) * len(unit.states),
    )


def compiled(files, *flags, compiler=GCC):
    made = subprocess.run([compiler, *flags, *map(str, files)], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr[:2000]
    return made.stdout


def tokens(files, *flags, compiler=GCC):
    """Return what a compiler reads in files, after line splices, trigraphs, comments and its own strings."""
    return re.sub(r'"(\\.|[^"\\\n])*"', '""', compiled(files, "-E", "-P", *flags, compiler=compiler))


def written(folder, units):
    """Write all programs in C of units into a folder; return the sources and the sketches."""
    folder.mkdir(exist_ok=True)
    (folder / "Arduino.h").write_text(LIBRARY)
    before = {path.name for path in folder.iterdir()}
    for unit in units:
        files = unit_files.write(unit, folder, "c", "double")
        own = [path.name for path in files if path.name not in {"frames.h", "cortex_m4.ld"}]
        assert not before & {*own}  # no file replaces one of another unit
        before |= {*own}
    sources = sorted(path for path in folder.glob("*.c") if not path.stem.endswith("_cortex_m4"))
    return sources, sorted(folder.glob("*.ino"))


@needs_gcc
@pytest.mark.parametrize("alphabet", ALPHABETS)
def test_whatever_names_are_the_headers_of_all_units_go_into_one_program(alphabet, tmp_path):
    units = [hostile(text) for text in texts(alphabet, 150)]
    for unit in units:
        (tmp_path / f"{unit.name}.h").write_text(unit_files.CUnit(unit, "double").header(), encoding="utf-8")
    every = tmp_path / "every.c"
    every.write_text("".join(f'#include "{unit.name}.h"\n' for unit in units))
    assert len({unit.name for unit in units}) == len({c_macro(unit.name) for unit in units}) == len(units)
    # Its folder comes before those of the system: no header of theirs is one of a unit.
    compiled([every], *STRICT, "-Wcomment", "-Wtrigraphs", "-Wbidi-chars=any", "-fsyntax-only", f"-I{tmp_path}")
    compiled([every], "-xc++", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{tmp_path}", compiler=GXX)
    assert not SENTINEL.search(tokens([every], "-std=c99", f"-I{tmp_path}"))


@needs_gcc
@pytest.mark.parametrize("alphabet", ALPHABETS)
def test_whatever_names_are_the_programs_of_a_unit_compile_and_hold_none_of_them_as_code(alphabet, tmp_path):
    units = [hostile(text) for text in ("math", *texts(alphabet, 60)[-2:])]
    sources, sketches = written(tmp_path, units)
    compiled(sources, *STRICT, "-Wcomment", "-Wtrigraphs", "-fsyntax-only", f"-I{tmp_path}")
    compiled(sketches, "-xc++", "-Wall", "-Werror", "-fsyntax-only", f"-I{tmp_path}", compiler=GXX)
    for source in sources:
        assert not SENTINEL.search(tokens([source], "-std=c99", f"-I{tmp_path}"))
    for sketch in sketches:
        assert not SENTINEL.search(tokens([sketch], "-xc++", f"-I{tmp_path}", compiler=GXX))


@pytest.mark.parametrize("alphabet", ALPHABETS)
def test_whatever_names_are_an_fmu_is_xml_that_says_them(alphabet, tmp_path, monkeypatch):
    monkeypatch.setattr(fmu_unit, "has_binary", lambda: False)
    for text in texts(alphabet, 40)[-20:]:
        unit = hostile(text)
        for path in fmu_unit.write(unit, tmp_path):
            with zipfile.ZipFile(path) as archive:
                names = [name for name in archive.namelist() if name.endswith(".xml")]
                pages = [ElementTree.fromstring(archive.read(name)) for name in names]  # noqa: S314  # our own
            assert pages[0].get("description") == xml_text(text)
            assert {e.get("name") for e in pages[0].find("ModelVariables")} >= {xml_text(text), "time"}
            assert not [e for page in pages for e in page.iter() if e.tag == "injected"]


@needs_gcc
@pytest.mark.skipif(not fmu_unit.has_binary() or shutil.which("nm") is None, reason="FMUs get no binary here")
def test_the_binary_of_an_fmu_has_no_symbol_from_a_name(tmp_path):
    text = "x *\\\n/ int injected(void){return 1;} /* *\\\n"
    for path in fmu_unit.write(hostile(text), tmp_path):
        with zipfile.ZipFile(path) as archive:
            (library,) = [name for name in archive.namelist() if name.endswith(".so")]
            archive.extract(library, tmp_path)
        assert not SENTINEL.search(compiled([tmp_path / library], compiler="nm"))


@needs_gcc
def test_a_unit_is_not_named_like_a_header_that_its_programs_reach(tmp_path):
    included = {
        name
        for path in TEMPLATES.iterdir()
        for name in re.findall(r"#include <(\w+\.h)>", path.read_text(encoding="utf-8"))
        if name != "Arduino.h"
    }
    source = tmp_path / "a.c"
    source.write_text("".join(f"#include <{name}>\n" for name in sorted(included)))
    reached = {
        *compiled([source], "-M", "-std=gnu17").split(),
        *compiled([source], "-M", "-xc++", compiler=GXX).split(),
    }
    stems = {one.rpartition("/")[2].removesuffix(".h") for one in reached if re.search(r"include/\w+\.h$", one)}
    assert {"math", "stdint", "features"} <= stems
    assert [stem for stem in stems if c_name(stem) == stem] == []


def test_good_names_pass_and_others_can_be_read():
    assert [*map(c_name, ("duffing", "Rig_2", "cart_van_der_pol"))] == ["duffing", "Rig_2", "cart_van_der_pol"]
    for text, start in (("my-rig", "my_rig_x"), ("Schw\u00e4mme", "schwamme_x"), ("\u03a3 2", "sigma_2_x")):
        assert c_name(text).startswith(start)
    assert c_name("1st").startswith("unit_1st_x")
    assert max(map(len, map(c_name, texts("letters", 300)))) <= 40
    assert len({c_name(x) for x in ("a b", "a-b", "a_b", "a__b", "A_b", c_name("a b"))}) == 6


@needs_gcc
def test_a_string_of_c_is_the_bytes_of_its_text(tmp_path):
    source, program = tmp_path / "a.c", tmp_path / "a"
    given = texts("punctuation", 60) + texts("letters", 60)
    lines = "".join(f"    puts({c_string(text)});\n" for text in given)
    source.write_text(f"#include <stdio.h>\nint main(void)\n{{\n{lines}    return 0;\n}}\n", encoding="utf-8")
    compiled([source], *STRICT, "-Wtrigraphs", "-o", program)
    assert (
        subprocess.run([program], capture_output=True, check=True).stdout == "".join(f"{x}\n" for x in given).encode()
    )


def test_a_template_is_filled_once():
    marks = {"NAME": "a", "INPUTS": "@OUTPUTS@", "OUTPUTS": "@NAME@", "REAL": "double", "BEGIN": "", "STEP": ""}
    assert "a line of @OUTPUTS@ numbers in, a line of @NAME@ numbers out" in filled("linux.c", marks)


def test_a_comment_keeps_what_is_read():
    assert c_comment("m/s\u00b2, 50 % of \u03b1") == "m/s\u00b2, 50 % of \u03b1"
    assert c_comment("a */ b\n ??/ \x07 c\\") == "a * / b ? ? / <U+0007> c<U+005C>"
