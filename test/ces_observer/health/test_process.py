"""Real-time options: in force where they are permitted, one clear reason where they are not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ces_observer.errors import CesError
from ces_observer.health.process import ALL_PROCESSORS, MAX_PRIORITY, check_processors, describe_options

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the options exist on Linux")
ROOT = Path(__file__).resolve().parent.parent.parent.parent
UNPRIVILEGED = 65534  # nobody
PROGRAM = """
import json, os, resource, sys, threading
stop = threading.Event()
threading.Thread(target=stop.wait).start()
user, priority, processors, lock, limit = json.loads(sys.argv[1])
from ces_observer.health.process import ProcessWatch
if limit is not None:
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit, limit))
if user:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    os.setuid(user)
warnings = []
watch = ProcessWatch(priority, frozenset(processors), lock, warnings.append)
watch.update()
watch.update()
threads = {int(t): os.sched_getscheduler(int(t)) & ~os.SCHED_RESET_ON_FORK for t in os.listdir("/proc/self/task")}
priorities = sorted(os.sched_getparam(t).sched_priority for t in threads)
child = os.fork()
if child == 0:
    os._exit(os.sched_getscheduler(0))
print(json.dumps({
    "warnings": warnings, "values": dict(watch.values()), "policies": sorted(set(threads.values())),
    "priorities": priorities, "child": os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]),
}))
stop.set()
"""


def apply(
    *, user: int = 0, priority: int = 0, processors: tuple[int, ...] = (), lock: bool = False, limit: int | None = None
) -> dict[str, object]:
    """Apply options in another process, as `user` (0: this one), with a limit of locked memory [bytes]."""
    words = json.dumps([user, priority, processors, lock, limit])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PROGRAM, words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    found: dict[str, object] = json.loads(done.stdout)
    return found


def may_set_priority() -> bool:
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, parameters)
    return True


needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give up its rights")


def test_nothing_is_changed_by_default() -> None:
    found = apply()
    assert (found["warnings"], found["policies"], found["priorities"]) == ([], [os.SCHED_OTHER], [0, 0])


@pytest.mark.skipif(not may_set_priority(), reason="SCHED_FIFO is not permitted here")
def test_all_threads_run_under_fifo_but_no_child() -> None:
    found = apply(priority=10)
    assert (found["warnings"], found["policies"], found["child"]) == ([], [os.SCHED_FIFO], os.SCHED_OTHER)
    assert found["priorities"] == [10, 11]
    assert found["values"]["scheduling"] == "SCHED_FIFO, priority 10"


def test_processors_that_exist_are_used() -> None:
    first = min(os.sched_getaffinity(0))
    found = apply(processors=(first,))
    assert found["warnings"] == []
    assert found["values"]["processors"] == str(first)


def test_a_processor_that_does_not_exist_is_one_warning() -> None:
    (warning,) = apply(processors=(4000,))["warnings"]
    assert "cpu_affinity 4000 is not possible" in warning


@needs_root
def test_all_that_is_not_permitted_is_one_warning_with_the_limits_to_set() -> None:
    found = apply(user=UNPRIVILEGED, priority=50, lock=True, limit=1 << 20)
    (warning,) = found["warnings"]
    assert "realtime_priority 50 is not permitted" in warning
    assert "rtprio" in warning
    assert "lock_memory is not permitted" in warning
    assert "memlock" in warning
    assert (found["policies"], found["values"]["memory locked"]) == ([os.SCHED_OTHER], "no")


@needs_root
def test_memory_is_locked_if_permitted() -> None:
    found = apply(lock=True)
    assert (found["warnings"], found["values"]["memory locked"]) == ([], "yes")


def test_what_is_in_force_is_described() -> None:
    assert [key for key, _ in describe_options()] == ["scheduling", "processors", "memory locked"]


@pytest.mark.parametrize("numbers", [[], [-2], [0, -1], [10**6]])
def test_a_wrong_list_of_processors_is_refused(numbers: list[int]) -> None:
    with pytest.raises(CesError, match="expected numbers of processors"):
        check_processors(numbers)


def test_lists_of_processors() -> None:
    assert check_processors(ALL_PROCESSORS) == frozenset()
    assert check_processors([3, 2, 3]) == {2, 3}
    assert MAX_PRIORITY + 1 <= 99
