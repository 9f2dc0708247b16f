"""The rows of docs/thesis.md computed a second time, with numpy and scipy alone; nothing of the project is imported.

`ENTRIES` has a function for each figure, table and erratum; it returns its numbers by the names that the page gives
them. Equations, parameters and initial states are typed out again from the document.
"""

from tests.second_implementation import set_up, virtual_systems

ENTRIES = {
    "Table 4.2": set_up.table_4_2,
    "Fig. 4.2": set_up.fig_4_2,
    "Fig. 4.3": set_up.fig_4_3,
    "Fig. 4.6": set_up.fig_4_6,
    "Fig. 5.1": set_up.fig_5_1,
    "Fig. 5.2": set_up.fig_5_2,
    "Fig. 5.3": set_up.fig_5_3,
    "Fig. 5.4": set_up.fig_5_4,
    "Table 7.2": virtual_systems.table_7_2,
    "Table 7.3": virtual_systems.table_7_3,
    "Fig. 7.2": virtual_systems.fig_7_2,
    "Fig. 7.3": virtual_systems.fig_7_3,
    "Table 8.2": virtual_systems.table_8_2,
    "Fig. 8.2": virtual_systems.fig_8_2,
    "Fig. 8.3": virtual_systems.fig_8_3,
    "Table 8.3": virtual_systems.table_8_3,
    "Fig. 8.4": virtual_systems.fig_8_4,
    "Fig. 8.5": virtual_systems.fig_8_5,
    "Fig. 8.6": virtual_systems.fig_8_6,
    "Table 9.2": virtual_systems.table_9_2,
    "Fig. 9.2": virtual_systems.fig_9_2,
    "Section 9.2": virtual_systems.section_9_2,
    "ENOC Fig. 6 and 7": virtual_systems.enoc_fig_6_7,
    "ENOC Fig. 9 and 10": virtual_systems.enoc_fig_9_10,
    "Section 3.1": set_up.section_3_1,
    "Section 10.2": set_up.section_10_2,
    "Section 10.2, laws": set_up.section_10_2_laws,
    "Section 10.2, control": set_up.section_10_2_control,
    "Erratum: Table 4.1": set_up.erratum_gains,
    "Erratum: 4.2.1": set_up.erratum_crest,
    "Erratum: (4.13)": set_up.erratum_oscillator,
    "Erratum: (A.4)": set_up.erratum_reaction,
    "Erratum: Table 7.2": virtual_systems.erratum_cubic,
    "Erratum: (7.4)": virtual_systems.erratum_sum,
    "Erratum: (8.11)": virtual_systems.erratum_damping_entry,
    "Erratum: theorem 5.1": set_up.erratum_shape_functions,
    "Erratum: Fig. 7.3": set_up.erratum_eps,
    "Erratum: (8.3)": virtual_systems.erratum_inertia,
    "Erratum: (8.15)": virtual_systems.erratum_power,
    "Erratum: (A.12)": set_up.erratum_index,
    "Erratum: (A.21)": set_up.erratum_stiffness_power,
}
