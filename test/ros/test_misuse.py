"""Every service, parameter and topic of all four nodes misused, while samples run.

No node exits, the estimates go on, and each of them equals the offline replay. Each kind of executor meets half of
the inputs, every other one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from damper_models import damper_with_past
from misuse import Misuser
from node_process import ROOT, NodeProcess, ros_args
from replay import Offline, numbers_of
from vehicle import JOINT, STAMPED_CURRENT, Vehicle, reliable_inputs, stamp_of, stroke, wait

from ces_observer.current_hold import ConstantCurrent
from ces_observer.model import Model

CURRENT_A = 0.5
QUICK = {"bags": f"[{ROOT / 'bags' / 'noise'}]", "terms": 2, "starts": 1, "threads": 1}
EXECUTORS = ("events", "single")
RATE_HZ = 250  # of the samples: four nodes run meanwhile


def damper() -> Model:
    """Return a model that has forgotten its past when it has warmed up: a restart changes no force by 1e-5 N."""
    return damper_with_past(0.6, rate_Hz=RATE_HZ, warm_up_s=1.0, max_gap_s=5.0, max_current_age_s=60.0)


@contextmanager
def running(namespace: str, executor: str, folder: Path) -> Iterator[dict[str, NodeProcess]]:
    """Run all four nodes; the rig has topics of its own, so that the observer sees one source of samples only."""
    model = folder / "model.json"
    damper().save(model)
    lossless = reliable_inputs(namespace, ["joint_states", "stamped_current"])
    programs = {
        "observer": (
            "ces_observer.nodes.observer",
            {"model": model, "max_age_s": 0.0, "snapshot_service": "''"}
            | {"executor": executor}
            | STAMPED_CURRENT
            | lossless,
        ),
        "controller": (
            "ces_observer.nodes.controller",
            {"model": model, "executor": executor, "feedback": "measured"},
        ),
        "rig": ("ces_rig.live.node", {"executor": executor, "rate_hz": 200}),
        "identify": ("ces_cli.identify.node", {**QUICK, "out": folder / "out.json"}),
    }
    rig = ["-r", "joint_states:=rig/joint_states", "-r", "measured_force:=rig/measured_force"]
    started = {}
    try:
        for name, (module, parameters) in programs.items():
            words = [*ros_args(namespace, parameters), *(rig if name == "rig" else [])]
            started[name] = NodeProcess([sys.executable, "-m", module, *words])
        yield started
    finally:
        for node in started.values():
            node.kill()


@pytest.mark.parametrize("executor", EXECUTORS)
def test_no_misuse_ends_a_node_or_changes_an_estimate(
    vehicle: Vehicle, namespace: str, executor: str, tmp_path: Path
) -> None:
    names = ("observer", "controller", "rig", "identify")
    part = slice(EXECUTORS.index(executor), None, len(EXECUTORS))
    with running(namespace, executor, tmp_path) as nodes, Misuser(namespace, names, part) as misuser:
        vehicle.meets_node()
        misuser.meets_nodes()
        current = vehicle.repeating(0.01, lambda: vehicle.publish_current(vehicle.driven[-1], CURRENT_A))
        with vehicle.driving(current=None, contiguous=True, rate_Hz=RATE_HZ), current:
            wait(lambda: len(vehicle.estimates) > 100, "the first estimates")
            for done in misuser.attack_all():
                dead = {name: node.ended() for name, node in nodes.items() if not node.is_running()}
                assert not dead, done
                before = len(vehicle.estimates)
                wait(lambda count=before: len(vehicle.estimates) > count + 10, f"estimates after {done}")
        last = vehicle.driven[-1]
        wait(lambda: stamp_of(vehicle.estimates[-1]) == last, "the last estimate")
        assert all(node.is_running() for node in nodes.values())
        assert not misuser.unexpected
        nodes["observer"].interrupt()
        _, output = nodes["observer"].ended()
        assert 1 <= output.count("the estimates restart") <= 4, output  # of more than a hundred times
        assert output.count("/clock: ignored messages") <= 1, output  # its queue holds one: a busy computer loses some
    compare(vehicle, damper())


def compare(vehicle: Vehicle, model: Model) -> None:
    """Each estimate equals that of an estimator that has had all samples in order, but for what one forgets slowly."""
    positions = [(stamp, stroke(stamp % 10**12 * 1e-9)) for stamp in vehicle.driven]
    expected = Offline(model, ConstantCurrent(CURRENT_A)).take(positions)
    wrong = []
    for message in vehicle.estimates:
        assert list(message.name) == [JOINT]
        heard = numbers_of(message)
        position, speed, force = expected[stamp_of(message)]
        # 600 N at most times: where the force crosses zero, 1e-10 m/s of a restart are more than 1e-6 of it
        same = heard[2] == pytest.approx(force, rel=1e-6, abs=1e-5)
        if not same or heard[:2] != pytest.approx((position, speed), rel=1e-6, abs=1e-9):
            wrong.append((stamp_of(message), heard, expected[stamp_of(message)]))
    assert not wrong, f"{len(wrong)} of {len(vehicle.estimates)} estimates, such as {wrong[:3]}"
    assert len(vehicle.estimates) > 0.5 * len(vehicle.driven) > 1000
