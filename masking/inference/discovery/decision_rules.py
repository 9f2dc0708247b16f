"""Rules: the thresholds of a search and of its verdict, each with its meaning and the reason for its value.

Numbers of one step, such as the starts of a fit, stand in the module of that step; those of the probability that no
name is right, and of laws without a name, in `verdict` and `unnamed_law`.

Costs are -2 log likelihoods: a squared deviation of one standard deviation costs 1. "Benchmark" is the suite of
`make bench-discovery`. "Gaussian motion" is one whose displacement and rate are normally distributed, as under
multisines: a law is then a sum of Hermite polynomials, each of which takes its own part of the mean square. Of dry
friction, sign(v), the linear one takes 2/pi = 64 %, of a cubic spring 9/15 = 60 %.
Source: Kass and Raftery (1995), JASA 90(430), 773-795, for differences of costs; Wilks (1938), Ann. Math. Stat. 9(1),
60-62, for likelihood ratios of nested models; Bussgang (1952), MIT RLE Technical Report 216, for laws under Gaussian
motion; Widrow and Kollar (2008), Quantization Noise, chapter 5, for rounding.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DecisionRules:
    """The thresholds of a search and of its verdict."""

    # Residual and noise

    noise_floor: float = 1.05
    """Residual rms over noise rms that is at the noise floor, beside the sampling error of the noise.

    Why: 5 % of the rms is 10 % of the cost: less than the smallest effect of the benchmark makes, more than errors of
    integration and of parameters leave. Of 33 records of its quick suite, none ends between 1.0 + the sampling error
    and 1.1 but one, whose residual is not white.
    """

    chance_deviations: float = 3.0
    """Standard deviations from which a difference is no chance: of the estimated noise (`verdict.noise_threshold`) and,
    sqrt(2 m), of a chi-squared cost.

    Why: of the noise of a sensor, they are 0.024 for 20 000 readings, 0.17 for 400; integration errors stay below.
    """

    initial_state_share: float = 1e-3
    """Estimated initial states per reading from which the whiteness of a residual is not tested.

    Why: estimating them takes noise out of the beginning of each shooting interval, which colours the residual. At 1
    per 1000 readings this is below the resolution of the whiteness test (0.1 %).
    """

    small_residual: float = 4.0
    """Cost per reading up to which a residual is small: it is screened itself, and may remain unexplained.

    Why: twice the noise in rms: the unexplained part is then sqrt(3) times the noise, so that 10 % that missing forces
    distort in each other's response stay well below it. Above, the residual of the model as declared is screened
    instead.
    """

    slow_excess: float = 1.3
    """Cost of block means, over that of white noise, that a screen takes as the cost of noise.

    Why: with 300 blocks the ratio of white noise has a standard deviation of 0.08; 1.3 is more than three of them.
    """

    # Evidence for one cause

    effect_evidence: float = 14.0
    """Price of an effect, as -2 log of its odds before the record.

    Why: odds of one in a hundred candidates, and of nine to one for a name: 2 log 100 + 2 log 9 = 13.6. Residuals count
    for what they are worth, so that no more is asked against their colour. Half of it, beyond the complexity penalty,
    is asked of a screening score.
    """

    parameter_evidence: float = 9.0
    """Price of a wrong parameter.

    Why: a likelihood ratio of (3 sigma)^2 for one degree of freedom (Wilks). It is less than that of an effect, since a
    model has its parameters, and would have to be given an effect.
    """

    indifferent: float = 2.0
    """Difference of scores that separates nothing.

    Why: Kass and Raftery: up to 2 is not worth more than a bare mention. A further parameter that takes no more does
    nothing, and an exchange of effects that gains no more is not made.
    """

    redundant_fraction: float = 1e-7
    """Part of the reduction of the cost by which nested models may differ and still be the same.

    Why: that is the relative error of integration at the steps that `law_error` allows.
    """

    # Several causes

    most_effects: int = 4
    """Effects in one explanation at most.

    Why: each round costs a screen and up to eight fits; no record of the benchmark has more than three causes.
    """

    gain_fraction: float = 0.2
    """Part of the gain of the best explanation that a simpler law may lack, where others are looked for beside it, too.

    Of a law that leaves more, another shape is not fitted.

    Why: laws that only resemble the missing one take smaller and smaller parts, one after the other: of dry friction
    under Gaussian motion a linear, a cubic and a quintic law take 64 %, 29 % and 19 % of what the last one left; the
    third is no sum of two causes.
    """

    unexplained_fraction: float = 0.3
    """Part of the excess cost that named effects may leave, in either record.

    Why: below the 36 % and 40 % that a linear law leaves of dry friction and of a cubic spring under Gaussian motion,
    so that neither is named in the place of the other.
    """

    small_unexplained_fraction: float = 0.7
    """The same if the residual is small (`small_residual`).

    Why: a weak effect is named beside errors of the model up to sqrt(0.7 / 0.3) = 1.5 times as large in rms, which are
    expected where the residual is small.
    """

    trace_fraction: float = 0.05
    """Part of the excess cost of the model as declared that counts as small, however far above noise.

    Why: 5 % of the cost is 22 % of the rms: as much as a law leaves whose factor is right and whose shape is a fifth
    off. Its steps of integration are then those that it needs.
    """

    # Hard facts

    excluded_deviations: float = 6.0
    """Deviations of the noise beyond the range of a sensor's law from which a reading excludes the law.

    Why: of a billion readings with normal noise, two.
    """

    excluded_spreads: float = 3.0
    """Spreads of the errors of instruments beyond which one counts only if it leaves no more than noise.

    Why: a larger error of a sensor imitates any law whose force or motion it reads, as no law of a rig is exact.
    """

    # Which candidates are fitted

    few_fits: int = 3
    """Candidates that are fitted in each round at least, whatever they are worth.

    At most as many parameters are freed by themselves, laws tried in the place of each cause, pairs, and laws from
    afar.

    Why: a fit more costs time, a right effect left out costs the answer; on the benchmark it was among the first three
    of the first-order score.
    """

    most_fits: int = 8
    """Candidates that are fitted in each round at most.

    Why: limits computing time.
    """

    fit_ratio: float = 2.5
    """Excess that a candidate may leave in the screen over that of the best to be fitted.

    Why: the right law may look sqrt(2.5) = 1.6 times worse in rms than a wrong one, by linearisation and by the grid
    of its shapes, and is fitted still; a larger value costs computing time alone, up to `most_fits`.
    """

    screen_resolution: float = 0.05
    """Part of the noise cost below which excesses in a screen are equal.

    Why: as `noise_floor`: half of the excess that is at the noise floor.
    """

    screened_frequency: float = 60.0
    """Highest frequency in Hz that a screen resolves, or twice that of the fastest mode of the rig if that is higher.

    It resolves less, twice the frequency where readings fall below their noise, if that is lower.

    Why: beyond twice its fastest mode a rig passes less than a third of a force, 1 / (2^2 - 1), and less and less
    above. 60 Hz hold ten harmonics of motions of up to 6 Hz if all modes are slower.
    """

    afar: float = 0.5
    """Part of the work of a search that laws may take which are fitted from each of their starts.

    Why: limits computing time; where the first fits leave much, these are the next hope.
    """

    score_fraction: float = 0.5
    """Part of the best score from which a candidate's shape is optimised in the screen.

    Also that from which a force between coordinates is searched: gyroscopic forces are two.

    Why: a score is a squared correlation: half of it is a cosine of 0.71. A shape lies within one step of its grid,
    which gains less than a factor of two.
    """

    most_sharpened: int = 24
    """Candidates whose shapes are optimised at most.

    Why: limits computing time; three times `most_fits`.
    """

    hopeless_fraction: float = 0.03
    """Part of the distance to a better fit that each step of a fit must take; one that takes less, `hopeless_steps`
    times in a row, ends.

    Why: at 3 % in each, the way takes more than 33 steps; with six before, that is all that a fit may take, 40.
    """

    hopeless_steps: int = 6
    """Steps in a row after which such a fit ends.

    Why: three steps in vain raise the damping by 1e6; three more show whether that helps.
    """

    # Verdict

    named_probability: float = 0.9
    """Posterior probability from which the first explanation is named, not ambiguous.

    Why: one wrong in ten among those that are just named is accepted; stated in the documentation.
    """

    significant_deviations: float = 2.0
    """Standard deviations that a parameter of the last cause must be off, if the residual is above the noise floor.

    Why: two standard deviations, 95 %, of the posterior.
    """

    unique_fraction: float = 0.03
    """Fraction of an effect's response outside the span of the parameters' responses, below which it is a parameter.

    Why: three times the default tolerance of parameters, 1 %: responses are those at fitted values, which may be off
    by that.
    """

    composite_laws: int = 3
    """Linear effects, or effects at one place, that together are a composite explanation.

    Why: mass, damping and stiffness make any linear system of second order; three laws of one motion nearly any force.
    """

    worse_fraction: float = 1e-3
    """Part of the cost of the model as declared, on unseen data, by which an answer may exceed it, beside chance.

    Why: 0.05 % of the error: effects that unseen data do not excite change it by less.
    """

    validation_margin: float = 60.0
    """Difference of scores up to which alternatives are fitted to both records together.

    Why: four times `effect_evidence`; larger differences were never reversed by a validation record of equal length.
    """

    rounding_fraction: float = 0.3
    """Part of the noise variance that rounding must make to be named, and of the residual to be the verdict.

    Why: a step of sqrt(0.3 * 12) = 1.9 standard deviations: noise dithers steps up to 2 deviations, whose rounding is
    white noise like any other.
    """

    # When a record is read in another way

    much_less: float = 0.5
    """Part of an error that is far less: of that on unseen data, another reading of the record leaves no more.

    Fits that leave far more than the best are not repeated in finer steps; two causes at one place are tried where they
    may leave so much of the cost of the best single one, a law without a name where it may take as much of the rest.

    Why: readings are few, and none is likelier than another but for what it explains; a factor of two is no chance.
    """

    phase_loss: float = 0.5
    """Relative residual of a sensor from which the simulated motion has lost phase with the record.

    Why: a phase of 29 degrees, 2 sin(phase/2) = 0.5; between 0, a perfect simulation, and sqrt(2), one of the right
    size and random phase.
    """

    ringing_periods: float = 10.0
    """Periods in which a mode decays to 1/e from which a fit that is not at the noise floor is repeated in growing
    intervals.

    Why: an error of 5 % in a frequency, 10 % in a stiffness, adds up to pi within ten periods, where the cost has
    further minima; below, the motion has forgotten them.
    """

    first_order_hold_fraction: float = 0.2
    """Part of the excess cost that inputs with first-order hold may leave for the answer to suggest them.

    Why: a suggestion, no verdict: a factor of five is more than a change of hold makes by chance.
    """

    # Prior and validation record

    held_out: float = 0.3
    """Part of a record that is held out for validation if no other record is given.

    Why: the usual split of 70 : 30.
    """

    freed_factor: float = 1e3
    """Factor by which the prior standard deviation of a freed parameter grows.

    Why: ten times the declared value at the default tolerance of 1 %: no information, and still a proper prior.
    """

    sign_deviations: float = 1.0
    """Prior standard deviations from 0 from which a parameter keeps its sign.

    Why: masses, stiffnesses and dampings do not change sign. A deviation as large as the value says that it may be far
    smaller or larger, and only one that is larger than the value, that the sign is open.
    """

    # Shooting intervals

    settling_rates: float = 10.0
    """Real part of an eigenvalue times the length of the record below which a mode does not settle in it.

    Why: exp(-10) = 5e-5: the initial state is forgotten to below the noise.
    """

    intervals: int = 20
    """Shooting intervals of a record of a model that does not settle.

    Why: drift, which grows with the square of time, is 400 times smaller; 20 initial states of six numbers take 1.2 %
    of 10 000 readings.
    """

    fewest_samples: int = 200
    """Samples of a shooting interval at least.

    Why: an initial state of six numbers then takes 1 % of 600 readings.
    """

    interval_periods: tuple[float, ...] = (4.0, 1.0)
    """Periods of the slowest mode in a shooting interval if the simulated motion loses phase, in order of trial.

    Why: a motion of 10 % wrong frequency loses half a period in five; one period is the shortest that shows the mode.
    """

    # Integration steps

    stiff_steps: int = 8
    """Integration steps per sample at least for models with forces that act on states.

    Why: friction stops a state within a sample, which the linearisation at rest does not show.
    """

    integration_error: float = 0.1
    """Integration error of the model as declared, over the noise.

    Why: adds 0.5 % to the residual rms, a tenth of what `noise_floor` allows.
    """

    law_error: float = 0.05
    """The same with a law that was found.

    Why: half of it, as the steps of a law decide between laws.
    """

    most_refinement: int = 16
    """Factor by which a law may refine the integration steps at most.

    Why: limits computing time; laws that need more are reported with the steps that they have.
    """

    # Periodic forces

    tones: int = 4
    """Frequencies of a periodic force that are tried: the strongest lines of the latent forces.

    Why: limits computing time; the force is sought again in the remainder.
    """

    # Experiment that separates

    separation: float = 40.0
    """Difference of costs from which an experiment separates two explanations.

    Why: three times `effect_evidence`: the simulated difference is that of the best case, without errors of the model.
    """


RULES = DecisionRules()  # the values of every discovery that is not given others
