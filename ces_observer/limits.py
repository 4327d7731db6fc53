"""The numbers that decide on the vehicle, by what they decide, each with its unit and where it comes from.

What a user can set is in the tables of parameters; what the tick decides by is in `ces_observer.tick` and
`ces_observer.health.arrivals`, which are printed to C.
"""

from __future__ import annotations


class FileLimits:
    """What a model file may hold: more than any fit makes, and little enough that each file is read and proved soon."""

    MAX_BYTES = 1_000_000
    MAX_ITEMS = 64  # of a list: regressors, constructed inputs, experts, units of a recurrent model, nodes of a curve
    MAX_RULES = 200  # the same of the larger lists: rules and memberships of a fuzzy model, units of a network
    MAX_PREMISES = 6  # of a rule: a grid over more has more cells than rules
    MAX_MEMBERS = 8  # recurrent models whose mean is taken
    MAX_CURVES = 16  # over the current
    MAX_FRICTION = 8  # friction elements of a hydraulic model
    MAX_TERMS, MAX_FACTORS, MAX_POWER = 500, 8, 8.0  # of a polynomial
    MAX_MODES, MAX_MODE_HZ = 12, 5e3  # [Hz] of the bank: half of the highest rate that is used
    MAX_GAP_TICKS = 20_000  # that one position sample may have to compute, after the longest bridged gap
    MAX_LAG = 1000  # ticks, of any signal: 1 s at 1 kHz
    MAX_DELAY_S = 0.02  # [s] of an estimate: a control loop has no use for a later one
    MAX_VALVE_S, MAX_LEAD_S, MAX_REACH = 1.0, 0.1, 10.0  # [s] of a valve's response; of a mount's; of a twin's stroke
    FILTER_S, MAX_FILTER_HZ = (1e-4, 1.0), 1e5  # [s] decay of a recurrent model's filter; [Hz]
    CONSTRUCTED_HZ = (1e-3, 1e5)  # [Hz] of a constructed input's filter


class NumberLimits:
    """How large a number may be: beyond any damper in any unit, and far from where sums, powers or slopes overflow."""

    MAX_INPUT = 1e6  # [m, m/s, A]
    MAX_NUMBER = 1e9  # [N], weights, means, values of curves
    MAX_SQUARED = 1e12  # of numbers that are squared
    MAX_COEFFICIENT = 1e30  # of a term; scale, offset or constant of a signal
    MAX_PRODUCT = 1e100  # of a term, and of its factors' product
    MIN_WIDTH = 1e-9  # [m, m/s, A] of what is divided by: half widths, spreads
    MIN_BELL = 1e-6  # [m, m/s, A] width of a membership: with its power, no distance in widths overflows
    MIN_FIRING = 1e-200  # of fuzzy rules, so that their shares do not underflow
    MIN_WEIGHT = 1e-6  # of a model in a mean
    MIN_OPENING = 1e-12  # of a bypass
    SLOPES = (1e-15, 1e12)  # far beyond those of any damper's curve, in any of its units


class ProofLimits:
    """When a start is forgotten, and how much work a proof may be."""

    FORGOTTEN = 0.01  # share of the width of the force envelope: what differs by less is forgotten (docs/proof.md)
    MAX_BOXES, MAX_WORK = 40_000, 4_000_000  # interval products: a few seconds at most, for any file


class SpeedLimits:
    """How far the speed is believed after samples that come late (docs/speed.md)."""

    OVERDUE = 1.5  # times 1/rate [s]: in a longer interval samples were lost, a shorter one may be jitter
    SETTLING = 6.0  # times the bank's response: the time in which it settles
    DOUBT = 3.0  # times that: until the model has settled, too, if the speed after lost samples is uncertain
    MAX_CHANGE = 5.0  # times the RMS speed: of the speed, while no sample comes


class ClockLimits:
    """When a clock was set instead of a message being late."""

    JUMP_NS = 1_000_000_000  # [ns] before the newest stamp: no network delays so long
    MAX_DELAY_NS = 10_000_000_000  # [ns] beyond the least delay of arrivals
    MIN_STEP_NS = 100_000_000  # [ns] far above what a slewed clock gains between two readings (500 ppm: 50 us in 0.1 s)
    AHEAD_S = 0.05  # [s] of stamps before the node's clock, that simulated time may give
    OFFSET_S, LATE_S = 0.02, 0.1  # [s] between stamps and arrival, which messages take less than; between two topics


class HealthLimits:
    """What /diagnostics warns of (docs/live.md)."""

    OUTSIDE = 0.01  # share of forces from inputs outside the envelope, or held at its own: as `EnvelopeLimits` allows
    DROPPED = 0.01  # share of missing positions
    STILL_S = 1.0  # [s] without any change of position: longer than a reversal
    MIN_SILENCE_S = 0.2  # [s] without a position: two periods of the slowest watch
    QUIET_S = 1.0  # [s] without a change, after which what has flickered is logged again


class RunningCostLimits:
    """When the running cost J shows that a model has drifted (docs/live.md)."""

    MIN_PAIRS = 100  # in the window, for a cost
    MIN_FORCE_N, MIN_FORCE_SHARE = 20.0, 0.01  # [N], of the force envelope: a smaller deviation is a damper at rest
    MIN_WARN_J, WARN_RATIO = 10.0, 2.0  # [%] a model "fits well" up to it (docs/reports.md); times its validation cost
    BAD_SECONDS = 3  # bad ones in the window that make a drift, good ones in a row that end it
    GOOD = 0.8  # share of the threshold below which a second is good
    LATE_S = 5  # [s] an older pair shows that time was set back


class NodeLimits:
    """When a node gives up, tries again, or refuses a request."""

    FALL_S = 5.0  # [s] of failures at each sample, after which the observer leaves the active state
    RETRY_S = 5.0  # [s] from a failure while active to the next start
    SNAPSHOT_PAUSE_S, MAX_SNAPSHOT_S = 60.0, 20.0  # [s] between two snapshots of drifts; for one
    MAX_CHECK_S, MAX_CPU_S = 600.0, 300  # [s] for the check of a model; of processor time
    MAX_MEMORY_BYTES = 1 << 30  # of address space for it: models are small
    MAX_NAMES, MAX_NAME_LENGTH, MAX_VALUE_LENGTH = 500, 1000, 10_000  # of a request for parameters: rclpy has no limit


class InverseLimits:
    """Which models the controller can invert."""

    MAX_POINTS = 1000  # of a desired curve
    MIN_SPEED_M_S = 0.02  # [m/s] of its grid: below, oil and seals yield before the valve has an effect
    SETTLING_S = 0.3  # [s] of constant speed and current before the force is read: ten times a real valve's lag
    MAX_CURRENT_A = 100.0  # [A] to command: beyond any valve
