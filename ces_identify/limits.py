"""The numbers that decide, by what they decide, each with its unit and where it comes from.

Sources are standards and papers, what the documents promise, what the sensors and computers of users can do, and
recordings of measured rigs (by their names in the gallery: Keio, Dyke, UTFSM, table, racing, brake). Settings of a
numerical method (steps, damping, sizes of blocks) decide nothing and stand where the method is.
"""

from __future__ import annotations


class TickLimits:
    """Whether there are enough ticks; the ticks of a long recording are thinned."""

    MAX_BEYOND = 0.5  # of the positions beyond the stroke that a model knows: a unit or an offset is wrong
    MIN_SCORED = 50  # ticks with a measured force, for a cost J: half a second of the table's 100 Hz
    MIN_ERRORS = 200  # ticks, for a fit, a band or tests of residuals: 20 lie beyond a band of 90 %
    ALL = 600_000  # ticks, of which a fit takes all: 10 min at 1 kHz (docs/files.md)
    MAX = 300_000  # ticks that a fit takes of more than these: one minute in three, four, ... (docs/files.md)
    STRETCH_S = 60.0  # [s] of a long recording that are kept in one piece (docs/files.md)
    MIN_CHANGE = 1e-3  # of an input's largest size: one that changes less is constant; 10 bits of a converter
    MIN_GAP_S, GAP_SAMPLES = 0.05, 10.0  # a gap is longer than 50 ms, and than ten samples (docs/speed.md)
    MIN_SAMPLES = 10  # of the position in time order: those of a gap
    MAX_LATE = 0.1  # share of positions after which the vehicle has no force (bags/road at 250 Hz: 0; 150 Hz: 0.25)
    MAX_LOST = 0.5  # share of a recording without a force (a model of UTFSM on a road: 98 %; one of its kind: 2 %)


class SamplingLimits:
    """How positions become ticks: rate, noise, modes and outliers (docs/speed.md)."""

    RATE_SLACK = 1.01  # of the rate of the stamps: a nominal rate is a little above it
    MIN_RATE_HZ = 1000.0  # [Hz] enough for damping forces,
    TICKS_A_PERIOD = 20.0  # or so many ticks in a period of the fastest mode
    MIN_SAMPLES = 64  # in a row, for a spectrum: of 32 frequencies, half of them of the noise
    NOISE_FROM_HZ = 100.0  # [Hz] the stroke has no content above this (road: less than 30 Hz, ISO 8608),
    NOISE_FROM_SHARE = 0.25  # or above this share of the sampling rate if that is lower
    MIN_SPEED_M_S = 1e-4  # [m/s] RMS speed of a damper at rest
    OUTLIER_FACTOR = 25.0  # times the RMS of the innovations: up to 24 are measured (brake; Dyke: 12, others: 10)
    OUTLIER_S = 2.5e-3  # [s] or the RMS speed in this time, or in two ticks, so that a restart in motion succeeds
    STROKE_MARGIN_M = 0.05  # [m] beyond the recorded stroke, or its length if that is more (docs/speed.md)
    WIDER_HZ = (6.0, 15.0, 37.5, 93.8, 234.4)  # [Hz] modes for strokes beyond vehicles': Dyke's
    MIN_LIKELIHOOD_GAIN = 0.1  # of the log likelihood a tick, for these: Dyke gains over 0.3, the other rigs nothing
    HIGHEST_SHARE = 0.125  # of the rate: the modes' frequencies; a resonance needs eight ticks a period
    DELAY_SLACK = 0.02  # ticks by which a delay may be off a whole number: 3 ms are 9.015 ticks at Dyke's 3,005 Hz


class WeightLimits:
    """Regions of ticks with a weight of their own (thesis, section 6.3)."""

    SLOW_M_S = 0.05  # [m/s] |speed| of a zero crossing, by default: a quarter of the road's RMS speed
    CENTRAL = 0.8  # share of the stroke between its ends, by default
    MAX_WEIGHT = 1e6  # one tick of 17 min at 1 kHz then counts as much as all others


