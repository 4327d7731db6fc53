"""Estimates and bands become batches: paired by stamp, thinned out without losing a peak."""

from __future__ import annotations

from ces_serve.live.batches import EstimateBatches


def test_bands_join_their_estimates_whichever_comes_first() -> None:
    batches = EstimateBatches()
    batches.add_band(1, -5.0, 5.0)
    for stamp in (1, 2, 3):
        batches.add_estimate(stamp, 0.1, 0.2, float(stamp))
    batches.add_band(3, -7.0, 7.0)
    batch = batches.take()
    assert batch is not None
    assert (batch["count"], batch["force"]) == (3, [1.0, 2.0, 3.0])
    assert (batch["lower"], batch["upper"]) == ([-5.0, None, -7.0], [5.0, None, 7.0])
    assert batches.take() is None


def test_an_estimate_waits_for_its_band_once() -> None:
    batches = EstimateBatches()
    batches.add_estimate(1, 0.0, 0.0, 1.0)
    batches.add_band(1, -5.0, 5.0)
    batches.add_estimate(2, 0.0, 0.0, 2.0)
    first = batches.take()
    assert first is not None and (first["force"], first["lower"]) == ([1.0], [-5.0])
    batches.add_band(2, -6.0, 6.0)
    batches.add_estimate(3, 0.0, 0.0, 3.0)
    second = batches.take()
    assert second is not None and (second["force"], second["lower"]) == ([2.0], [-6.0])
    third = batches.take()  # no band came: the model has none any more
    assert third is not None and (third["force"], third["lower"]) == ([3.0], [None])


def test_no_estimate_waits_after_the_clock_was_set_back() -> None:
    batches = EstimateBatches()
    batches.add_estimate(1000, 0.0, 0.0, 1.0)
    batches.add_band(5, -5.0, 5.0)
    assert batches.take() is None
    batches.add_band(6, -6.0, 6.0)
    batch = batches.take()
    assert batch is not None and batch["force"] == [1.0]


def test_stamps_keep_their_nanoseconds() -> None:
    batches = EstimateBatches()
    batches.add_estimate(1_795_370_016_197_489_407, 0.0, 0.0, 1.0)
    batch = batches.take()
    assert batch is not None and batch["time_ns"] == ["1795370016197489407"]


def test_a_full_batch_keeps_the_extremes_in_time_order() -> None:
    batches = EstimateBatches()
    forces = [float((17 * k) % 50) for k in range(50)]
    for k, force in enumerate(forces):
        batches.add_estimate(k, 0.0, 0.0, force)
    batch = batches.take()
    assert batch is not None
    times = [int(text) for text in batch["time_ns"]]
    assert times == sorted(times) and len(times) <= 8 and batch["count"] == 50
    assert (min(batch["force"]), max(batch["force"])) == (0.0, 49.0)
    assert batch["force"] == [forces[k] for k in times]


def test_a_batch_after_a_stall_keeps_as_many_points_for_its_time() -> None:
    batches = EstimateBatches()
    for k in range(1000):
        batches.add_estimate(k * 1_000_000, 0.0, 0.0, float(k % 50))
    batch = batches.take()
    assert batch is not None and batch["count"] == 1000
    assert len(batch["time_ns"]) == 160


def test_bands_without_estimates_do_not_pile_up() -> None:
    batches = EstimateBatches()
    for stamp in range(5000):
        batches.add_band(stamp, 0.0, 1.0)
    assert len(batches.bounds) == 2000
    assert 4999 in batches.bounds
