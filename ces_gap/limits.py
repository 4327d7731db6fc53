"""The numbers that decide, by what they decide, each with its unit and where it comes from.

A number without a source is a judgement: no recording has shown a better one. "Same" is the range in which none of 20
blind diagnoses (`ces blind make --seed 77120 --cases 20`: run_0, run_2, predictions_0) gets another verdict. Energies
are shares of the gap's. Settings of a numerical method stand where the method is, plausible ranges with each effect.
"""

from __future__ import annotations


class DiagnosisLimits:
    """Whether recordings hold what a diagnosis needs."""

    MIN_POSITIONS = 100  # samples of the position
    MIN_USABLE_S = 1.0  # [s] with position, current and both forces, of each recording
    MIN_FIT_S = 4.0  # [s] of them for the fit, of all recordings
    CURRENT_AGE_S = 0.5  # [s] an older current counts as unknown
    MAX_SATURATED = 0.25  # share of the samples of the force at a limit of its sensor
    MAX_UNUSED = 0.2  # share of the ticks from which there is a note
    MIN_SPEED_M_S = 0.01  # [m/s] a recording of slower motion contains hardly any information
    MIN_CURRENT_A = 1e-3  # [A] a smaller current counts as zero
    CONSTANT = 0.02  # relative spread below which a quantity counts as constant: noise of rigs' current controllers


class AgreementLimits:
    """Whether simulation and measurement are of the same damper, in the same unit and range."""

    MIN_CORRELATION = 0.5  # of the forces, from which sign and scale count
    SURE = 0.9  # correlation from which a factor that is physically plausible counts as a unit
    NEAR = 0.06  # relative tolerance of such a factor
    ROUGH = 3.0  # factor by which powers of a thousand may be off
    IMPOSSIBLE = 30.0  # a larger factor is no gap
    RANGE_SLACK = 0.02  # of a model's range: the speeds of model and trace differ
    NOTED_OUTSIDE = 0.05  # share of the time outside a model's range from which there is a note


class NoiseLimits:
    """What shows the noise of a measured force."""

    NUMERICAL_ERROR = 1e-3  # of the RMS force: simulations are not computed more accurately
    MIN_N = 1e-3  # [N]
    MAX_COLOUR = 0.1  # autocorrelation from tick to tick, above that of white noise, of noise that counts as white
    MAX_FALL = ((1, 1.4), (2, 1.2))  # order of differences, its power over that of the highest order: flat spectra
    MIN_OVER_QUANTUM = 1.5  # power over that of the quantisation, if the noise is not filtered
    MAX_MISMATCH = 0.02  # RMS difference of a cycle from its neighbours, over the spread of position or current
    MIN_PERIOD_S = 0.05  # [s] 20 Hz: the fastest strokes of the measured rigs
    MIN_MOTION = 0.5  # spread of the position in a cycle, over that in the recording
    MIN_WINDOWS = 3  # without motion
    MAX_MOVE, MAX_MOVE_M = 1e-3, 10e-6  # spread of the position in these: over that of the recording, or [m]


class ProbeLimits:
    """What a simulation does to its inputs, and whether that is undone."""

    MIN_SPEED_M_S = 1e-3  # [m/s] slower recordings do not move
    MAX_STEP_S = 0.0125  # [s] of the samples: fewer show no step of the current
    MIN_ANSWER = 0.01  # of the force's RMS: smaller changes by a step of current show nothing
    MIN_SHIFT_SAMPLES, MIN_DELAY_S = 0.3, 0.2e-3  # a smaller lead or delay is not found; it is 0.5 by interpolation
    MIN_DAMPING_RATIO, MAX_DAMPING_RATIO = 1.15, 4.0  # of two operating points that tell a filter from a soft damper
    ACTIVE_RAD = 1.65  # lag of force behind speed beyond which no damper is passive: a quarter turn and a margin
    MIN_ROUGHNESS = 2e-3  # of the force's RMS
    WHITE = 0.5  # correlation of successive values below which a difference counts as noise
    MAX_OPEN = (
        1.5  # highest over certain delay: beyond, the damper's own elasticity is a part of the lag, and may be all
    )


class TwinLimits:
    """When a twin replaces a simulation, and how far it is believed."""

    SLOW_S = 0.025  # [s] of processor time: a simulation that is slower over all real recordings is replaced
    SLOW_CLOCK_S = 0.25  # [s] of the clock: the same for one that waits, for a file or for another process
    RUNS = 5  # of which one within the limits shows that it is not slow: four busy programs hold up some, not all
    MAX_COST_J = 20.0  # [%] up to it, effects inside the twin are told apart
    MAX_OWN_COST_J = 3.0  # [%] of a model as its own twin: the observer's speed and ticks differ from the twin's
    MIN_RINGING = 0.2  # of the error's energy: a column of oil is tried (0.45 of a function with one, 0.01 without)
    CHANGE_ERROR = 3.0  # of a change of force by other motion over that of the force: assumed
    CURRENT_ERROR = 15.0  # the same by another current: 12 to 38 measured where recordings hold few currents


class EvidenceLimits:
    """What is significant, and what would be visible."""

    BLOCK_S = 0.5  # [s] residuals within a block count as one sample: longer than the memory of a damper
    SURE = 3.0  # standard errors by which an influence is more than noise
    MIN_GAIN_Z = 2.0  # standard errors by which one explanation is better than another
    CLEAR_OF_NOISE = 0.1  # of the noise's energy: a gain in few blocks, as at a bump stop, that noise cannot explain
    CLEAR_Z = 20.0  # z of a gain as large as the noise, in however few blocks
    VISIBLE = 2.0  # deviations of the noise: a gap up to this is none (without this gate clean simulations are blamed)
    MIN_GAP_ENERGY = 0.02  # of the noise's energy: a smaller gap counts as this large
    UNSEEN = 1.5  # times a known error: what models and corrections leave on experiments of another kind
    MIN_SHOWN = 0.05  # of the gap's energy: a resample with less of it shows no shrink


