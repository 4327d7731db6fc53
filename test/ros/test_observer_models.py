"""Another model for a running observer: by parameter, service and latched topic; under load, with no sample missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import damper_with_past
from node_process import NodeProcess
from vehicle import Vehicle, reliable_inputs, stamp_of, wait

from ces_observer.model import Model

CHANGE = "last change of the model"
MAX_GAP_S = 5.0  # with samples that a busy computer holds up
UNPROVED = "not proved to be a contraction"


def damper(past: float = 0.9) -> Model:
    """Return the test model with another coefficient of its past force, which another digest names."""
    return damper_with_past(past, max_gap_s=MAX_GAP_S)


@pytest.fixture(scope="module")
def driven(
    module_vehicle: Vehicle, module_start: Callable[..., NodeProcess], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Vehicle]:
    """Yield a vehicle that drives through all tests of this module, and see at their end that no sample is missing.

    Its current is a known one: what has no stamp is stamped on arrival, too late for positions that were held up.
    """
    vehicle = module_vehicle
    path = tmp_path_factory.mktemp("models") / "first.json"
    damper().save(path)
    inputs = reliable_inputs(vehicle.namespace, ["joint_states"])
    module_start(model=path, max_age_s=0.0, **{"current.constant": 0.5}, **inputs)
    vehicle.meets_node()
    with vehicle.driving(contiguous=True):
        wait(lambda: bool(vehicle.estimates), "the first estimate")
        yield vehicle
    wait(lambda: stamp_of(vehicle.estimates[-1]) == vehicle.driven[-1], "the last estimate")
    expected = vehicle.driven[vehicle.driven.index(vehicle.stamps()[0]) :]
    assert vehicle.stamps() == expected
    assert len(expected) > 1000
    assert all(isfinite(message.effort[0]) and abs(message.effort[0]) < 8000.0 for message in vehicle.estimates)


def runs(vehicle: Vehicle, model: Model) -> None:
    """Wait until diagnostics tell that the node runs the model."""
    vehicle.hears_value("model sha256", model.digest())


def test_by_parameter(driven: Vehicle, tmp_path: Path) -> None:
    path, model = tmp_path / "softer.json", damper(0.8)
    model.save(path)
    answer = driven.sets("model", str(path))
    assert answer.successful and f"{path}: is being checked; the outcome comes on " in answer.reason
    runs(driven, model)
    assert driven.gets("model") == str(path)
    driven.hears_value(CHANGE, f"{path}: has taken over")


def test_by_service_which_reads_the_same_file_again(driven: Vehicle, tmp_path: Path) -> None:
    path, model = tmp_path / "model.json", damper(0.7)
    damper(0.75).save(path)
    assert driven.sets("model", str(path)).successful
    model.save(path)
    answer = driven.reloads.call()
    assert answer.success, answer.message
    assert "takes over when warmed up, after 0.1 s" in answer.message
    runs(driven, model)


def test_a_file_that_is_no_model_is_refused_at_once(driven: Vehicle, tmp_path: Path) -> None:
    before = driven.gets("model")
    answer = driven.sets("model", str(tmp_path / "none.json"))
    assert not answer.successful
    assert "none.json: no such model file" in answer.reason
    (tmp_path / "broken.json").write_text(damper().to_json()[:-20])
    assert "broken.json: not a JSON file" in driven.sets("model", str(tmp_path / "broken.json")).reason
    assert driven.gets("model") == before


def test_an_unstable_model_is_refused_once_it_cannot_be_proved(driven: Vehicle, tmp_path: Path) -> None:
    before, path = driven.gets("model"), tmp_path / "unstable.json"
    damper(1.01).save(path)
    assert driven.sets("model", str(path)).successful  # for all that can be seen at once
    driven.hears_value(CHANGE, UNPROVED)
    wait(lambda: driven.gets("model") == before, "the parameter goes back")


def test_the_service_says_why_it_refuses(driven: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "worn.json"
    damper(0.85).save(path)
    assert driven.sets("model", str(path)).successful
    runs(driven, damper(0.85))
    damper(1.01).save(path)
    answer = driven.reloads.call()
    assert not answer.success and UNPROVED in answer.message
    path.unlink()
    before = refusals(driven)
    for count in (1, 2):  # the same once more is an event of its own
        assert "worn.json: no such model file" in driven.reloads.call().message
        wait(lambda told=before + count: refusals(driven) >= told, "the refusal is counted")


def refusals(vehicle: Vehicle) -> int:
    """Return how many models the node says to have refused."""
    return max(int(v.value) for s in list(vehicle.statuses) for v in s.values if v.key == "models refused")


def test_the_newest_of_several_wins(driven: Vehicle, tmp_path: Path) -> None:
    models = [damper(0.5 + 0.01 * k) for k in range(5)]
    for k, model in enumerate(models):
        model.save(tmp_path / f"{k}.json")
        assert driven.sets("model", str(tmp_path / f"{k}.json")).successful
    runs(driven, models[-1])


def test_each_of_many_simultaneous_requests_is_answered(driven: Vehicle) -> None:
    answers = driven.reloads.answers(200)
    assert all(answer.success for answer in answers)
    assert len({answer.message.partition(":")[0] for answer in answers}) == 200
