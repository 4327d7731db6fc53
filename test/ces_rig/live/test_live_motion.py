"""What moves the piston: a follower of set points, an endless road of ISO 8608, a quarter vehicle on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch

from ces_data.waveforms.strokes import QuarterVehicle
from ces_rig import drive as qv
from ces_rig.dampers.bouc_wen.kernel import BoucWen
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.model import RigDamper
from ces_rig.dampers.stepper import DamperStepper, Mover
from ces_rig.errors import RigError
from ces_rig.live.motion import CLASSES, ROAD_BLOCK, Follower, LiveRoad, Vehicle
from ces_rig.live.rig import LiveRig, RigSettings


def test_a_step_is_followed_as_the_equation_says() -> None:
    follower, interval, omega = Follower(10.0, 0.1, 0.5e-3), 0.5e-3, 2 * np.pi * 10.0
    follower.set_stroke(0.02)
    stroke, speed = (np.concatenate(parts) for parts in zip(*(follower.moves(2) for _ in range(300)), strict=True))
    time = interval * np.arange(1, 601)
    assert stroke == pytest.approx(0.02 * (1.0 - (1.0 + omega * time) * np.exp(-omega * time)), abs=1e-12)
    assert speed == pytest.approx(0.02 * omega**2 * time * np.exp(-omega * time), abs=1e-10)
    assert stroke.max() <= 0.02


def test_set_points_out_of_reach_or_not_finite_do_no_harm() -> None:
    follower = Follower(60.0, 0.03, 0.5e-3)
    follower.set_stroke(1.0)
    assert follower.moves(2000)[0].max() == pytest.approx(0.03)
    follower.set_stroke(float("nan"))
    assert follower.moves(10)[0][-1] == pytest.approx(0.03)


INTERVAL = 0.5e-3


def heights(road: LiveRoad, count: int) -> np.ndarray:
    return np.concatenate([road.heights(ROAD_BLOCK) for _ in range(count // ROAD_BLOCK)])


@pytest.mark.slow
@pytest.mark.parametrize(("road_class", "speed"), [("A", 25.0), ("C", 4.0), ("H", 25.0)])
def test_density_is_that_of_the_standard(road_class, speed):
    """Waviness 2 and the class's level at 0.1 cycles/m, between the longest waves and the tyre's contact patch."""
    road = LiveRoad(road_class, speed, INTERVAL, np.random.default_rng(1))
    apart = speed * INTERVAL
    every = max(1, round(0.05 / apart))
    height = heights(road, round(12_000 / apart))[::every]
    wave, density = welch(height, 1 / (apart * every), nperseg=2**13)
    band = (wave > 0.03) & (wave < 1.0)
    slope, level = np.polyfit(np.log(wave[band] / 0.1), np.log(density[band]), 1, w=wave[band] ** -0.5)
    assert slope == pytest.approx(-2.0, abs=0.15)
    assert np.exp(level) == pytest.approx(16e-6 * 4 ** CLASSES.index(road_class), rel=0.15)


def test_at_standstill_the_road_stands_still():
    road = LiveRoad("D", 20.0, INTERVAL, np.random.default_rng(3))
    heights(road, 10_000)
    road.speed_m_s = 0.0
    height = heights(road, 1000)
    assert np.ptp(height[ROAD_BLOCK:]) == 0.0


def test_the_same_whatever_the_portions():
    whole, parts = (LiveRoad("B", 15.0, INTERVAL, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(
        heights(whole, 600), np.concatenate([parts.heights(n) for n in (3, 97, 100, 99, 100, 100, 1, 100)])
    )


WEIGHT_N = (145.0 + 17.0) * 9.81


def in_vehicle(model: RigDamper, step_s: float | None = None, vehicle: Vehicle | None = None) -> DamperStepper:
    """Return the stepper of a damper in a vehicle."""
    numbers = (vehicle or Vehicle()).numbers(0.06)
    return DamperStepper(model, INTERVAL, step_s, Mover(qv.VEHICLE, numbers))


def ridden(stepper: DamperStepper, heights: np.ndarray, current: float) -> np.ndarray:
    """Return the motion after each grid interval, shape (n, MOTION_SIZE)."""
    stepper.settle(0.0, 0.0, current)
    out = []
    for height in heights:
        stepper.advance(np.array([height]), 0.0, current)
        out.append(stepper.motion.copy())
    return np.array(out)


def wavy(seconds: float) -> np.ndarray:
    time = np.arange(0, seconds, INTERVAL) + INTERVAL
    return 0.012 * np.clip(time, 0, 1) ** 2 * (np.sin(2 * np.pi * 1.3 * time) + 0.5 * np.sin(2 * np.pi * 9 * time))


@pytest.mark.parametrize("kind", ["hydraulic", "bouc_wen", "lookup"])
def test_at_rest_it_stays_at_rest(tmp_path, kind):
    (tmp_path / "rig.yaml").write_text(f"kind: {kind}")
    settings = RigSettings(
        drive="vehicle", damper=str(tmp_path / "rig.yaml"), vehicle=Vehicle(speed_m_s=0.0), noise=0.0
    )
    rig = LiveRig(settings)
    samples = [rig.tick() for _ in range(1000)]
    assert max(abs(s.position_m) for s in samples) < 1e-4
    assert max(abs(s.force_N) for s in samples) < 2.0
    assert max(abs(s.body_m_s2) for s in samples) < 0.02
    assert samples[-1].tyre_N == pytest.approx(WEIGHT_N, abs=5.0)


@pytest.mark.slow
def test_with_a_linear_damper_it_moves_as_the_linear_vehicle():
    """An MR damper without yield on stiff fluid is a dashpot; its stroke is then the linear response to the road."""
    dashpot = BoucWen(
        yield_N=0.0, yield_N_A=0.0, viscous_Ns_m=1400.0, viscous_Ns_mA=0.0, series_Ns_m=1e8, inner_N_m=0.0,
        fluid_N_m=1e8, seal_N=0.0, rod_m2=1e-6, gas_Pa=1.1e5, mount_N_m=1e8, mount_Ns_m=1e4, mass_kg=0.05,
    )  # fmt: skip
    plant = in_vehicle(dashpot, 5e-5)
    time = np.arange(0, 4, INTERVAL) + INTERVAL
    for frequency in (1.5, 4.0, 12.0):
        amplitude = 0.004
        stroke = ridden(plant, amplitude * np.sin(2 * np.pi * frequency * time), 0.0)[:, qv.STROKE]
        response = QuarterVehicle().stroke_response(np.array([frequency]))[0]
        expected = amplitude * np.imag(response * np.exp(2j * np.pi * frequency * time))
        late = time > 3.0
        assert stroke[late] == pytest.approx(expected[late], abs=0.02 * np.abs(expected[late]).max())


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [1e-4, 5e-5])
def test_finer_steps_change_little(step_s):
    fine, rough = (ridden(in_vehicle(HydraulicDamper(Damper()), step), wavy(3.0), 0.5) for step in (step_s / 2, step_s))
    for which in (qv.STROKE, qv.FORCE, qv.TYRE):
        error = np.sqrt(np.mean((rough[:, which] - fine[:, which]) ** 2))
        assert 0.0 < error < 0.01 * fine[:, which].std()


@pytest.mark.slow
def test_energy_that_the_road_puts_in_warms_the_damper():
    """What body and wheel have lost at the end is what dampers took: nothing comes from nowhere."""
    plant = in_vehicle(HydraulicDamper(Damper()))
    heights = wavy(6.0)
    motion = ridden(plant, heights, 0.5)
    rate = np.diff(heights, prepend=0.0) / INTERVAL
    tyre = motion[:, qv.TYRE] - WEIGHT_N
    put_in = np.sum(tyre * rate) * INTERVAL
    damper = np.sum(motion[:, qv.FORCE] * motion[:, qv.STROKE_SPEED]) * INTERVAL
    in_tyre = 250.0 * np.sum((rate - motion[:, qv.WHEEL_SPEED]) ** 2) * INTERVAL
    assert damper > 50.0
    assert damper + in_tyre == pytest.approx(put_in, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [200, 2000])
def test_the_worst_road_stays_between_the_dampers_ends(rate_hz):
    rig = LiveRig(
        RigSettings(drive="vehicle", vehicle=Vehicle(road_class="H", speed_m_s=60.0), noise=0.0, rate_hz=rate_hz)
    )
    samples = [rig.tick() for _ in range(5 * rate_hz)]
    stroke = np.array([s.position_m for s in samples])
    assert np.isfinite([(s.force_N, s.body_m_s2, s.tyre_N) for s in samples]).all()
    assert np.abs(stroke).max() == pytest.approx(0.059, abs=1e-9)
    assert rig.motion[qv.BLOWS] > 0
    assert min(s.tyre_N for s in samples) == 0.0  # the wheel leaves the road, and is never pulled down


def test_a_blow_keeps_momentum_and_takes_energy():
    b = qv.VehicleNumbers(*Vehicle().numbers(0.06))
    motion = np.zeros(qv.MOTION_SIZE)
    motion[qv.WHEEL], motion[qv.BODY_SPEED], motion[qv.WHEEL_SPEED] = 0.0605, -1.0, 3.0
    before = 145.0 * -1.0 + 17.0 * 3.0
    centre = 17.0 * 0.0605 / 162.0
    qv.limit_stroke(b, motion)
    assert 145.0 * motion[qv.BODY_SPEED] + 17.0 * motion[qv.WHEEL_SPEED] == pytest.approx(before)
    assert motion[qv.WHEEL_SPEED] == motion[qv.BODY_SPEED]
    assert motion[qv.WHEEL] - motion[qv.BODY] == pytest.approx(0.059)
    assert (145.0 * motion[qv.BODY] + 17.0 * motion[qv.WHEEL]) / 162.0 == pytest.approx(centre)


def test_a_stop_beyond_the_damper_is_refused():
    with pytest.raises(RigError, match=r"stop_clearance_m 0\.06 is not below"):
        LiveRig(RigSettings(vehicle=replace(Vehicle(), stop_clearance_m=0.06)))