class SearchLimits:
    """What an effect must explain, and which explanations are alike (docs/diagnose.md)."""

    MIN_GAIN = 0.05  # energy that another effect must explain
    MIN_GAIN_UNCORRECTED = 0.12  # the same without references: a smaller part may be the simulation's own error
    NEGLIGIBLE = 0.01  # energy: smaller unexplained shares are not distinguished
    PARAMETER = 0.005  # energy that each parameter costs when explanations are ranked
    MIN_FORM_GAIN = 0.02  # energy that a form with more parameters, or a correction of the inputs, must gain
    MAP = 0.15  # energy by which a map of the simulation's error must explain more than an effect
    MIN_ABSORBED = 0.8  # of a signature's energy inside the map that makes the effect not separable
    MAX_EFFECTS = 3  # together
    MAX_STATIC = 0.03  # of the force's deviation: hydraulic dampers differ from a map by 0.15 to 0.6, tables by 0.02
    MIN_PART = 0.015  # energy that a part of a network must explain beside the others, on blocks left out
    NEAR_BOUND = 1e-3  # of the range: a parameter closer to its bound counts as on it
    DRIFT = 4.0  # standard errors: units that disagree by more make a parameter drift
    MISFIT_ALIGNED = 0.25  # of the RMS left: assumed along each parameter's signature (Brynjarsdottir, O'Hagan 2014)


class ParameterLimits:
    """Which parameters of a simulation are fitted, which are determined, and which values are a doubt."""

    RANGE_FACTOR = 10.0  # one without a range is searched from a tenth of its default to ten times it
    MAX_TRIALS = 20  # combinations of whole numbers, each a fit of its own
    MAX_FREED = 4  # together, unless all are
    SLOW_S = 0.5  # [s] of a run over all recordings: with a slower one, effects that run it again are not tried
    MAX_UNASKED_S = 1200.0  # [s] for which a diagnosis fits parameters that the user has not named
    MIN_TOLD_S = 30.0  # [s] of work that is told before it begins
    MAX_SHARED = 0.2  # of a parameter's signature that another one makes up, from which the two move together
    MAX_CORRELATION = 0.95  # of two estimates that do not move together
    SAME_ENERGY = (
        10.0  # whitened, of noise alone: an effect that leaves as little as parameters to this is what they are
    )
    DOUBTFUL = 3.0  # times its default or a third of it: beyond, a value is a doubt


class RareLimits:
    """When a short deviation stands out, which an RMS hides."""

    WINDOWS_S = (0.01, 0.03, 0.1, 0.3)  # [s] from a stop that is hit to a valve that sticks
    MIN_BLOCKS = 16  # of which the quartile and the median show how largest windows scatter
    FALSE_ALARMS = 0.005  # share of clean diagnoses in which the largest deviation may pass: 1 of 50 with a margin
    HIDDEN = 3.0  # times the gap's RMS: what is as large lasts at most 1/9 of the time, and the RMS hides it


class VerdictLimits:
    """What is material, and what is named: energies of the gap on held-out recordings, and probabilities."""

    TOLERANCE = 0.01  # of the RMS force: a smaller gap is none, unless the user asks for another tolerance
    HALF = 0.5  # what an explanation closes at least, also of what anything closes; right names 0.89; same 0.3 to 0.7
    TENTH = 0.1  # energy that is immaterial, probability that makes possible; same 0.03 to 0.2
    MAX_UNKNOWN = (
        0.2  # probability beside a name; right ones have 0.16 at most (seeds 20261201, 77120); same 0.12 to 0.4
    )
    MAX_MAP_REST = 0.2  # energy that a map leaves, which absorbs a part of anything; same 0.1 to 0.4
    CLEARLY_MORE = 1.15  # times the RMS that the best leaves, beyond which there is no tie; same 1.05 to 1.5
    CLEAR = 1.5  # times noise or tolerance, below which the simulation's own error may be a cause; same 1 to 3
    MAX_NONE = 1.0 / 3.0  # of a gap that is not within anything: it never leads, by definition


class RegionLimits:
    """Which regions there are, and which of them stand out."""

    SIGNIFICANT = 0.05  # p-value and false-discovery rate: the convention
    MIN_SHARE, MIN_TICKS = 0.003, 25  # of a region or a field of a map
    FEW_LEVELS = 12  # as many distinct values get a region each
    MIN_ENERGY_RATIO, MIN_ENERGY_SHARE = 1.2, 0.05  # of one of them: energy over its share of the time, and in total
    HYSTERESIS, MIN_HYSTERESIS_M_S = 0.05, 0.002  # speed that a reversal must exceed: of the speed's RMS, and [m/s]


class ExperimentLimits:
    """How far the next experiment may go beyond the recordings."""

    TRAVEL, SPEED, ACCELERATION = 1.05, 1.1, 1.5  # over the range of the recordings
    MIN_AMPLITUDE_M, MIN_SPEED_M_S, MIN_ACCELERATION_M_S2 = 1e-3, 0.01, 1.0
    SAME_CURRENT = 0.05  # relative spread below which the recordings have one current
    CURRENT_CHANGE = 0.25  # relative, up and down, that experiments then command
    MAX_HZ = 16.0  # [Hz] the reach of rigs
