"""Copies and parts of a recording are recognised, however they are stored; other recordings are not taken for them."""

from dataclasses import replace

import numpy as np
import pytest
from made_recordings import recording_of

from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.content import (
    find_known_recording,
    marks_of_copies,
    recording_marks,
    require_distinct,
    require_once,
    select_new,
    shared_content,
)
from ces_data.recording import Channel, Recording
from ces_data.tables import tabulate
from ces_observer.errors import RecordingError
from ces_observer.signals import Signals

START = 10**18
RATE = 1000
OTHER_TOPICS = Signals.from_mapping(
    {
        "position": {"topic": "rig/x", "type": "std_msgs/msg/Float64", "field": "data", "scale": 0.001},
        "current": {"topic": "rig/i", "type": "std_msgs/msg/Float32", "field": "data"},
        "force": {"topic": "rig/f", "type": "std_msgs/msg/Float32", "field": "data", "scale": 1000.0},
    },
    "test",
)


def made(name="run", seed=1, stroke_seed=None, seconds=8.0, start_ns=START):
    """Return a recording of a noisy viscous damper; `stroke_seed` gives two of them the same stroke."""
    t = np.arange(round(seconds * RATE)) / RATE
    dice, shared = np.random.default_rng(seed), np.random.default_rng(seed if stroke_seed is None else stroke_seed)
    stroke = 0.02 * np.sin(4 * np.pi * t)
    x = stroke + shared.normal(0, 1e-5, len(t))
    force = 3000.0 * np.gradient(stroke, t) + dice.normal(0, 8.0, len(t))
    current = 0.5 + dice.normal(0, 1e-3, len(t))
    return replace(recording_of(t, name, start_ns, position=x, current=current, force=force), source=f"bags/{name}")


def part(recording, first_s, last_s, shift_ns=0):
    stamps = recording.channel("position").stamps_ns
    origin = stamps[0]
    inside = (stamps >= origin + first_s * 1e9) & (stamps < origin + last_s * 1e9)
    channels = {
        n: replace(c.select(inside), stamps_ns=c.stamps_ns[inside] + shift_ns) for n, c in recording.channels.items()
    }
    return replace(recording, name="part", source="bags/part", channels=channels)


def test_copies_and_parts_are_recognised_whatever_their_name_and_time():
    for copy in (made("copy"), made("copy", start_ns=0)):
        assert str(shared_content(made(), copy)) == "the same recording"
    for first, second, seconds in (
        (made(), part(made(), 2.0, 5.0, 10**15 + 1234), 3.0),
        (part(made(), 0.0, 5.0), part(made(), 4.0, 8.0), 1.0),
    ):
        shared = shared_content(first, second)
        assert not shared.whole and shared.seconds == pytest.approx(seconds, abs=0.01)
    assert shared_content(part(made(), 0.0, 4.0), part(made(), 4.0, 8.0)) is None


def resampled(recording, hz):
    stamps = recording.channel("position").stamps_ns
    new = np.arange(stamps[0], stamps[-1], round(1e9 / hz))
    at, known = ((some - stamps[0]).astype(float) for some in (new, stamps))
    channels = {
        n: replace(c, stamps_ns=new, values=np.interp(at, known, c.values)) for n, c in recording.channels.items()
    }
    return replace(recording, name="resampled", channels=channels)


@pytest.mark.parametrize("hz", [250, 2718])
def test_a_copy_at_another_rate_is_the_same(hz):
    shared = shared_content(made(), resampled(made(), hz))
    assert shared is not None and shared.seconds == pytest.approx(8.0, abs=0.02)
    assert shared_content(made(seed=2, stroke_seed=1), resampled(made(stroke_seed=1), hz)) is None


def test_a_copy_with_other_topics_units_and_precision_is_the_same(tmp_path):
    original = made()
    write_bag(tmp_path / "encoded", recording_topics(original, OTHER_TOPICS))
    again = read_recording(tmp_path / "encoded", OTHER_TOPICS)
    assert again.sha256 and not np.array_equal(again.channel("force").values, original.channel("force").values)
    assert shared_content(original, again).whole


def test_another_recording_of_the_same_time_or_stroke_is_another():
    """Two dampers recorded at once, the same test once more, and logs that all start at zero."""
    for other in (made(seed=2), made(seed=2, stroke_seed=1), made(seed=2, start_ns=0), made(seed=2, seconds=12.0)):
        assert shared_content(made(), other) is None
        assert shared_content(other, made(start_ns=0)) is None


