"""Discovery: which physical effect a model is missing, found from a record that it does not reproduce.

`discovery_stages` is the whole way from a record to a result. `readings` are the ways to take the record, with the
noise of `reading_noise`; `search_state` is what every move of the `search` looks at, and moves are in `more_causes`,
`other_laws` and `wrong_parameters`. Candidates come from `candidates` at `places`, are ordered by `screening`, and
fitted by `fitting` as an `estimation_problem`, which has their errors and the noise floor; `validation_simulation`
simulates them along unseen data. A law without a name is in `free_law`, `further_places` and `unnamed_law`. The word
of the verdict is `verdict.decide`, by the thresholds of `decision_rules`; `verdict.revised`, `answer_by_validation`
and `unnamed_as_rival` may change it. A delay of an actuator or of the loop is a candidate as any other; small ones
are adjusted by `instrument_errors`.

In: a record that a model does not reproduce.
Out: the physical effect that the model lacks, and a verdict.
Imports: numerics, declaration, display, effects, codegen, records, signals, rig, estimation.
"""
