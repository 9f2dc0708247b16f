"""Every entry of the comparison by its number, in the order of the source document."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from masking.errors import DeclarationError, Problem, nearest
from reproduction import (
    appendices,
    beam,
    chapter4,
    chapter5,
    chapter7,
    chapter8,
    chapter9,
    derivations,
    enoc,
    errata,
    open_questions,
)
from reproduction.comparison import Entry

Chapter = Mapping[str, Callable[[], Entry]]

CHAPTERS: Final[Mapping[str, Chapter]] = MappingProxyType(
    {
        "Chapter 4: identification": {
            "Table 4.2": chapter4.table_4_2,
            "Fig. 4.2": chapter4.fig_4_2,
            "Fig. 4.3": chapter4.fig_4_3,
            "Fig. 4.4": chapter4.fig_4_4,
            "Table 4.3": beam.table_4_3,
            "Fig. 4.5": chapter4.fig_4_5,
            "Fig. 4.6": chapter4.fig_4_6,
            "Fig. B.1": appendices.fig_b_1,
            "Table B.3": appendices.table_b_3,
            "Table C.1": appendices.table_c_1,
            "Table C.2": appendices.table_c_2,
            "Fig. C.3": appendices.fig_c_3,
            "Fig. C.5": appendices.fig_c_5,
            "Fig. C.6": appendices.fig_c_6,
        },
        "Chapter 5: the set-up itself": {
            "Fig. 5.1": chapter5.fig_5_1,
            "Fig. 5.2": chapter5.fig_5_2,
            "Fig. 5.3": chapter5.fig_5_3,
            "Fig. 5.4": chapter5.fig_5_4,
        },
        "Chapter 7: Duffing oscillators": {
            "Table 7.2": chapter7.table_7_2,
            "Fig. 7.2": chapter7.fig_7_2,
            "Table 7.3": chapter7.table_7_3,
            "Fig. 7.3": chapter7.fig_7_3,
        },
        "Chapter 8: rotating discs": {
            "Table 8.2": chapter8.table_8_2,
            "Fig. 8.2": chapter8.fig_8_2,
            "Fig. 8.3": chapter8.fig_8_3,
            "Table 8.3": chapter8.table_8_3,
            "Fig. 8.4": chapter8.fig_8_4,
            "Table 8.4": chapter8.table_8_4,
            "Fig. 8.5": chapter8.fig_8_5,
            "Fig. 8.6": chapter8.fig_8_6,
        },
        "Chapter 9: Huygens' clocks": {
            "Table 9.2": chapter9.table_9_2,
            "Fig. 9.2": chapter9.fig_9_2,
            "Section 9.2": chapter9.section_9_2,
        },
        "The ENOC paper": {
            "ENOC Table 1": enoc.table_1,
            "ENOC Table 2": enoc.table_2,
            "ENOC Fig. 4 and 5": enoc.fig_4_5,
            "ENOC Fig. 6 and 7": enoc.fig_6_7,
            "ENOC Fig. 9 and 10": enoc.fig_9_10,
        },
        "What the document leaves open": {
            "Section 3.1": open_questions.heavy_beam,
            "Section 10.2": open_questions.weakest_coupling,
            "Section 10.2, laws": open_questions.coupling_laws,
            "Section 10.2, control": open_questions.controlled,
        },
        "Where the document contradicts itself": {
            "Erratum: Table 4.1": errata.gains,
            "Erratum: 4.2.1": errata.crest,
            "Erratum: (4.3)": appendices.momentum,
            "Erratum: Table 4.1, nu": appendices.excitation,
            "Erratum: (4.13)": errata.oscillator,
            "Erratum: Table B.4": appendices.red_spring,
            "Erratum: C.6.1": appendices.air,
            "Erratum: Table 7.2": errata.cubic,
            "Erratum: (7.4)": errata.beam_sum,
            "Erratum: (8.11)": errata.damping_entry,
            "Erratum: theorem 5.1": derivations.shape_functions,
            "Erratum: Fig. 7.3": derivations.printed_eps,
            "Erratum: (8.3)": derivations.inertia,
            "Erratum: (8.15)": derivations.power,
            "Erratum: (A.12)": derivations.index,
            "Erratum: (A.4)": errata.reaction,
            "Erratum: (A.21)": errata.stiffness_power,
        },
    }
)
ENTRIES: Final[Chapter] = MappingProxyType({n: make for chapter in CHAPTERS.values() for n, make in chapter.items()})


def chosen(only: str | None) -> tuple[str, ...]:
    """Return the numbers of the entries that a word stands for: all, or those with this number in their name.

    Raises:
        DeclarationError: there is none.
    """
    if only is None:
        return tuple(ENTRIES)
    if not only.strip():
        raise DeclarationError(Problem(None, "--only", "it is empty", "name a figure or table, such as 7.2"))
    exact = tuple(n for n in ENTRIES if only.lower() in {n.lower(), n.lower().split(" ", 1)[1]})
    found = exact or tuple(n for n in ENTRIES if only.lower() in n.lower())
    if not found:
        raise DeclarationError(Problem(None, "--only", f"there is no figure or table '{only}'", nearest(only, ENTRIES)))
    return found