class ErrorLimits:
    """How far sums of correlated errors may be off: what is slower than a recording shows (docs of `correlation`)."""

    LEVEL = 0.95  # of intervals and tests: the convention
    SLOWEST_S = 4.0  # [s] correlation time of the slowest changes that are possible: a stroke of 0.25 Hz (brake)
    MIN_SHARE = 1.0 / 15.0  # of a recording's duration, for that time: at most 9 cosines count
    ALARM = 0.9  # level of the F test for slower changes; with it 5.5 % of equal models differ (docs/compare.md),
    ALARM_SHARE = 0.3  # and the share of the recording that is their correlation time then
    MIN_BINS = 100  # of a recording: 1 s
    MAX_FACTOR = 3.0  # between J and an end of its interval: its ends are nine times apart then
    ROUNDING = 1e-4  # of the cost: smaller differences are rounding (a model and its own FMU), not better models


class CycleLimits:
    """Which cycles are equal, so that what differs between them is noise."""

    MIN_CYCLES = 5  # of which three have both neighbours
    MISMATCH = 0.01  # RMS difference of a cycle from its neighbours: of the stroke's spread, or of the RMS current


class EnvelopeLimits:
    """How far beyond its recordings a model is believed, and when a recording is outside."""

    INPUT_MARGIN = 0.1  # of an input's span, on both sides
    MAX_CURRENT_GAP = (
        0.6  # of the current's span, between two that were recorded (UTFSM, sweeps at 0 and 1 A: J 42 % at
    )
    # 0.5 A; sines at 0, 0.5 and 1 A, a gap of 0.5: J 8 to 20 % at 0.25 and 0.75 A, as with all five currents)
    FORCE_MARGIN = 0.5  # of the measured force's span, on both sides: twice the force, if it is as large both ways
    MIN_FORCE = 0.015  # of the force envelope: that of a driven damper varies by more (UTFSM: 0.018, at rest 0.012)
    HELD_FORCE = 1.5  # times the largest recorded: where a hydraulic network's force is held,
    HELD_PRESSURE = 2.0  # and times the largest that the recordings need: where its pressures are
    REACH = 2.0  # times the inputs' ranges: how far a hydraulic network extrapolates (docs/structures.md)
    MIN_SHARE = 0.005  # of the ticks: a model's own recordings are outside for hardly as long


class ResidualLimits:
    """Tests of a residual (Ljung 1999, sec. 16.6)."""

    LEVEL = 0.99  # Ljung's and MATLAB's usual level
    LAG_S = 0.1  # [s] longest lag: the slowest decay in a recurrent network, longer than valves and oil remember


class LackLimits:
    """On which quantities the error depends; less is left to the figures (docs/reports.md)."""

    MIN_SHARE = 0.2  # of the error's energy (docs/reports.md)
    MIN_GAIN = 1.5  # [%] by which J would be lower (docs/reports.md)
    MAX_DEPENDENCES = 2  # sentences that a reader takes in
    MAX_OUTSIDE = 0.5  # of a recording's ticks, outside the envelope: such a recording does not count
    AS_GOOD = 0.8  # of the best share: the recordings cannot tell the two quantities apart
    MIN_TICKS = 2_000  # so that each of the 14 blocks has more than 100
    MIN_CHANGE = 0.05  # of the force in a region, to be named


class BandLimits:
    """How wide the band around a force is, and where nothing is known (docs/band.md)."""

    LEVEL = 0.9  # of the measured forces that it holds
    MIN_HELD = 0.7  # of them, on a recording: nine dampers have 74 % and more (docs/band.md), a misfit (racing) 61 %
    MAX_DISTANCE = 4.0  # spreads: beyond it nothing is known about the error, and the band does not grow further
    CONSTANT_SHARE = 0.2  # of the squared error, which does not grow with the distance
    PHYSICAL_SHARE = 0.75  # the same for a structure with physics inside, whose error hardly grows
    MAX_PARTS = 6  # recordings left out in turn, or groups of them


