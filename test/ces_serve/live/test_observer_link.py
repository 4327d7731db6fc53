"""The link to the listening process: without ROS one line; with it, one process for all clients that ends with them."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from patience import command_of, wait_until

from ces_serve.live import link
from ces_serve.live.link import ObserverLink, find_python

LISTENER = """\
import json, os, sys, threading, time
threading.Thread(target=lambda: (os.read(0, 1), os._exit(0)), daemon=True).start()
open({log!r}, "a").write(f"{{os.getpid()}}\\n")
def send(message):
    sys.stdout.write(json.dumps(message) + "\\n"); sys.stdout.flush()
send({{"topics": ["/observer/estimate"]}})
for number in range({count}):
    send({{"number": number}}); time.sleep(0.002)
"""


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Let a script without ROS be the listening process; yield the file with the number of each process."""
    monkeypatch.setattr(link, "find_python", lambda: sys.executable)
    monkeypatch.setattr(link, "LISTENER", "some_listener")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    write_listener(tmp_path, 10**9)
    yield tmp_path / "log"


def write_listener(folder: Path, count: int) -> None:
    (folder / "some_listener.py").write_text(LISTENER.format(log=str(folder / "log"), count=count))


def next_of(messages: Iterator[dict[str, Any]]) -> dict[str, Any]:
    """Return the next message that is not empty."""
    return next(filter(None, messages))


def test_without_ros_there_is_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    find_python.cache_clear()
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert list(ObserverLink().messages()) == [{"missing": link.NOT_SOURCED}]
    find_python.cache_clear()


def test_clients_share_one_process_and_it_ends_with_the_last(log: Path) -> None:
    observers = ObserverLink()
    first, second = observers.messages(), observers.messages()
    assert next_of(first) == {"topics": ["/observer/estimate"]}
    assert "number" in next_of(first)
    assert next_of(second) == {"topics": ["/observer/estimate"]}  # who joins later hears it, too
    assert "number" in next_of(second)
    pids = log.read_text().split()
    assert len(pids) == 1
    first.close()
    assert command_of(pids[0])
    assert "number" in next_of(second)
    second.close()
    assert not command_of(pids[0])


def test_a_process_that_ends_by_itself_is_said(log: Path, tmp_path: Path) -> None:
    write_listener(tmp_path, 3)
    messages = list(ObserverLink().messages())
    assert [message["number"] for message in messages if "number" in message] == [0, 1, 2]
    assert "ended with status 0" in messages[-1]["ended"]
    assert json.dumps(messages)


def test_a_new_process_has_no_topics_of_the_one_before(log: Path, tmp_path: Path) -> None:
    observers = ObserverLink()
    before = observers.messages()
    assert next(before) == {"topics": ["/observer/estimate"]}
    before.close()
    script = tmp_path / "some_listener.py"
    script.write_text(script.read_text().replace('send({"topics": ["/observer/estimate"]})\n', ""))
    first, second = observers.messages(), observers.messages()
    assert "number" in next(first)
    assert "number" in next(message for message in second if message)
    first.close()
    second.close()


def test_a_client_that_does_not_read_loses_the_oldest_only(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "MAX_WAITING", 5)
    messages = ObserverLink().messages()
    assert "topics" in next_of(messages)
    numbers: list[int] = []

    def has_lost_some() -> bool:
        numbers.append(next_of(messages)["number"])
        return numbers[-1] >= len(numbers)  # it waits longer between two reads than the sender between two messages

    wait_until(has_lost_some)
    assert numbers == sorted(set(numbers))
    messages.close()
