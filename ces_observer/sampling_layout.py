"""The arrays of tracker and bank: a model's sampling in; its numbers at the places of `ces_observer.tick`, out."""

from __future__ import annotations

from functools import lru_cache
from itertools import chain

from ces_observer.bank_design import SHIFTS, SPEED, BankMode, BankSettings, Gains, design_bank, response_s, spans_of
from ces_observer.flat import Layout
from ces_observer.kalman import ORDER
from ces_observer.model import Sampling
from ces_observer.tick import bank, tracker

SWITCH_S = 0.2  # [s] mean time for which one mode is the right one
OVERDUE = 1.5  # times 1/rate [s]: in a longer interval samples were lost, a shorter one may be jitter
SETTLING = 6.0  # times the bank's response: the time in which it settles
DOUBT = 3.0  # times that: until the model has settled, too, if the speed after lost samples is uncertain
MAX_CHANGE = 5.0  # times the RMS speed: of the speed, while no sample comes


def layout_of(sampling: Sampling) -> Layout:
    """Return a new layout of tracker and bank alone."""
    layout = Layout(tracker.P_ESTIMATOR, tracker.N_ESTIMATOR, tracker.S_ESTIMATOR, tracker.K_ESTIMATOR)
    fill_tracker(layout, sampling)
    return layout


def fill_tracker(layout: Layout, sampling: Sampling) -> None:
    """Write the numbers of tracker and bank into a layout, and reserve their state."""
    fill_bank(layout, sampling.stroke, sampling.delay_ticks)
    settling_s = SETTLING * response_s(sampling.stroke)
    settling_ticks = settling_s * sampling.rate_Hz
    low, high = sampling.stroke_m
    layout.p[tracker.TICKS_PER_NS] = sampling.rate_Hz * 1e-9
    layout.p[tracker.OUTLIER_M] = sampling.outlier_m
    layout.p[tracker.STROKE_LOW] = low
    layout.p[tracker.STROKE_HIGH] = high
    layout.p[tracker.LARGEST_CHANGE] = MAX_CHANGE * sampling.speed_m_s
    layout.p[tracker.OVERDUE_S] = OVERDUE / sampling.rate_Hz
    layout.p[tracker.SETTLING_S] = settling_s
    layout.p[tracker.SETTLING_TICKS] = settling_ticks
    layout.p[tracker.DOUBT_S] = DOUBT * settling_s
    layout.p[tracker.DOUBT_TICKS] = DOUBT * settling_ticks
    max_gap_ns = round(sampling.max_gap_s * 1e9)
    room = int(max_gap_ns * layout.p[tracker.TICKS_PER_NS]) + 2 if sampling.delay_ticks else 0
    layout.n[tracker.MAX_GAP_NS] = max_gap_ns
    layout.n[tracker.MEASURES_SPEED] = sampling.motion == SPEED
    layout.n[tracker.LATE_AT] = layout.state(2 * room)
    layout.n[tracker.LATE_KNOWN] = layout.memory(room)


def fill_bank(layout: Layout, stroke: BankSettings, delay: int) -> None:
    """Write the numbers of a bank that looks back over `delay` ticks into a layout, and reserve its state."""
    modes, spans = design_bank(stroke, delay), spans_of(stroke)
    tick_s = 1.0 / stroke.rate_Hz
    stay = max(0.0, 1.0 - tick_s / SWITCH_S)
    measurements = 2 if stroke.motion else 1
    ring = (delay + 1) * (1 + len(modes) * (1 + 2 * measurements)) if delay else 0
    size = len(modes) * bank.MODE_WIDTH + ring
    states = layout.state(size)
    layout.p[bank.TICK_S] = tick_s
    layout.p[bank.STAY] = stay
    layout.p[bank.LEAVE] = (1.0 - stay) / len(modes)
    layout.n[bank.DELAY] = delay
    layout.n[bank.MODES] = len(modes)
    layout.n[bank.SPANS] = len(spans)
    layout.n[bank.MEASURES_MOTION] = measurements > 1
    layout.n[bank.SPAN_TABLE] = layout.indices(spans)
    layout.n[bank.SEEN] = layout.table(
        x for at in range(len(SHIFTS)) for mode in modes for x in _seen(mode, at, stroke)
    )
    layout.n[bank.GAINS] = layout.table(_gains(stroke, delay))
    first = (mode.gains[span][0] for span in range(len(spans)) for mode in modes)
    layout.n[bank.LIKELIHOODS] = layout.table(x for gains in first for x in (gains.height, *gains.sharpness))
    layout.n[bank.COMPANIONS] = layout.table(x for mode in modes for x in (*mode.speed, *mode.position))
    smoothing = (row for mode in modes for row in zip(*mode.smoothing, strict=True))
    layout.n[bank.SMOOTHING] = layout.table(chain.from_iterable(smoothing))
    layout.n[bank.MODE_STATES] = states
    layout.n[bank.RING] = states + len(modes) * bank.MODE_WIDTH
    layout.n[bank.BANK_STATES] = size
    layout.n[bank.SAVED] = layout.state(size)


def _seen(mode: BankMode, at: int, stroke: BankSettings) -> tuple[float, ...]:
    return (*mode.measured[at], *mode.motion[at]) if stroke.motion else mode.measured[at]


@lru_cache(maxsize=32)
def _gains(stroke: BankSettings, delay: int) -> tuple[float, ...]:
    """Return the gains of all modes by span and shift; after lost ticks a sample lies within half a tick."""
    modes = design_bank(stroke, delay)
    spans = [
        (span, at) for span in range(len(spans_of(stroke))) for at in range(bank.LATE_SHIFT * (span > 0), len(SHIFTS))
    ]
    return tuple(x for span, at in spans for mode in modes for x in _row(mode.gains[span][at]))


def _row(gains: Gains) -> tuple[float, ...]:
    """Return a mode's row of gains, in the order that `ces_observer.tick.bank` names."""
    position, *motion = zip(gains.position, gains.speed, *gains.states[:ORDER], strict=True)
    if not motion:
        return position
    offset = gains.states[ORDER] if len(gains.states) > ORDER else (0.0, 0.0)
    return (*position, *motion[0], *offset)
