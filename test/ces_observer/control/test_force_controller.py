"""The force controller: always a safe command, and a force that follows its curve on a damper that is known."""

from __future__ import annotations

import cmath
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import cos, degrees, exp, inf, isfinite, nan, pi

import pytest
from damper_models import plain_damper
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_observer.control.control_loop import ESTIMATE, MEASURED, NONE, ControlLoop
from ces_observer.control.force_controller import (
    NO_ESTIMATE,
    NOT_FINITE,
    OK,
    STALE,
    CurveError,
    ForceController,
    ForceCurve,
    Tuning,
)
from ces_observer.control.inverse_map import compute_inverse_map
from ces_observer.errors import CesError
from ces_observer.nodes import parameter_table

MS = 1_000_000
START_NS = 10**18
INVERSE = compute_inverse_map(plain_damper())
SOFTER = replace(INVERSE, forces_N=tuple(tuple(0.8 * force for force in row) for row in INVERSE.forces_N))
CURVE = ForceCurve.from_points([-2.0, 0.0, 2.0], [-5600.0, 0.0, 5600.0])  # 0.8 A of the plain damper
TUNING = Tuning(low_A=0.0, high_A=2.0, safe_A=0.3, rate_A_s=20.0, valve_lag_s=0.0, preview_s=0.0, recovery_s=0.1)
QUICK = Tuning(low_A=0.0, high_A=2.0, safe_A=0.3, rate_A_s=1e6, valve_lag_s=0.0, preview_s=0.0, recovery_s=0.0)
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
STEP = st.tuples(st.integers(-(2 * 10**9), 2 * 10**9) | st.integers(0, 5 * MS), ANY | st.floats(-2.0, 2.0), ANY)


def controller(tuning: Tuning = TUNING) -> ForceController:
    return ForceController(CURVE, INVERSE, tuning)


@pytest.mark.slow
@settings(max_examples=150)
@given(st.lists(STEP, max_size=60))
def test_any_input_gives_a_command_within_limits_and_rate(steps: list[tuple[int, float, float]]) -> None:
    made, stamp, newest, last = controller(), START_NS, START_NS, TUNING.safe_A
    for elapsed_ns, speed, force in steps:
        stamp += elapsed_ns
        command = made.step(stamp, speed, force)
        reach = TUNING.rate_A_s * TUNING.timeout_s if stamp > newest else 0.0
        assert TUNING.low_A <= command <= TUNING.high_A
        assert abs(command - last) <= reach + 1e-12
        newest, last = stamp, command


@pytest.mark.slow
@given(st.floats(-2.0, 2.0), st.integers(0, 50 * MS))
def test_the_rate_limit_holds_over_any_step(speed: float, elapsed_ns: int) -> None:
    made = controller()
    for k in range(200):
        made.step(START_NS + k * MS, 1.0, nan)
    before = made.command_A
    after = made.step(START_NS + 199 * MS + elapsed_ns, speed, nan)
    assert abs(after - before) <= TUNING.rate_A_s * elapsed_ns * 1e-9 + 1e-12


def test_feed_forward_alone_is_the_inverse() -> None:
    made = controller(QUICK)
    for k in range(10):
        made.step(START_NS + k * MS, 0.7, nan)
    assert made.command_A == pytest.approx(0.8, abs=1e-3)
    assert made.count.unfed == 10
    assert made.desired_N == pytest.approx(1960.0)


def test_it_converges_on_a_damper_weaker_than_its_map() -> None:
    """The damper gives 85 % of the model's force, behind a lag; the map alone then is 15 % short."""
    alone, fed_back = (tracking_error(lambda i, v: 0.85 * (2000.0 + 1000.0 * i) * v, feed) for feed in (False, True))
    assert alone == pytest.approx(0.15, abs=0.02)
    assert fed_back < 0.02


def test_each_direction_has_a_trim_of_its_own() -> None:
    """10 % too little in compression, 10 % too much in rebound."""
    made = controller()
    error = tracking_error(lambda i, v: (1.1 if v < 0.0 else 0.9) * (2000.0 + 1000.0 * i) * v, True, made)
    rebound, compression = made.trims_A
    assert error < 0.02
    assert compression == pytest.approx(2800.0 / 900.0 - 2.8, abs=0.05)
    assert rebound == pytest.approx(2800.0 / 1100.0 - 2.8, abs=0.05)