def test_standstill_at_the_same_time_is_nothing_in_common():
    def resting(name, seed, move):
        one = made(name, seed)
        still = np.arange(8 * RATE) < 4 * RATE
        channels = {n: replace(c, values=np.where(still, 0.0, move * c.values)) for n, c in one.channels.items()}
        return replace(one, channels=channels)

    assert shared_content(resting("a", 1, 1.0), resting("b", 2, 1.1)) is None


def test_hardly_any_samples_have_nothing_in_common():
    few = made()
    few = replace(few, channels={n: c.select(np.arange(len(c)) < 20) for n, c in few.channels.items()})
    assert shared_content(made(seed=3), few) is None
    assert recording_marks(few) == []
    assert shared_content(Recording("bare", {}), made()) is None


def test_seconds_in_common_are_refused_by_name():
    require_once([made("one", seed=1), made("two", seed=2)])
    with pytest.raises(RecordingError, match="s of one recording: its seconds would count twice"):
        require_once([made(), part(made(), 2.0, 5.0)])
    require_distinct([made("a"), made("b", 2)], [made("c", 3)])
    with pytest.raises(RecordingError, match=r"bags/a and bags/b: the same recording, twice for identification"):
        require_distinct([made("a"), made("b")])
    with pytest.raises(RecordingError, match=r"bags/a: the same recording, for identification and for validation"):
        require_distinct([made("a")], [made("a")])
    with pytest.raises(
        RecordingError, match=r"bags/a and bags/part: share 2\.0 s of one recording, for identification and"
    ):
        require_distinct([made("a"), made("b", 2)], [part(made("a"), 1.0, 3.0, -START)])


def test_a_model_knows_copies_and_parts_of_what_it_was_identified_on():
    whole = made("first", seconds=20.0)
    used = {
        "recording": "first",
        "sha256": "",
        "share": [0.0, 0.5],
        "marks": " ".join(recording_marks(whole.share(0.0, 0.5))),
    }
    provenance = {"identification": [used]}
    assert find_known_recording(made("renamed", seconds=20.0), provenance) == "first"
    assert find_known_recording(part(whole, 2.0, 8.0), provenance) == "first"
    assert find_known_recording(made("renamed", seconds=20.0).part(10.0), provenance) == ""
    assert find_known_recording(part(whole, 11.0, 20.0), provenance) == ""
    assert find_known_recording(made("other", 2), provenance) == ""


def test_a_model_knows_a_copy_that_went_through_a_table():
    """A table holds the force at the position's times; a part of it is still recognised, another run is not."""
    whole = made("first", seconds=20.0)
    late = replace(whole.channels["force"], stamps_ns=whole.channels["force"].stamps_ns + 300_000)
    apart = replace(whole, channels={**whole.channels, "force": late})
    force = next(column for column in tabulate(apart, {}).columns if column.name == "force_interp_N")
    kept = ~force.missing
    position = apart.channels["position"].select(kept)
    table = replace(
        apart, channels={"position": position, "force": Channel("force", "N", position.stamps_ns, force.values[kept])}
    )
    known = {"identification": [{"recording": "first", "sha256": "", "marks": " ".join(marks_of_copies(apart))}]}
    assert find_known_recording(table, known) == "first" and find_known_recording(apart, known) == "first"
    assert find_known_recording(part(table, 5.0, 12.0), known) == "first"
    assert find_known_recording(made("other", 2, seconds=20.0), known) == ""
    assert marks_of_copies(whole) == recording_marks(whole)  # the same stamps: one set of marks


def test_older_model_files_know_the_bytes_of_their_bags():
    def known(given, sha256="a1"):
        return find_known_recording(replace(made(), sha256=sha256), {"identification": given})

    row = {"recording": "first", "sha256": "a1", "share": [0.0, 0.5]}
    assert (known([row]), known([row], "b2")) == ("first", "")
    assert known([{"recording": "old", "sha256": "a1"}]) == "old"
    for damaged in (None, "a1", [1, "a1"], [{"marks": "zz 12"}, {"marks": 3, "sha256": 4}]):
        assert known(damaged) == ""


def test_of_known_recordings_nothing_is_new_and_their_parts_are_refused():
    whole, other = made("whole", seconds=20.0), made("other", 2)
    assert select_new([replace(whole, name="copy"), other], [whole]) == [other]
    with pytest.raises(
        RecordingError, match=r"bags/part and bags/whole: share 6.0 s .*would count twice; give it once"
    ):
        select_new([part(whole, 2.0, 8.0)], [whole])