class FoldLimits:
    """Parts of recordings that a model has not seen."""

    MIN_STRETCH_S = 2.0  # [s] of a stretch of a single recording as a fold: one without warm-up and a swing
    MAX_PARTS = 4  # recordings left out in turn by `cross_fit`, or groups of them: a refit each
    STRETCHES = 3  # of a recording, left out in turn (docs/band.md)


class StabilityLimits:
    """How near a model may come to one that does not forget."""

    MAX_GAIN = 0.98  # of the past forces: the force is at most 50 times what a tick adds, a useful bound
    PROBED_GAIN = 0.995  # the same of a polynomial at probed inputs; leaves a margin for the proof over all inputs


class ChoiceLimits:
    """Which structure, which terms and which parts are taken, and which structure is worth naming."""

    ALIKE = 1.6  # ratio to the best cost up to which a structure belongs to the mean (table: 6.0 %, 6.3 at 1.3)
    HOPELESS = 3.0  # and beyond which half of a fit is enough: the other half would have to lower the cost by 47 %
    SHORT_WORK = 0.12  # of the fit of a structure with physics beside a chosen one without
    SHORT_SHARE = 0.35  # of a time limit, for these fits
    CLEARLY_BETTER = 0.9  # share of the chosen structure's cost from which another one is named
    COST_TOLERANCE = 0.1  # of the lowest selection cost of a campaign: the excess allowed for a smaller model
    STROKE_GAIN = 0.92  # share of the selection cost from which the stroke counts among lagged inputs (racing: 0.7)
    MIN_TERM_GAIN, MAX_TERM_LOSS = 1e-3, 5e-4  # of the cost: gain of a new term; loss below which a term is pruned
    WEAKER_PULL = 0.995  # share of the selection cost to which a weaker pull leads, for a still weaker one to be tried
    BYPASS_SHARE = 0.05  # of the error's energy that follows the stroke: a bypass is tried
    RECURRENT_S = 11.0  # [s] for 1,086 parameters (racing, 6 s: 0.9 % on blocks left out, 11 % later; Dyke, 14 s: best)


class HeldCurrentLimits:
    """When the current counts as held while the damper moved: all of UTFSM's windows are steady, none of Dyke's."""

    WINDOW_S = 1.0  # [s] of a window,
    STEADY = 0.08  # in which the current changes by less than this share of its whole range,
    SHARE = 0.9  # and the least share of such windows


class ForgettingLimits:
    """Whether a model forgets where it was started."""

    LEFT = 0.01  # of the force's spread: less is forgotten (`--forget`: to 1 %)
    WINDOW_S = 0.1  # [s] of RMS differences: a check valve may close a tick later (UTFSM, sweep at 0 A: 3 % for a tick)


class ResultLimits:
    """Whether an identification has a result at all, and standard errors."""

    UNEXPLAINED_J = 60.0  # [%] beyond the noise: the model explains nothing (docs/checks.md)
    WITHOUT_SPEED_J = 30.0  # [%] the same for a polynomial without the speed (docs/checks.md)
    MIN_BLOCKS = 1.0  # of 0.25 s, for each parameter that the data determine: 15 s (docs/structures.md)
    AGREEMENT, AGREEMENT_J = 1.25, 0.5  # a model's J over the one shown for it, and [%] beside: a last fit changes less


class ComparisonLimits:
    """What counts when models are compared."""

    MAX_MODELS = 40  # 780 pairs, and tables that still can be read
    WARM_UP_S = 0.5  # [s] not scored after the start and after each gap, for models that ask for less
    MAX_RATIO = 1000.0  # of a simulated to the largest measured force: a simulation without an envelope diverged
    MIN_SECONDS = 2.0 * ErrorLimits.SLOWEST_S  # [s] of all recordings together, to tell that there is no difference


class MisfitLimits:
    """What a report says in words: whether a model fits, and what to record next."""

    MISFIT_J = 30.0  # [%] J from which a model does not fit, docs/reports.md
    FITS = ((5.0, "Closely"), (10.0, "Well"), (MISFIT_J, "Roughly"), (float("inf"), "No"))  # J below [%], the same
    ROAD_SPEED_M_S = 0.18  # [m/s] RMS piston speed of `ces rig road`: ISO 8608 class C, 60 km/h, a quarter vehicle
    MIN_CURRENT_SPAN_A = 0.05  # [A] less is one current
    MAX_OUTSIDE = 0.01  # share of the scored time
    MISFIT_SHARE = 0.7  # of the error on new data that the model's own data have, too: more data would not lower it
    LOOSE = 10.0  # times the forces of the recordings: a bound that says little


