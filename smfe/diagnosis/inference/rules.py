"""The numbers of a diagnosis that somebody chose, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InferenceRules:
    """Thresholds, budgets and tolerances of fits, search, verdict and next experiment."""

    # predictions and their slopes
    slope_step: float = 0.02
    """Half of the step of a central difference, in scales: small for what is curved over a scale."""
    largest_slope_step: float = 0.5  # the same where predictions are rough
    above_roughness: float = 20.0  # how far a step takes a rough prediction, over its roughness
    worth_help: float = 0.001  # mean time of a prediction [s] from which several processes make them
    worth_a_start: float = 1.0  # time that predictions have taken [s] before processes are started
    kept_values: int = 4_000_000  # predicted values that are kept
    kept_slopes: int = 16_000_000  # values of slopes in closed form that are kept
    most_workers: int = 8  # processes, unless more are asked for: a step of a fit asks for ten to forty predictions
    # fits
    tolerance: float = 0.1  # decrease of chi-square that a converged fit may leave; thresholds are 100 times that
    relative_tolerance: float = 1e-7  # the same over the misfit, for data that no hypothesis describes
    bad_tolerance: float = 1e-3  # the same over what a bad model leaves beyond twice the noise
    left_tolerance: float = 3e-4  # the same over what is left beyond the noise
    several: int = 8  # conditions from which a part of them is fitted first
    rough: float = 3.0  # decrease that may be promised where no part of the step brings any: a kink
    optimism: float = 3.0  # times a promised decrease that a fit may still come down
    hope: float = 10.0
    """The same that the first slopes of a fit promise: in the curved valleys of joints that slip six times was seen."""
    temperatures: tuple[float, ...] = (100.0, 10.0)  # by which priors outweigh data that are far off, one by one
    plausible: int = 3  # times that what is left counts as noise anew
    warm: float = 0.01  # share of the misfit to which it is found on the way there
    cycles: int = 8  # slopes that are taken anew before damped steps take over
    last_cycles: int = 3  # the same after it: it brings a fit near its end, plain steps then end it
    steps: int = 12  # steps with one set of slopes
    fractions: tuple[float, ...] = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
    damping: float = 1e-3  # of the first step along a valley, over the squares of the slopes
    more_damping: float = 4.0  # times which it is where a step brings nothing or is bent too much
    less_damping: float = 3.0  # by which it is divided where one serves
    dampings: int = 8  # that are tried of a step
    valley_steps: int = 12  # along a valley
    ahead: float = 0.1  # part of a step over which its bend is seen
    bent: float = 0.75  # acceleration of a step over half of it that is trusted
    many: int = 1000  # values from which columns of them are made independent by their products
    independent: float = 1e-4  # share of a column that those before it must leave for that
    equivalent: float = 2.0  # chi-square that equivalent parameters may fit worse
    # signatures
    silent: float = 1e-7  # norm of a slope, or its share of the largest of a cause, that counts as nothing
    confounded: float = 1e-4  # share of a norm that must survive the projection: less is the error of differences
    jointly_varied: int = 2  # shape parameters that are varied; of more, most are not seen by the sensors
    # thresholds
    false_alarm: float = 0.0004  # p-value of any cause of the catalogue, see `thresholds`
    draws: int = 20_000  # of noise
    penalty: float = 2.0  # charge for a parameter [chi-square]: causes of one and of three compete fairly
    tail: float = 0.01  # upper part of the draws to which an exponential is fitted
    most_one_sided: int = 5  # parameters on a bound that are treated as one-sided together
    slow_cosines: int = 4  # cosines of each half of a condition
    least_left: float = 0.05  # share of the noise that a fit must leave in a direction for it to be tested
    # data that rest on a simulation
    preparations: int = 2  # times that they are prepared anew with what fits them, before causes are looked for
    prepared_better: float = 0.02  # share of the misfit that it must take away
    # search
    most_causes: int = 8  # where the search ends
    most_pairs: int = 4  # pairs that are tried
    promising: float = 0.3  # share of the threshold, to first order, from which a cause is fitted
    least_tried: int = 3  # causes that are fitted in any case
    nonlinear: float = 0.1  # share of a gain by which a fit may differ from its linearisation
    outdone: float = 0.5
    """Share of what a cause that explains most has explained, below which another is not fitted, to first order."""
    worth_a_pair: float = 0.6  # share of the threshold, to first order, from which a pair is fitted
    shapes: int = 2  # shapes of a cause from which it is fitted
    crept: float = 1e-3  # share of what a fit has gained that it may promise still where it did not end
    pursued: int = 3  # times that the best fit is followed where it did not end
    close: float = 5.0  # chi-square below the threshold from which a cause is looked at
    far: float = 50.0  # chi-square behind the best from which a cause has lost
    part: float = 0.1  # of the way to what matters, from which a fit is followed
    astray: float = 3.0  # times the misfit of the baseline from which a start is no start
    lost: float = 10.0  # the same of a thorough search, once the cause's own parameters are fitted
    halfway: float = 0.5  # share of the misfit below which a start is followed with its own slopes
    enough: float = 0.75
    """Share of what is more than noise from which on a fit from a linearisation needs no starts from elsewhere."""
    named_starts: int = 2  # starts of a cause that are followed
    little: float = 0.005  # share of the misfit that counts as explained besides noise
    changing: float = 1e-4  # p-value of a parameter that changes: slow noise, known least, looks most like it
    most_words: int = 6  # words of a setting, such as names of controllers, that are distinguished
    # held-out conditions
    band: float = 0.01  # p-value below which a held-out misfit is more than noise
    retained: float = 0.05  # share of the information on any combination of parameters that a fold must leave
    covered: float = 0.5  # share of the effect of a cause in conditions that are held out once
    followed: float = 0.02  # share of held-out squares by which their prediction may miss what slopes expect
    roughly: float = 0.25  # the same of what is not noise: how bad a bad model is need not be known
    least_within: float = 3.0  # gain [dB] that is asked for where blocks of values are held out
    blocks: int = 12  # blocks of values of a condition; every fourth is held out together
    most_values: int = 8  # values of a setting that make folds
    resamples: int = 4000  # of the conditions (bootstrap)
    three_sigma: float = 0.00135  # one-sided probability of three standard deviations
    unknown: float = 1e-6  # relative singular value of a parameter that the data do not determine
    # verdict, intervals and detectable effects
    agreed: float = 0.99  # joint region within which sources agree: 95 % would lose one right cause in twenty
    trusted: float = 2.0  # standard deviations of what is given within which a baseline counts as given
    contenders: int = 3  # refused hypotheses between which an experiment decides
    interval: float = 1.959964  # standard deviations of a 95 % interval
    determined: float = 1e-9  # relative singular value below which the data do not determine a direction
    shared: float = 1e-3  # share of such a direction in a parameter from which it has no interval
    seen: float = 0.95  # probability with which a detectable effect is seen
    proven: float = 36.0  # likelihood ratio at which a gain that scatters by 2 sqrt(LR) is three deviations
    decisive: float = 100.0
    """Likelihood ratio by which what was declared of a machine of feed axes is wrong where no condition left out tells.
    Gains that were right reached 42 and 50 beside friction that nobody declared, gains 17 to 20 % off 200 to 310."""
    much: float = 1.5
    """Squares over noise that a fit leaves from which what no condition left out bears out is not put down to what the
    model misses: of healthy axes on guideways of elements that slip, seven that were looked at left 1.4 at most."""
    collinear: float = 0.95  # cosine of two signatures above which they count as one
    # what was declared, and what matters
    contradicted: float = 0.001  # p-value of a pull beyond what was declared: 3.3 standard deviations
    delivered: float = 0.1
    """Least share of a likelihood ratio promised to first order that a fit must give: where a model may miss something
    the ratio counts less noise than a fit does, a quarter at the least, and what is curved takes some more."""
    beyond: float = 3.3  # the same in standard deviations, of one parameter
    told: float = 5.0  # z against the data alone from which what was declared without uncertainty counts
    unstated: float = 2.0  # times what is material that such a difference must be worth
    least_filled: float = 0.25
    """Least share of the most that a model may miss (`Abilities.measured_noise`) that counts, in variance: what all
    conditions miss alike is fitted, and is not left."""
    informed: float = 1e-3  # share of a prior's variance that data must take away to say something of it
    released: float = 0.02  # prior over what it becomes where it is released: fifty times as wide
    stands_for: float = 0.5  # share of a difference below which another parameter has taken its place
    worth_a_search: float = 0.25  # share of what is material that must be left for another cause to be looked for
    worth_pairs: float = 1.0  # the same for pairs of causes
    odd_from: int = 4  # conditions from which the scale of one is held against that of the others
    odd: float = 6.0  # of their deviations (from the median one) beyond which it is another, and of this, at the least:
    odd_least: float = 0.01
    odd_matters: float = 2.0  # over what is material
    named_share: float = 0.9  # share of the repeatable error from which causes count as named beside a remainder
    drowned: float = 3.0  # size of noise alone over what is material beyond which a condition does not say what matters
    noise_draws: int = 200  # of noise, for what it does to a size
    noise_quantile: float = 0.99  # of them, which a size that counts exceeds
    # next experiment
    margin: float = 6.6348966010212145
    """Likelihood ratio by which the best must lead: 99 % of chi-square with one degree."""
    proposals_tried: int = 5  # proposals that are examined with the rivals fitted anew
    imitated: float = 0.1  # chi-square below which a rival contains the truth
    minutes: float = 5.0  # of a proposal that gives none
    blind: float = 100.0  # scales that a cause counts with that would never be seen
    worth_saying: float = 1.5  # ratio of a hidden size before and after from which a proposal is worth its time
    most_said: int = 6  # causes that a proposal lists


RULES = InferenceRules()