def test_nothing_winds_up_at_a_limit() -> None:
    """A damper without oil gives no force: the current stands at its limit, and comes back at once when it may."""
    made = controller()
    tracking_error(lambda i, v: 0.0, True, made)
    assert max(map(abs, made.trims_A)) <= TUNING.high_A - 0.8 + 0.05
    assert made.count.saturated > 0
    error = tracking_error(lambda i, v: (2000.0 + 1000.0 * i) * v, True, made)
    assert error < 0.02


def test_what_the_damper_cannot_do_is_clipped_and_counted() -> None:
    curve = ForceCurve.from_points(
        [-2.0, 0.0, 2.0], [-2000.0, 0.0, 9000.0]
    )  # too soft in rebound, too firm in compression
    made = ForceController(curve, INVERSE, QUICK)
    for k in range(3):
        made.step(START_NS + k * MS, 1.0, 4000.0)
    assert made.command_A == pytest.approx(2.0)
    assert (made.desired_N, made.reachable_N) == (4500.0, pytest.approx(4000.0, rel=1e-3))
    for k in range(3, 6):
        made.step(START_NS + k * MS, -1.0, -2000.0)
    assert made.command_A == pytest.approx(0.0)
    assert (made.desired_N, made.reachable_N) == (-1000.0, pytest.approx(-2000.0, rel=1e-3))
    assert made.count.unreachable == 6


def test_the_force_counts_only_after_the_reversal_is_over() -> None:
    made = controller()
    for k in range(10):
        made.step(START_NS + k * MS, 0.2, 0.0)  # 1.8 mm
    assert made.trims_A == (0.0, 0.0)
    for k in range(10, 30):
        made.step(START_NS + k * MS, 0.2, 0.0)
    assert made.trims_A[1] > 0.0


def test_the_command_leads_the_valve() -> None:
    """Behind the valve's lag the current is what the map asked for, but for the lead's own filter."""
    tuning = Tuning(low_A=0.0, high_A=2.0, safe_A=0.3, rate_A_s=1e6, valve_lag_s=0.01, preview_s=0.0, recovery_s=0.0)
    curve = ForceCurve.from_points([0.0, 1.0, 1.5], [0.0, 2300.0, 4200.0])  # 0.3 A at 1 m/s, 0.8 A at 1.5 m/s
    made, behind = ForceController(curve, INVERSE, tuning), 0.3
    for k in range(50):
        made.step(START_NS + k * MS, 1.0, nan)
    for k in range(50, 62):
        behind += (made.step(START_NS + k * MS, 1.5, nan) - behind) * (1.0 - exp(-0.1))
    assert behind == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize("speed", [nan, inf, -inf, 1e300])
def test_a_speed_that_is_none_leads_to_the_safe_current(speed: float) -> None:
    made = controller()
    settle(made)
    commands = [made.step(START_NS + (1001 + k) * MS, speed, 0.0) for k in range(100)]
    assert commands[0] == pytest.approx(0.8 - 0.001 * TUNING.rate_A_s)
    assert commands[-1] == TUNING.safe_A
    assert made.reason == NOT_FINITE
    assert made.count.interruptions == {NOT_FINITE: 1}
    assert not isfinite(made.desired_N)


def test_recovery_is_gradual() -> None:
    made = controller()
    settle(made)
    while made.command_A != TUNING.safe_A:
        made.fail_safe(NO_ESTIMATE, 0.001)
    commands = [made.step(START_NS + (2000 + k) * MS, 1.0, 2800.0) for k in range(200)]
    steps = [abs(b - a) for a, b in zip([TUNING.safe_A, *commands], commands, strict=False)]
    assert made.reason == OK
    assert max(steps) <= 1.1 * (0.8 - TUNING.safe_A) / (TUNING.recovery_s * 1000.0)
    assert commands[-1] == pytest.approx(0.8, abs=1e-3)


def test_another_map_is_adopted_without_a_bump() -> None:
    """Half a second on, the map is of a damper 20 % softer: from 0.8 A its current fades in, with trims of its own."""
    made = controller()
    for k in range(1001):
        made.step(START_NS + k * MS, 1.0, 2700.0)
    before = made.command_A
    assert made.trims_A[1] > 0.02
    made.adopt(SOFTER)
    commands = [made.step(START_NS + (1001 + k) * MS, 1.0, 2800.0) for k in range(200)]
    steps = [b - a for a, b in zip([before, *commands], commands, strict=False)]
    assert commands[-1] == pytest.approx(1.5, abs=1e-3)
    assert min(steps) >= 0.0
    assert max(steps) == pytest.approx((1.5 - before) / (TUNING.recovery_s * 1000.0), rel=0.01)
    assert made.trims_A == (0.0, 0.0)
    assert made.count.interruptions == {}


