"""The candidates in bags: every number in every topic, the same field of several bags as one series."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ces_identify.proposal.candidate import Candidate
from ces_identify.recordings.topic_fields import BagFields, FieldSeries, read_fields
from ces_identify.recordings.units import split_unit
from ces_observer.errors import RecordingError

BETWEEN_BAGS_NS = 10_000_000_000


@dataclass(frozen=True)
class BagCandidates:
    """The candidates, and the topics that were not examined with the reason."""

    candidates: tuple[Candidate, ...]
    skipped: dict[str, str]


def find_bag_candidates(paths: Sequence[Path]) -> BagCandidates:
    """Return the candidates that all bags have; raises RecordingError if there are none."""
    bags = [read_fields(path) for path in paths]
    common = set.intersection(*({(s.topic, s.type, s.field) for s in bag.series} for bag in bags))
    if not common:
        names = ", ".join(str(path) for path in paths)
        raise RecordingError(f"{names}: no numbers in {'any topic' if len(paths) == 1 else 'a topic that all have'}")
    offsets = _offsets(bags)
    order = [(s.topic, s.type, s.field) for s in bags[0].series if (s.topic, s.type, s.field) in common]
    keys = sorted(order, key=lambda key: key[0])  # by topic; within a message as its fields come
    series = [{(s.topic, s.type, s.field): s for s in bag.series} for bag in bags]
    found = tuple(_candidate([one[key] for one in series], offsets) for key in keys)
    return BagCandidates(found, {name: why for bag in bags for name, why in bag.skipped.items()})


def _offsets(bags: Sequence[BagFields]) -> list[int]:
    """Return what to add to the stamps of each bag [ns] so that one follows the other."""
    offsets, end = [], 0
    for bag in bags:
        first = min(int(series.stamps_ns.min()) for series in bag.series)
        last = max(int(series.stamps_ns.max()) for series in bag.series)
        offsets.append(end - first)
        end += last - first + BETWEEN_BAGS_NS
    return offsets


def _candidate(parts: Sequence[FieldSeries], offsets: Sequence[int]) -> Candidate:
    first = parts[0]
    stamps = np.concatenate([part.stamps_ns + offset for part, offset in zip(parts, offsets, strict=True)])
    field_name, unit = (
        split_unit(first.field.replace("[", "_").replace("]", "")) if "[" in first.field else split_unit(first.field)
    )
    topic_name, topic_unit = split_unit(first.topic)
    where = "from the field's name" if unit else "from the topic's name"
    return Candidate(
        label=f"{first.topic} {first.field}",
        names=(field_name, topic_name, first.type.rpartition("/")[2]),
        stamps_ns=stamps,
        values=np.concatenate([part.values for part in parts]),
        kind=first.type,
        topic=first.topic,
        field=first.field,
        unit=unit or topic_unit,
        stated=where if unit or topic_unit else "",
    )