class MotionLimits:
    """Position and speed of a dyno's recording, without delay; docs/characterise.md promises them."""

    MIN_BANDWIDTH_HZ, MAX_BANDWIDTH_HZ = 30.0, 200.0  # [Hz] of the speed: above any stroke (ISO 8608: 30 Hz)
    MAX_BANDWIDTH_SHARE = 0.25  # of the sampling rate: half of what Nyquist allows, for the filter's slope
    NOISE_SHARE = 0.01  # of the RMS speed: less than cycles differ (work on UTFSM's sines: up to 3 %)
    MAX_CURRENT_AGE_S = 5.0  # [s] a commanded current may be logged only when it changes
    MIN_STRETCH_S = 0.25  # [s] without a gap: the settling of a filter of 30 Hz at both ends


class DynoLimits:
    """Which cycles count as those of a damper dyno, and which belong together; docs/characterise.md promises them.

    With them, the 15 sines of UTFSM (three strokes at five currents) are 15 conditions.
    """

    MIN_REPEATS = 3  # cycles alike in a row; cycles, steps or visits for a spread, which has two degrees of freedom
    MIN_SAMPLES = 20  # of a cycle
    MIN_BANDWIDTH_RATIO = 5.0  # bandwidth over the frequency of the cycle: the speed of a sine is 0.2 % low
    MIN_PEAK = 10.0  # times the noise of the speed: the peak speed of a cycle, which noise then changes by 1 %
    MIN_PROMINENCE = 0.01  # of the stroke's span: smaller turns are no reversals
    BEYOND_NOISE = 8.0  # times its RMS, which noise never reaches: a reversal, or another level of the current
    MAX_SHAPE_DIFFERENCE = 0.06  # RMS between neighbours, of half the stroke
    MAX_PERIOD_DIFFERENCE = 0.15  # between neighbours, of the period
    SETTLE_S = 0.1  # [s] before a cycle in which the current must be constant, too
    PEAK_SHARE = 0.97  # the peak is where the speed is at least this share of the largest
    SAME = 0.03  # relative difference of amplitudes, frequencies and currents (of the largest) that are the same
    SAME_CENTRE = 0.2  # difference of the centre of the stroke within a condition, of the amplitude


class StepLimits:
    """Which steps of the current show the response of the valve; docs/characterise.md promises them.

    Its windows are several times the response of a semi-active valve, some 10 ms.
    """

    PLATEAU_S = 0.05  # [s] of constant current before and after a step, and of constant speed after it
    MAX_STEP_S = 0.04  # [s] that the change of the logged current may take
    MIN_STEP = 3.0  # in tolerances of the current
    BEFORE_S = 0.03  # [s] of steady force before the step
    MAX_AFTER_S = 0.25  # [s] at a constant speed after it
    SPEED_SHARE = 0.10  # by which the speed may leave its mean before the step
    MIN_FORCE_CHANGE = 15.0  # times the noise of the force
    UNSETTLED = 0.05  # of the change of force: drift before the step, and at the end
    MIN_DIP = 0.05  # of the change of force by which it falls back: UNSETTLED; less is no dip
    VISIBLE = 3.0  # times the noise of the mean response: an overshoot, or the width of what is settled
    MAX_SETTLED_SHARE = 0.5  # of the window: of a lag, 0.2 % of the change is then missing at its end
    MAX_T63_SHARE = 0.3  # of the window: a slower response would not have settled


class BinLimits:
    """Force over speed of any motion (docs/characterise.md): bins that are shown, and levels of the current."""

    MAX_LEVELS = 12
    MIN_STEADY = 0.5  # share of samples at a steady current, for levels
    MIN_SAMPLES = 30  # of a bin: three beyond each of its 10 and 90 % quantiles