def test_an_interruption_ends_the_fading_over_to_another_map() -> None:
    made = controller()
    settle(made)
    made.adopt(SOFTER)
    made.step(START_NS + 1001 * MS, 1.0, 2800.0)
    while made.command_A != TUNING.safe_A:
        made.fail_safe(NO_ESTIMATE, 0.001)
    commands = [made.step(START_NS + (2000 + k) * MS, 1.0, 2800.0) for k in range(200)]
    assert max(b - a for a, b in pairwise(commands)) == pytest.approx(1.2 / (TUNING.recovery_s * 1000.0), rel=0.01)
    assert commands[-1] == pytest.approx(1.5, abs=1e-3)


def test_a_repeated_stamp_changes_nothing_and_a_clock_set_back_starts_anew() -> None:
    made = controller()
    settle(made)
    before, steps = made.command_A, made.count.steps
    assert made.step(START_NS + 1000 * MS, -1.0, 0.0) == before
    assert made.step(START_NS + 900 * MS, -1.0, 0.0) == before
    assert made.count.steps == steps
    made.step(START_NS - 10**10, 1.0, 2800.0)
    assert made.reason == OK
    assert made.count.steps == steps + 1


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"low_A": 2.0, "high_A": 1.0}, "lower limit first"),
        ({"safe_A": 3.0}, "within 0 to 2 A"),
        ({"loop_gain_1_s": -1.0}, "expected at least 0"),
        ({"rate_A_s": 0.0}, "above 0"),
        ({"preview_s": nan}, "finite"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(change: dict[str, float], text: str) -> None:
    with pytest.raises(CesError, match=text):
        Tuning(**{"low_A": 0.0, "high_A": 2.0, "safe_A": 0.3, **change})


@pytest.mark.parametrize(
    ("gain", "lag_s", "delay_s", "phase_deg", "amplitude"),
    [(4.0, 0.010, 0.005, 86.0, 16.0), (12.0, 0.050, 0.005, 52.0, 1.5)],
)
def test_the_margins_are_at_least_as_documented(
    gain: float, lag_s: float, delay_s: float, phase_deg: float, amplitude: float
) -> None:
    """The open loop of the module's docstring, on a grid of frequencies."""
    loop = [(w, gain * cmath.exp(-1j * w * delay_s) / (1j * w * (1.0 + 1j * w * lag_s))) for w in sweep(0.1, 1e3)]
    crossing = next(value for _, value in loop if abs(value) < 1.0)
    turned = next(abs(value) for (_, value) in loop if value.imag > 0.0)
    assert 180.0 + degrees(cmath.phase(crossing)) >= phase_deg
    assert 1.0 / turned >= amplitude


class TestLoop:
    """The watch for estimates, and which force is fed back."""

    def test_silence_leads_to_the_safe_current_in_time(self) -> None:
        loop = running(ESTIMATE)
        assert loop.watch(1.0 + 0.03, 0.01) is None
        assert loop.watch(1.0 + 0.041, 0.01) is not None
        assert loop.controller.reason == NO_ESTIMATE
        for k in range(6):
            loop.watch(1.05 + 0.01 * k, 0.01)
        assert loop.controller.command_A == TUNING.safe_A

    def test_stale_and_unusable_estimates_lead_to_the_safe_current(self) -> None:
        loop = running(ESTIMATE)
        late = START_NS + 1001 * MS
        loop.take_estimate(late, 1.0, 2800.0, late + 60 * MS, 1.001)
        assert loop.controller.reason == STALE
        loop.take_estimate(late + MS, 1.0, nan, late + MS, 1.002)
        assert loop.controller.reason == NOT_FINITE
        loop.take_estimate(late + 2 * MS, 1.0, 2800.0, late + 2 * MS, 1.003)
        assert loop.controller.reason == OK

    def test_any_age_is_followed_if_none_is_too_large(self) -> None:
        loop = running(ESTIMATE)
        loop.max_age_s = 0.0
        loop.take_estimate(START_NS + 1001 * MS, 1.0, 2800.0, START_NS + 10**13, 1.001)
        assert loop.controller.reason == OK

    def test_the_measured_force_is_fed_back_while_it_is_fresh(self) -> None:
        loop = running(MEASURED)
        unfed = loop.controller.count.unfed
        loop.take_measured_force(1000.0, 1.0)
        loop.take_estimate(START_NS + 1001 * MS, 1.0, 2800.0, START_NS + 1001 * MS, 1.001)
        assert loop.controller.count.unfed == unfed
        assert loop.controller.trims_A[1] > 0.0
        loop.take_estimate(START_NS + 1050 * MS, 1.0, 2800.0, START_NS + 1050 * MS, 1.051)
        assert loop.controller.count.unfed == unfed + 1

    def test_without_feedback_the_force_does_not_matter(self) -> None:
        loop = running(NONE)
        assert loop.controller.trims_A == (0.0, 0.0)
        assert loop.controller.count.unfed == loop.estimates


def running(feedback: str) -> ControlLoop:
    """Return a loop after a second of estimates at 1 kHz, the last at 1.0 s of steady time."""
    loop = ControlLoop(controller(), feedback, max_age_s=0.05)
    for k in range(1, 1001):
        loop.take_estimate(START_NS + k * MS, 1.0, 2800.0, START_NS + k * MS, 0.001 * k)
    return loop


def settle(made: ForceController) -> None:
    for k in range(1001):
        made.step(START_NS + k * MS, 1.0, 2800.0)
    assert made.reason == OK


def tracking_error(damper: Callable[[float, float], float], feed: bool, made: ForceController | None = None) -> float:
    """Return the relative error in the last of six seconds of a 1 Hz stroke; force 5 ms and commands 2 ms late."""
    made, force, wrong, asked = made or controller(), 0.0, 0.0, 0.0
    start_ns = START_NS if made.command_A == TUNING.safe_A else START_NS + 10**11
    commands = [made.command_A] * 2
    for k in range(6000):
        speed = 0.8 * cos(2.0 * pi * k / 1000.0)
        force += (damper(commands.pop(0), speed) - force) * (1.0 - exp(-1.0 / 5.0))
        commands.append(made.step(start_ns + k * MS, speed, force if feed else nan))
        if k >= 5000 and abs(speed) > 0.3:
            late = 0.8 * cos(2.0 * pi * (k - 5) / 1000.0)  # whose force it is
            wrong, asked = wrong + (force - CURVE.at(late)) ** 2, asked + CURVE.at(late) ** 2
    return float((wrong / asked) ** 0.5)


def sweep(low: float, high: float) -> list[float]:
    return [low * (high / low) ** (n / 20_000) for n in range(20_001)]


# ------------- The desired speed-force curve: linear between its points, held beyond them, refused if it could drive.


CURVES = ForceCurve.from_points([-1.0, -0.2, 0.0, 0.5], [-900.0, -500.0, 0.0, 400.0])


def test_points_and_between_them() -> None:
    assert [CURVES.at(v) for v in (-1.0, -0.2, 0.0, 0.5)] == [-900.0, -500.0, 0.0, 400.0]
    assert CURVES.at(-0.6) == pytest.approx(-700.0)
    assert CURVES.at(0.25) == pytest.approx(200.0)


def test_the_ends_hold() -> None:
    assert CURVES.at(-50.0) == -900.0
    assert CURVES.at(1e300) == 400.0


@given(st.floats(-10.0, 10.0))
def test_it_never_drives(speed: float) -> None:
    assert speed * CURVES.at(speed) >= 0.0
    assert -900.0 <= CURVES.at(speed) <= 400.0


@pytest.mark.parametrize(
    ("speeds", "forces", "text"),
    [
        ([0.0], [0.0], "1 speeds and 1 forces"),
        ([-1.0, 1.0], [-5.0, 0.0, 5.0], "2 speeds and 3 forces"),
        ([0.0, 1.0, 1.0], [0.0, 5.0, 6.0], "rising order"),
        ([1.0, 0.0], [5.0, 0.0], "rising order"),
        ([0.0, inf], [0.0, 5.0], "not finite"),
        ([0.0, 1.0], [0.0, nan], "not finite"),
        ([-1.0, 1.0], [5.0, 5.0], "5 N at -1 m/s would drive"),
        ([-1.0, 2.0], [-100.0, 500.0], "100 N at rest"),
    ],
)
def test_a_curve_that_cannot_be_used_is_refused(speeds: list[float], forces: list[float], text: str) -> None:
    with pytest.raises(CurveError, match=text):
        ForceCurve.from_points(speeds, forces)


def test_the_default_curve_is_one() -> None:
    assert ForceCurve.from_points(*(spec.default for spec in parameter_table.CURVE)).at(0.0) == 0.0
