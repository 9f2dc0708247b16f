"""Text in the languages that are written, C and XML: what is known to be good passes, all else is named.

One function for each place of a language: a comment, a name and a string of C, and a text of XML. Names, titles,
meanings, units and file names come from others; none of them becomes code, and none makes a file that is not one of its
language. `filled` puts texts of C into a template.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from masking.display.characters import code_point, visible_line

TEMPLATES: Final = Path(__file__).parent / "templates"
_MARK: Final = re.compile(r"@([A-Z_]+)@")
_LONGEST, _READABLE = 40, 30  # letters of a name, so that what C appends to it stays within its 63
# Ends of names of the programs around a unit, and of what `c_name` makes of a name that it does not let pass.
_ENDS: Final = r"_(?:linux|cortex_m4|arduino|x[0-9a-f]{8})"
_GOOD_NAME: Final = re.compile(rf"(?!.*{_ENDS}$)[A-Za-z](?:_?[A-Za-z0-9])*")
_LETTER: Final = re.compile(r"(?:LATIN|GREEK|CYRILLIC) (?:SMALL|CAPITAL) LETTER ([A-Z]+)")
_BACKSLASH: Final = f"<{code_point(chr(92))}>"  # which joins lines
_TROUBLE: Final = re.compile(r"[*/?](?=[*/?])")  # of which two end or begin a comment, or begin a trigraph
# Names, in small letters, with another meaning.
_WORDS: Final = """
# keywords of C and C++
alignas alignof and and_eq asm atomic auto bitand bitor bool break case catch char class compl complex concept
const consteval constexpr constinit const_cast continue co_await co_return co_yield decltype default delete do
double dynamic_cast else enum explicit export extern false float for friend generic goto if imaginary inline
int long main mutable namespace new noexcept noreturn not not_eq nullptr operator or or_eq private protected
public register reinterpret_cast requires restrict return short signed sizeof static static_assert static_cast
struct switch template this thread_local throw true try typedef typeid typename typeof union unsigned using
virtual void volatile wchar_t while xor xor_eq
# headers of C
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg
stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar
wchar wctype
# headers of POSIX and of the libraries of C
aio alloca cpio dirent dlfcn endian fcntl features fmtmsg fnmatch ftw glob grp iconv ieeefp langinfo libgen
malloc memory monetary mqueue ndbm netdb newlib nl_types poll pthread pwd reent regex sched search semaphore
spawn strings stropts syslog tar termios trace ulimit unctrl unistd utime utmpx values wordexp
# headers of Arduino and Teensy
arduino arm_math audiostream binary cdc client common core_pins elapsedmillis eeprom fs hardwareserial imxrt
interrupts intervaltimer ipaddress keyboard mouse pgmspace pins_arduino print printable sd server smalloc spi
stream udp uart usbapi usbcore usbdesc wcharacter wire wiring wiring_private wprogram wstring
# of what is written here
cortex_m4 fmi2 fmi3 fmi2functions fmi3functions fmu_unit frames unit
# devices, which no file of Windows is named after
aux con nul prn com1 com2 com3 com4 com5 com6 com7 com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
"""
_TAKEN: Final = frozenset(re.sub("#.*", "", _WORDS).split())


def c_name(text: str) -> str:
    """Name in C, and of files, for any text; texts that differ have names that differ.

    A name of C passes that is short and is no keyword, header or device. Any other text becomes what can be read of it,
    in ASCII, and a part of its hash.
    """
    if len(text) <= _LONGEST and _GOOD_NAME.fullmatch(text) and text.lower() not in _TAKEN:
        return text
    letters = "".join(map(_ascii, unicodedata.normalize("NFKD", text)))
    words = re.findall("[A-Za-z0-9]+", letters) or ["unit"]
    start = "_".join(words if words[0][0].isalpha() else ["unit", *words])
    return f"{start[:_READABLE].rstrip('_').lower()}_{_tag(text)}"


def c_macro(name: str) -> str:
    """Beginning of macros for a name that `c_name` made; names that differ in capitals alone have others."""
    return name.upper() if name.islower() else f"{name}_{_tag(name)}".upper()


def c_comment(text: str) -> str:
    """Text in a comment of C, in a line: it neither ends the comment nor joins lines, whatever stands around it."""
    return _TROUBLE.sub(r"\g<0> ", _line(text).replace("\\", _BACKSLASH))


def c_string(text: str) -> str:
    """String of C, with its quotes: ASCII as it is, all else as the bytes of its UTF-8."""
    return f'"{"".join(_in_c_string(byte) for byte in text.encode())}"'


def xml_text(text: str) -> str:
    """Text of XML 1.0, in a line, which has no control characters and no noncharacters; what marks it up is escaped."""
    return _line(text)


def filled(file: str, marks: Mapping[str, str]) -> str:
    """Text of a template, in which each @MARK@ is filled in once; what is filled in is not looked at."""
    text = (TEMPLATES / file).read_text(encoding="utf-8")
    return _MARK.sub(lambda match: marks[match[1]], text)


def _line(text: str) -> str:
    return visible_line(" ".join(text.split()))


def _tag(text: str) -> str:
    return f"x{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def _ascii(character: str) -> str:
    """ASCII for a character: the name of a Greek letter, the number of an ideogram, a blank for what is no letter."""
    if character.isascii():
        return character
    if unicodedata.combining(character):
        return ""
    if found := _LETTER.match(unicodedata.name(character, "")):
        return found[1].lower() if character.islower() else found[1].capitalize()
    return f" u{ord(character):x} " if character.isalpha() else " "


def _in_c_string(byte: int) -> str:
    is_plain = 0x20 <= byte < 0x7F and chr(byte) not in '"\\?'  # of two ? comes a trigraph
    return chr(byte) if is_plain else f"\\{byte:03o}"
