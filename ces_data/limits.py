"""The numbers that decide about recordings, by what they decide, each with its unit and where it comes from.

Where nothing else is said, a number was set on the 22 measured recordings of `bench.sense_faults`, so that it reports
no fault in one as it was recorded; its rows in docs/checks.md show what it then finds. Settings of a numerical method
(ticks, knots, ridges) decide nothing and stand where the method is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from ces_observer.limits import ClockLimits


class RecordingLimits:
    """Whether a recording can be used at all (docs/checks.md: an error)."""

    POSSIBLE: ClassVar[Mapping[str, float]] = {
        "position": 1e4,
        "current": 1e6,
        "force": 1e9,
        "sim_force": 1e9,
    }  # [m, A, N] beyond it, in no unit
    MAX_EQUAL_SHARE = 0.2  # of the samples, that have the stamp of the one before: stamps are rounded
    MAX_EQUAL_STAMPS = 100  # samples in a row with one stamp; a driver that stamps its batches makes fewer
    BAD_SHARE = 0.01  # of the samples, NaN, infinite or spikes, that may be left out
    RATE_RATIO = 100.0  # between two signals: a force at 10 Hz says nothing about a stroke at 1 kHz
    MISSING_SHARE = 0.01  # of the position's span, without current
    MISSING_S, USUAL_INTERVALS = 0.5, 20.0  # [s] without samples, and in median intervals: a signal is absent
    CLOCK_OFFSET_S, OTHER_CLOCK_S = ClockLimits.OFFSET_S, 1.0  # [s] between header and log times; of two clocks
    LATE_S, STAYS_SHARE = ClockLimits.LATE_S, 0.1  # [s] to be said; of the messages, before and after a step
    INTERLEAVED = 0.5  # of the distance to the last value, that of the last but one; noise has 1, a motion 2
    BOOT_S = 1e9  # [s] header stamps below it, of 2001, count from the start of a computer or simulation
    CONTRADICTED_SHARE = 0.01  # of the messages, in which an index belongs to another joint than in the first
    RARE_SHARE = 0.01  # of the intervals, up to which long ones are pauses; more are those between batches
    EDGE_S = 1.0  # [s] at both ends, where topics start and stop
    GAP_INTERVALS = 5.0  # median intervals: a longer one is a gap
    MAX_INTERVAL = 1.75  # of the usual one: between 1, and the 2 of a lost sample


class StatisticLimits:
    """When figures of samples say something."""

    ENOUGH, MANY = 50, 64  # samples or bins, for a percentile or a correlation; for a spectrum or an interpolation
    DAMPING = 0.3  # correlation of a force with the speed, in size, from which it counts
    EXPLAINED = 0.2  # relative error of a map or model up to which it explains a damper's force


class OrderLimits:
    """Which samples of a bag are late, and which show that a clock was set back."""

    MAX_LATE_NS = 100_000_000  # [ns] measured: 1 to 9 ms, 2 to 8 threads on two busy cores; a thread may miss slices
    MIN_RUN = 4  # late samples in a row, and late by as many intervals: fewer may be chance
    MAX_DENSITY = 1.5  # of the samples where late ones belong, in that around them; a clock that jumps back makes it 2
    AROUND_NS = 500_000_000  # [ns] around them


class LossLimits:
    """Which samples no sensor can have measured: spikes, bursts, and values that are repeated after a jump."""

    JUMP_SPANS: ClassVar[Mapping[str, float]] = {
        "position": 0.15,
        "current": 1.0,
        "force": 0.3,
    }  # of a signal's span: what no sensor jumps by and back
    MIN_SPANS: ClassVar[Mapping[str, float]] = {
        "position": 0.0,
        "current": 0.2,
        "force": 0.0,
    }  # [m, A, N] of a span: a current may be constant
    DROPOUT_SPANS: ClassVar[Mapping[str, float]] = {
        "position": 0.02,
        "current": 0.2,
        "force": 0.1,
    }  # a jump before or after a repeated value
    SPIKE_S, MAX_SPIKE = 0.005, 3  # [s] length of a spike, and in samples (docs/checks.md)
    SPIKE_RATIO = 6.0  # distance from the median around it over the 95th percentile of all
    BURST = 1.5  # a burst's jumps over a spike's
    STEP_RATIO = 8.0  # a jump over the 95th percentile of all steps
    BURST_S, MIN_DROPOUT = 0.01, 4  # [s] from a jump to its return (docs/checks.md); samples of one value beside a jump
    MIN_MOVE = 0.005  # of the other signal meanwhile, of its span
    MAX_REPEATS = 0.1  # of a current's samples, that repeat the one before: more are those of a command
    OUTLIER = 5.0  # times the robust standard deviation of a position's distance from its neighbours' parabola


class DamperLimits:
    """What no damper does, from that of a bicycle to those of trucks and buildings: signals in another unit."""

    MIN_RATE_HZ, MAX_RATE_HZ = 20.0, 20e3  # [Hz] of positions that show a damper's motion
    SLOWEST_HZ, SLOW_HZ = 5.0, 100.0  # [Hz] no dynamometer logs more slowly; creeping is suspicious up to this rate
    CREEPING_M_S = 1e-3  # [m/s] slower than any test of damping
    MAX_STROKE_M, LONG_STROKE_M = 1.0, 0.5  # [m] of a damper on a rig or a vehicle; beyond those of vehicles
    MAX_SPEED_M_S, FAST_M_S = 5.0, 2.5  # [m/s] at the 99th percentile; that of a long stroke
    MAX_RMS_M_S, USUAL_RMS_M_S = 2.0, 1.3  # [m/s] the oil would boil; of a sine of 1.8 m/s, which few rigs reach
    MAX_M_S2 = 1000.0  # [m/s2] wheels on a kerb stay below 500
    MIN_STROKE_M, SHORT_STROKE_M, STROKE_FORCE_N = 1e-4, 1e-3, 100.0  # [m, m, N] strokes too short for such a force
    STIFF_N_S_M, STILL_M_S = 1e5, 2e-3  # [N s/m, m/s] of short strokes in a wrong unit
    STIFFEST_N_S_M = 1e6  # [N s/m] of any stroke; seven rigs have 450 to 3e5, those of a band brake
    MAX_CURRENT_A, VALVE_A, WEAK_A = 100.0, 6.0, 0.05  # [A] beyond any valve; beyond those of vehicles; opens none
    FRICTION_N, DAMPING_N_S_M = 8.0, 40.0  # [N, N s/m] the seal's friction is more; half of the softest bicycle damper
    SMALL_FORCE_N, SMALL_DAMPING_N_S_M = 30.0, 200.0  # [N, N s/m] a small damper, or kN
    TINY_FORCE_N = 20.0  # [N] whatever the damping
    MIN_SPEED_M_S = 0.02  # [m/s] below it hardly any force is to be expected
    MAX_FORCE_N, LARGE_FORCE_N = 1e6, 1e5  # [N] beyond those of buildings; beyond those of vehicles
    DAMPING_RANGE, FORCE_RANGE_N = (20.0, 3e6), (50.0, 3e5)  # [N s/m, N] of dampers, small speeds included


class RatioLimits:
    """When forces of two recordings, or of a recording and a model, are in different units or have opposite signs."""

    NEAR = 1.35  # between a slope and the ratio of two units: the nearest two, kgf and lbf, are 2.2 apart
    MIN_CORRELATION, MIN_CELLS, MIN_CELL_TICKS = 0.85, 12, 15  # of both forces, in so many cells of speed and current
    SPREAD = 100.0  # ratio of spreads beyond that of any two experiments with one damper
    MAX_SPEED_RATIO = 10.0  # of two recordings whose forces are compared
    HALVED = 0.5  # of a model's error that both signs reversed must at least take away


class SignLimits:
    """When the force drives the piston instead of braking it."""

    MIN_WORK, MIN_BLOCKS = 0.3, 0.8  # share of the power that is negative on balance, and of blocks of a second


class DelayLimits:
    """How late a signal may be, and from when a delay is reported (docs/checks.md)."""

    MAX_S, FAR_S = 0.07, 0.5  # [s] that is searched; if none of these fits, as of loggers that started apart
    MIN_TICKS = 2000  # 4 s
    FACTOR, FLOOR = 1.35, 0.02  # error that still counts as a fit: a multiple of the least, and never below the floor
    CURRENT_FACTOR, CURRENT_FLOOR = 1.12, 0.025  # the same for shifts of the current, which change the force less
    LIKELY_S, LIKELY_FACTOR, LIKELY_FLOOR = 0.015, 1.15, 0.01  # [s] of a delay that is probable only; its fit
    LIKELY_WIDTH_S = 0.05  # [s] of its interval: a single fast sine fits at any phase
    MAX_ERROR = 0.6  # of the best fit; beyond it the force is not that of these signals
    MAX_WITHOUT_CURRENT = 0.7  # a current that the motion explains better than this follows the motion
    MIN_S, WRONG_S = 0.002, 0.005  # [s] that the interval must exclude to be reported; to be refused
    MAX_MASS_KG = 300.0  # [kg] between piston and load cell; the carriage of a servo axis has 100
    SAME_CURRENT = 0.02  # relative spread below which a current is constant: noise of amplifiers


class DriftLimits:
    """When two clocks drift apart."""

    LONG_S = 60.0  # [s] clocks that differ by 100 ppm drift by 6 ms in it
    MIN_CHANGE_S = 0.01  # [s] over the recording (docs/checks.md)
    CLEARLY = 0.5  # of the intervals' widths, between the first and the last third
    STEADY = 0.35  # of the change, by which the middle may miss the mean of both ends
    MAX_RATE = 5e-3  # [s/s] of clocks
    MIN_MOTION = 0.1  # speed over the largest; RMS of the least over the most moving third: before a sweep it is 0.01
    MIN_MOVING = 0.45  # of the time; sines between rests have 0.49, the begin of a sweep at 0.41 seemed to drift
    FACTOR, MAX_ERROR = 1.25, 0.3  # of the error that still counts as a fit; of the best fit


class SensorLimits:
    """When a sensor is stuck, held, too coarse or clipped."""

    MIN_SAMPLES = 1000  # 1 s at 1 kHz: fewer show no habit of a sensor
    WRONG_SHARE = 0.02  # of the time stuck, or of the samples at a limit: a model would learn the fault
    MIN_LEVELS: ClassVar[Mapping[str, int]] = {
        "position": 100,
        "force": 50,
    }  # values in the range, below which a quantum is coarse
    COARSE_REPEATS = 0.5  # of samples that repeat the one before; noise larger than the quantum leaves fewer
    SAMPLES_A_LEVEL = 10  # from which on the values are those of a converter
    MAX_SPEED_NOISE = 0.05  # share of a model's speed that a quantum may disturb
    NOISY_REPEATS = 0.3  # of samples: a channel with fewer repeats is noisy, so that a long run of them is a fault
    STUCK_S = 0.1  # [s] of one value
    STUCK_CURRENT_S = 0.5  # [s] the same for a current, which is commanded in steps
    MAX_STUCK_CURRENT = 0.9  # of the samples: steps of a commanded current are longer together
    UNUSUAL = 3.0  # length of a run of equal forces over that of the longest usual one
    FINE_S, FINE_SAMPLES, FINE_REPEATS = 0.01, 15, 0.1  # [s] of a force of which at most one sample in ten repeats
    STUCK_CHANGE: ClassVar[Mapping[str, float]] = {
        "position": 0.3,
        "force": 0.1,
    }  # change of the other signal meanwhile, of its range
    MAX_VISIT = 0.5  # of the samples at a limit: a single longer visit is a sensor that is stuck there
    JUMP = 5.0  # a signal's return from a stuck value, in its largest steps elsewhere
    HELD_SAMPLES, HELD_STEPS = 3, 4.0  # repeats of each value; steps between values, in quanta
    MIN_AT_LIMIT, MIN_SHARE = 10, 2e-4  # samples at a limit, and share of all
    MIN_PEAK_RATIO, NEIGHBOURS = 5.0, 5  # samples at the limit over those at each of so many neighbouring values
    ARRIVAL_S, ARRIVAL_SPEED = 0.01, 0.2  # [s] before a position's limit: its speed, of its RMS; pistons brake
    MIN_STAY = 3  # samples at a limit of the position, on average: a noise-free sine touches its largest value only


class CurrentLimits:
    """When a force moves although the recorded current stands still."""

    MIN_STRETCH_S, SETTLING_S = 1.0, 0.2  # [s] of one current; at its begin, while the valve still answers
    MIN_REST, MIN_MOTION = 0.2, 0.3  # share of the time outside, to compare with; of the speed inside
    RATIO, MIN_ERROR = 2.0, 0.15  # of the errors inside and outside; the least that counts


class RateLimits:
    """When a force is sampled too slowly."""

    MAX_CHECKED_HZ = 400.0  # [Hz] above it, what is lost is the noise of the load cell (docs/checks.md)
    MISS, WRONG_MISS = 0.2, 0.6  # of the force's RMS; free runs erred by 0.35 to 0.5 of it
    MIN_VALVE_HZ = 100.0  # [Hz] two samples in the 5 ms of the fastest valves; the slowest answer within 30 ms


class JumpLimits:
    """When jumps are those of a counter that overflows."""

    PISTON_M_S = 10.0  # [m/s] of a position's jump: no piston's (docs/checks.md)
    MIN_DISTINCT = 0.8  # of the stamps: samples with rounded times jump
    MIN_OVERFLOWS, MIN_UNWRAPPED = 6, 0.9  # jumps by the whole range; span without the jumps, in jumps
    BETTER = 0.7  # of the error of the force's map, without the jumps
    OFTEN, UNLIKE_FORCE = 0.003, 0.5  # of the steps; error of a force that jumps too often to undo it
    AGAINST = 0.8  # of the jumps, go against the steps beside them (planted: 0.92; UTFSM at 35 to 100 Hz: up to 0.71)
    EDGE = 3  # samples beside a dropout that belong to it


class DerivativeLimits:
    """When a measured speed or acceleration contradicts the position."""

    SCALE_RANGE = (0.7, 1.4)  # of the signal over the derivative of the position; the rest is a wrong unit
    MAX_MEAN = 0.3  # of the signal over its standard deviation; more is gravity or an offset
    MIN_CORRELATION = 0.5  # with the derivative, in the band of the stroke
    LATE_S = 0.002  # [s] the band brake's speeds are 0.0 to 0.4 ms off, the shaking table's 5 ms


class ContentLimits:
    """When two recordings hold the same seconds."""

    MIN_DISTINCT = 8  # values in a run of 32 samples: a run at rest occurs twice
    EQUAL = 1e-6  # of a signal's range: re-encoding may round
    SAME_SHARE = 0.9  # of the samples in the common time that must be equal


class TableLimits:
    """Which column of a log is its time, and how its numbers are written."""

    MIN_RATE_HZ = 1e-6  # [Hz] that a user may give
    MIN_SAMPLES = 3  # of a signal
    MIN_STEP_S, MAX_STEP_S = 1e-6, 0.1  # [s] of a time without a unit: others are days, ms or numbers of rows
    EVEN_SHARE = 0.99  # of the steps of a column that may be a time without a name: pauses are rare
    RATE_TOLERANCE = 0.1  # between a stated rate and that of the times: Dyke's rounded times are 0.2 % off
    MAX_ROWS_PER_TIME = 1.5  # more are too coarse to tell one row from the next
    MIN_APART, MAX_APART = 0.05, 100.0  # steps between two times in a row: those of two signals, or two clocks
    MAX_ZERO_SHARE = 0.2  # of a file's bytes, that serial lines add to a text; more are binary numbers
    BLOCK_GAP_S = 1.0  # [s] at least between blocks of a table; ten intervals of the slowest rate are a gap
    MIN_MIXED = 3  # cells with either mark, for a doubt which one is that of decimals
    SIMILAR_NAME = 0.7  # by difflib: 'postion' and 'position' are 0.93, 'seed' and 'speed' 0.89


class RatingLimits:
    """How well a topic or column fits a signal, in points; set on the 40 tables of test_foreign_tables and the rigs."""

    CERTAIN = 3.0  # for the unit, a word such as `force`, or a force that clearly goes with the speed: alone enough
    LIKELY, WEAK = 2.0, 1.5  # for a force that goes with the speed; for a word such as `f`
    SLIGHT = 1.0  # for what suits; a choice is ahead of the next one by it
    CONTRARY = 5.0  # against words such as `model` and `battery`, and a force that is the speed
    CLEAR_CORRELATION = 0.6  # of a force with the speed, in size
    SAME_MOTION = 0.95  # of two positions, as a command and what follows it
    EXACT, LATE_SPEED = 0.98, 0.5  # of a derivative by its numbers; by its name: that of Dyke, 5 ms late, has 0.70
    UNIT_TOLERANCE = 0.1  # of a gain from the ratio of two units
    ASYMMETRY = 1.3  # larger to smaller peak of a force; rebound is damped more than compression
    NEGATIVE_SHARE = 0.05  # of the peak, that an amplifier's offset may take a current below zero
    STEADY_SHARE = 0.5  # of the steps between samples that are zero: a current that is held, not a motion
    ROUGH = 1.0  # RMS step over standard deviation: no stroke; white noise has 1.41
    RANGES: ClassVar[
        Mapping[str, tuple[float, float]]
    ] = {  # of the span (position) or the peak, in SI units, in which a damper on a rig or vehicle works
        "position": (DamperLimits.SHORT_STROKE_M, DamperLimits.LONG_STROKE_M),
        "force": (DamperLimits.TINY_FORCE_N, 60_000.0),
        "current": (DamperLimits.WEAK_A, DamperLimits.VALVE_A),
        "speed": (0.002, 10.0),
        "acceleration": (0.05, 3000.0),
        "temperature": (-60.0, 250.0),
    }
