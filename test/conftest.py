"""What all tests share: one line for each reason to skip, and limits of time that hold on a busy computer."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy: beside other work, several threads cost minutes

import pytest
from needs import skip_without
from shared_results import SharedResults, common_folder, diagnose_once, identify_once

signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs of a shell (&), and what they start, ignore it

with suppress(ImportError):  # as beside ROS 2
    from hypothesis import HealthCheck, settings

    settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("busy")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test where a program that its mark `needs` names is missing."""
    for mark in item.iter_markers("needs"):
        skip_without(*mark.args)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print one line for each reason to skip, whatever the number of tests."""
    reports = terminalreporter.stats.get("skipped", [])
    reasons = Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in reports)
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"skipped {count}: {reason}")


@pytest.fixture(scope="session", autouse=True)
def busy_search_clock() -> Iterator[pytest.MonkeyPatch]:
    """Let the clock of searches in this process stand still while the computer is busy with other work."""
    from busy_clock import BusyClock

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ces_identify.numerics.search.time", BusyClock())
        yield patch


@pytest.fixture(scope="session", autouse=True)
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what programs store between calls, such as twins of simulations, with the results of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(common_folder(tmp_path_factory) / "cache"))
        yield


@pytest.fixture(scope="session")
def shared_model(tmp_path_factory: pytest.TempPathFactory) -> SharedResults:
    """Bags, and the model of one with its page, as `ces identify` writes them: made once, and read-only."""
    return identify_once(tmp_path_factory)


@pytest.fixture(scope="session")
def shared_gap(tmp_path_factory: pytest.TempPathFactory) -> SharedResults:
    """The same and a diagnosis, as `ces diagnose` writes it: made once, and read-only."""
    return diagnose_once(tmp_path_factory)
