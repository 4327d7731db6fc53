"""What the log says of reasons that last, flicker or flood."""

from __future__ import annotations

from ces_observer.health.log_lines import LineLimit, ReasonLog
from ces_observer.reasons import OK, OUTLIER


def test_a_state_is_one_line_at_its_begin_and_one_at_its_end() -> None:
    log = ReasonLog()
    lines = [
        log.find_line(0.1 * k, OUTLIER if 50 <= k < 150 else OK, "M", (k >= 50) + (k >= 150), 0) for k in range(300)
    ]
    assert [k for k, line in enumerate(lines) if line] == [0, 50, 150]


def test_the_end_says_how_many_samples_were_withheld() -> None:
    log = ReasonLog()
    log.find_line(0.0, OUTLIER, "withholding", 1, 1)
    assert log.find_line(10.0, OK, "estimating", 2, 501) == "estimating; 500 samples withheld"


def test_a_reason_that_flickers_is_one_line_at_its_begin_and_one_when_it_is_quiet() -> None:
    log, lines = ReasonLog(), {}
    for k in range(1000):  # two hundred seconds; in 75 of them two changes between two reports
        flickers = 100 <= k < 700
        reason, changes = (OUTLIER if flickers and k % 2 else OK), 2 * min(max(0, k - 100), 600)
        if line := log.find_line(0.125 * k, reason, reason, changes, 3 * changes):
            lines[k] = line
    assert list(lines) == [0, 101, 708]
    assert lines[708] == "ok; 1198 changes since the last line; 3594 samples withheld"


def test_lines_of_a_flood_are_counted_and_told_when_it_is_over() -> None:
    heard, now = list[str](), [0.0]
    limit = LineLimit(heard.append, lambda: now[0])
    for k in range(500):
        now[0] = 0.01 * k
        limit(f"line {k}")
        limit.flush()
    assert heard == ["line 0"]
    now[0] += 1.0
    limit.flush()
    limit.flush()
    assert heard == ["line 0", "line 499; the last of 499 such lines"]
    now[0] += 5.0
    limit("another")
    assert heard[-1] == "another"
