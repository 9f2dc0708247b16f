"""Rules: every number that takes part in a verdict of discovery, with its meaning and the reason for its value.

Costs are -2 log likelihoods: a squared deviation of one standard deviation costs 1. "Benchmark" is the suite of
`make bench-discovery`; a value "chosen on the benchmark" has no better reason than its records, and no measured
sensitivity unless one is stated.
Source: Kass and Raftery (1995), JASA 90(430), 773-795, for differences of costs; Wilks (1938), Ann. Math. Stat. 9(1),
60-62, for likelihood ratios of nested models.
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

    noise_deviations: float = 3.0
    """Standard deviations of the estimated noise that are added to it, see `verdict.noise_threshold`.

    Why: three standard deviations; 0.024 for a sensor with 20 000 readings, 0.17 for one with 400.
    """

    initial_state_share: float = 1e-3
    """Estimated initial states per reading from which the whiteness of a residual is not tested.

    Why: estimating them takes noise out of the beginning of each shooting interval, which colours the rest. At 1 per
    1000 readings this is below the resolution of the whiteness test (0.1 %).
    """

    small_residual: float = 4.0
    """Cost per reading up to which a residual is small: it is screened itself, and may remain unexplained.

    Why: twice the noise in rms. Above, missing forces distort each other's response, and the residual of the model as
    declared is screened instead. Chosen on the benchmark.
    """

    excess_deviations: float = 3.0
    """Standard deviations sqrt(2 m) of a chi-squared cost from which an excess over noise is no chance.

    Why: three standard deviations; integration errors alone stay below.
    """

    tempering_block: int = 32
    """Samples of the block means that show whether a residual changes slowly.

    Why: at 1 kHz this is 30 ms, shorter than the periods of the rigs and long enough to average white noise by a factor
    of 5.7. Chosen on the benchmark.
    """

    slow_excess: float = 1.3
    """Variance of block means, over that of white noise, from which a residual is tempered for being slow.

    Why: with 300 blocks the ratio of white noise has a standard deviation of 0.08; 1.3 is more than three of them.
    """

    # Evidence for one cause

    effect_evidence: float = 20.0
    """Reduction of the score from which an effect is there at all.

    Why: twice the 10 that Kass and Raftery call very strong evidence, as about a hundred candidates are tried
    (2 log 100 = 9.2). Half of it, beyond the complexity penalty, is asked of a screening score.
    """

    parameter_evidence: float = 9.0
    """Reduction of the score from which a parameter is wrong.

    Why: a likelihood ratio of (3 sigma)^2 for one degree of freedom (Wilks).
    """

    parameter_preference: float = 0.5
    """Part of log(m) by which a parameter is preferred to an effect that does as well.

    Why: half of Schwarz's penalty for one parameter: parsimony decides among equals. Chosen on the benchmark.
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

    most_exchanges: int = 3
    """Effects that are tried in the place of each one found earlier.

    Why: limits computing time; the right one was among the first three on the benchmark.
    """

    gain_fraction: float = 0.2
    """Part of the excess cost that a further effect must take.

    Why: what only resembles the missing effect takes small parts, one after the other. Chosen on the benchmark.
    """

    late_gain_fraction: float = 0.7
    """The same once the remainder is small enough to leave unexplained.

    Why: then only an effect that explains most of the remainder is worth a name. Chosen on the benchmark.
    """

    unexplained_fraction: float = 0.3
    """Part of the excess cost that named effects may leave.

    Why: chosen on the benchmark: laws near the missing one leave more, the right one with a small second cause less.
    """

    small_unexplained_fraction: float = 0.7
    """The same if the residual is small (`small_residual`).

    Why: a small residual is explained to a large part by a weak effect beside errors of the model that are as large.
    Chosen on the benchmark.
    """

    trace_fraction: float = 0.05
    """Part of the excess cost of the model as declared that counts as small, however far above noise.

    Why: 5 % of the cost is 22 % of the rms: where noise is low, a law near the missing one leaves about that much.
    """

    far_cost: float = 100.0
    """Cost per reading above which `trace_fraction` applies after a further effect.

    Why: ten times the noise in rms. Below, one more effect may still reach the noise floor. Chosen on the benchmark.
    """

    nested_fraction: float = 0.8
    """Part of the best reduction that a nested model must reach to be preferred while more is left.

    Why: parsimony; the remainder may have another cause, which the richer law would imitate. Chosen on the benchmark.
    """

    # Which candidates are fitted

    fewest_fits: int = 3
    """Candidates that are fitted in each round at least.

    Why: the first-order score of the right effect was among the first three on the benchmark.
    """

    most_fits: int = 8
    """Candidates that are fitted in each round at most.

    Why: limits computing time.
    """

    most_freed: int = 3
    """Parameters that are freed in the first round at most.

    Why: limits computing time; the score test orders parameters exactly to first order.
    """

    fit_ratio: float = 2.5
    """Excess that a candidate may leave in the screen over that of the best to be fitted.

    Why: a screen is of first order and sees shapes on a grid. Chosen on the benchmark.
    """

    screen_resolution: float = 0.05
    """Part of the noise cost below which excesses in a screen are equal.

    Why: as `noise_floor`: half of the excess that is at the noise floor.
    """

    screen_noise: float = 1.3
    """Cost of noise in a screen over that of white noise.

    Why: as `slow_excess`: a screen compares block means.
    """

    # Verdict

    named_probability: float = 0.9
    """Posterior probability from which the first explanation is named, not ambiguous.

    Why: one wrong in ten among those that are just named is accepted; stated in the documentation.
    """

    listed_probability: float = 1e-4
    """Posterior probability from which an alternative is listed.

    Why: less is never chosen; only the length of a list depends on it.
    """

    significant_deviations: float = 2.0
    """Standard deviations that a parameter of the last cause must be off, if the residual is above the noise floor.

    Why: two standard deviations, 95 %, of the tempered posterior.
    """

    unique_fraction: float = 0.03
    """Fraction of an effect's response outside the span of the parameters' responses, below which it is a parameter.

    Why: above the relative differences of responses that come from linearising at the fit, below those of laws that are
    different. Chosen on the benchmark.
    """

    likelihood_fraction: float = 0.5
    """Part of the reduction of the cost that must come from the residual, not from parameters closer to their priors.

    Why: below one half, re-fitted parameters explain the record as well: the effect stands for several parameters
    that are off together, and may make the validation residual somewhat larger.
    """

    linear_laws: int = 3
    """Linear effects that together are a composite explanation.

    Why: mass, damping and stiffness make any linear system of second order.
    """

    validation_tolerance: float = 1.05
    """Factor by which such an effect, or a parameter, may increase the cost of the validation record.

    Why: the error of what was fitted before shows there, too; 5 % of the cost is 2.5 % of the rms.
    """

    validation_margin: float = 60.0
    """Difference of scores up to which alternatives are fitted to both records together.

    Why: three times `effect_evidence`; larger differences were never reversed by a validation record of equal length.
    """

    rounding_fraction: float = 0.3
    """Part of the noise variance that rounding must make to be named, and of the residual to be the verdict.

    Why: below, a coarser converter would not be noticed. Chosen on the benchmark.
    """

    # When a record is searched again

    phase_loss: float = 0.5
    """Relative residual of a sensor from which the simulated motion has lost phase with the record.

    Why: between 0, a perfect simulation, and sqrt(2), one of the right size and random phase.
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

    sign_deviations: float = 3.0
    """Prior standard deviations from 0 from which a parameter keeps its sign.

    Why: three standard deviations; masses and stiffnesses do not change sign.
    """

    # Shooting intervals

    settling_rates: float = 10.0
    """Real part of an eigenvalue times the length of the record below which a mode does not settle in it.

    Why: exp(-10) = 5e-5: the initial state is forgotten to below the noise.
    """

    intervals: int = 20
    """Shooting intervals of a record of a model that does not settle.

    Why: chosen on the benchmark: drift stays small, and initial states take few readings.
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

    tone_band: tuple[float, float] = (0.05, 0.4)
    """Lowest of these frequencies in Hz, and the highest as a part of the sampling rate.

    Why: one period in a record of 20 s; below half the sampling rate by the roll-off of the smoother.
    """

    tone_width: int = 12
    """Lines on either side of a frequency that are taken as the same, in a spectrum of four times the record's length.

    Why: three lines of the record, just beyond the main lobe of the window (von Hann: two lines).
    """

    # Noise of a record

    rounded_values: float = 0.1
    """Different values per reading below which readings may be rounded.

    Why: readings with noise finer than their resolution are nearly all different.
    """

    # Experiment that separates

    separation: float = 40.0
    """Difference of costs from which an experiment separates two explanations.

    Why: twice `effect_evidence`: the simulated difference is that of the best case, without errors of the model.
    """


RULES = DecisionRules()  # the values of every discovery that is not given others
