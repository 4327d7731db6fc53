"""Security enforced: keys and permissions made of the packaged policy, and what it keeps out."""

from __future__ import annotations

import ctypes
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from math import inf
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")
pytest.importorskip("sros2", reason="sros2 is not installed")

import sros2._utilities
from cryptography.hazmat.primitives.asymmetric import ec
from damper_models import plain_damper
from node_process import ROOT, NodeProcess
from patience import PATIENCE_S
from ros2cli.cli import main as ros2
from sros2.policy import load_policy
from vehicle import Vehicle

POLICY = ROOT / "config" / "security" / "policy.xml"
PARTICIPANT = Path(__file__).with_name("secured_participant.py")
PLUGINS = ("auth", "ac", "crypto")
PHASE_S = 2.5
Start = Callable[..., NodeProcess]


def has_plugins() -> bool:
    try:
        return all(ctypes.CDLL(f"libdds_security_{name}.so") for name in PLUGINS)
    except OSError:
        return False


pytestmark = pytest.mark.skipif(
    os.environ.get("RMW_IMPLEMENTATION", "") == "rmw_cyclonedds_cpp" and not has_plugins(),
    reason="this Cyclone DDS was built without its security plugins",
)


class AnyCurve:
    """The module that sros2 takes its curve from: of Jazzy, it hands over the class, where newer ones want a curve."""

    SECP256R1 = ec.SECP256R1()

    def __getattr__(self, name: str) -> object:
        return getattr(ec, name)


@pytest.fixture(scope="module")
def keystore(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("keys"), POLICY)


@pytest.fixture(scope="module")
def other_keystore(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return keys of the same names by another authority, whose observer may not publish its estimate."""
    folder = tmp_path_factory.mktemp("other")
    policy = load_policy(POLICY)
    for topic in policy.xpath("//topic[text()='~/estimate']"):
        topic.getparent().remove(topic)
    policy.write(folder / "policy.xml")
    return made(folder, folder / "policy.xml")


def made(folder: Path, policy: Path) -> Path:
    """Run the command of docs/security.md."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sros2._utilities, "ec", AnyCurve())
        assert not ros2(argv=["security", "generate_artifacts", "-k", str(folder / "keys"), "-p", str(policy)])
    return folder / "keys"


@pytest.fixture
def start_secured() -> Iterator[Start]:
    """Yield a function that starts a program in an enclave of a keystore, or with neither."""
    started: list[NodeProcess] = []

    def start(words: list[str], keystore: Path | None = None, enclave: str = "") -> NodeProcess:
        ros = ["--ros-args", "--enclave", f"/ces_observer/{enclave}", "-r", f"__node:={enclave}"] if enclave else []
        started.append(NodeProcess([sys.executable, *words, *ros], security(keystore)))
        return started[-1]

    yield start
    for process in started:
        process.kill()


def security(keystore: Path | None) -> dict[str, str]:
    """Return the environment of docs/security.md."""
    if keystore is None:
        return {"ROS_SECURITY_ENABLE": "false"}
    return {"ROS_SECURITY_KEYSTORE": str(keystore), "ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}


@pytest.fixture
def observer_words(tmp_path: Path) -> list[str]:
    plain_damper(max_gap_s=0.3).save(tmp_path / "model.json")
    return ["-m", "ces_observer.nodes.observer", "--ros-args", "-p", f"model:={tmp_path / 'model.json'}", "--"]


def participant(role: str, duration_s: float = PHASE_S, enough: float = inf, stop: Path | None = None) -> list[str]:
    return [str(PARTICIPANT), role, str(duration_s), str(enough), *([str(stop)] if stop else [])]


def told(process: NodeProcess) -> Mapping[str, int]:
    """Return what a participant tells at its end."""
    status, output = process.ended()
    assert status == 0, output
    found: dict[str, int] = json.loads(output.splitlines()[-1])
    return found


def test_only_permitted_participants_drive_and_hear_the_observer(
    keystore: Path, other_keystore: Path, start_secured: Start, observer_words: list[str], tmp_path: Path
) -> None:
    observer = start_secured(observer_words, keystore, "observer")
    strangers = [
        start_secured(participant("both")),
        start_secured(participant("drive"), other_keystore, "rig"),
        start_secured(participant("hear"), keystore, "controller"),  # no estimate comes of what strangers publish
    ]
    assert [told(stranger) for stranger in strangers] == [{"heard": 0, "matched": 0}] * 3
    driver = start_secured(participant("drive", PATIENCE_S, stop=tmp_path / "stop"), keystore, "rig")
    listener = start_secured(participant("hear", PATIENCE_S, enough=101), keystore, "controller")
    assert told(listener)["heard"] > 100
    assert told(start_secured(participant("both"))) == {"heard": 0, "matched": 0}
    (tmp_path / "stop").touch()
    assert told(driver)["matched"] == 1
    observer.interrupt()
    assert observer.ended()[0] == 0


def test_no_enclave_publishes_what_its_policy_does_not_name(
    keystore: Path, other_keystore: Path, start_secured: Start, observer_words: list[str]
) -> None:
    intruder = start_secured(participant("drive"), keystore, "controller")
    muzzled = start_secured(observer_words, other_keystore, "observer")
    nobody = start_secured(observer_words, keystore, "nobody")
    status, output = intruder.ended()
    assert status != 0 and "failed to create topic [rt/joint_states]" in output
    for process, reason in ((muzzled, "topic [rt/observer/estimate]"), (nobody, "enclaves/ces_observer/nobody")):
        status, output = process.ended()
        assert status == 2
        assert [reason in line for line in output.splitlines() if "[FATAL]" in line] == [True]
        assert "Traceback" not in output


def test_nothing_listens_outside_dds(vehicle: Vehicle, start: Start) -> None:
    observer = start()
    vehicle.meets_node()
    vehicle.drive(0.3)
    domain = int(os.environ["ROS_DOMAIN_ID"])
    dds = range(7400 + 250 * domain, 7650 + 250 * domain)  # RTPS 2.5, sec. 9.6.2.3
    udp = sockets(observer.pid, "udp")
    assert udp and not sockets(observer.pid, "tcp")
    # What is bound to every address is DDS's receiving end; else a socket only sends, from one interface.
    assert all(port in dds for address, port in udp if set(address) == {"0"})


def sockets(pid: int, protocol: str) -> list[tuple[str, int]]:
    """Return hexadecimal address and port of a process's sockets of a protocol and its version 6."""
    own = {str(path.readlink()) for path in Path(f"/proc/{pid}/fd").iterdir() if path.is_symlink()}
    lines = [
        line.split()
        for name in (protocol, f"{protocol}6")
        for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]
    ]
    local = [words[1].split(":") for words in lines if f"socket:[{words[9]}]" in own]
    return [(address, int(port, 16)) for address, port in local]
