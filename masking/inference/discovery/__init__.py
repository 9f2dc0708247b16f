"""Discovery: which physical effect a model is missing, found from a record that it does not reproduce.

`discovery_stages` is the whole way from a record to a result. `readings` are the ways to take the record,
`search_state` what every move of the `search` looks at; moves are in `more_causes`, `other_laws`, `wrong_parameters`
and `further_places`. Candidates come from `candidates` at `places`, are ordered by `screening`, and fitted by
`fitting`. A law without a name is in `free_law` and `unnamed_law`. The word of the verdict is `verdict.decide`, by
the thresholds of `decision_rules`; `answer_by_validation` chooses by unseen data, and `unnamed_as_rival` may take a
name back. A delay of an actuator or of the loop is a candidate as any other; small ones are adjusted by
`instrument_errors`.

In: a record that a model does not reproduce.
Out: the physical effect that the model lacks, and a verdict.
Imports: numerics, declaration, display, effects, codegen, records, signals, rig, estimation.
"""
