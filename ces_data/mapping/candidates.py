"""A candidate: one series of numbers in a bag or log that may be a signal, with what its numbers look like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ces_data.bags.fields import FieldSeries, read_fields
from ces_data.recording import Stamps, Values
from ces_data.units import Unit, split_unit
from ces_observer.errors import RecordingError

STEADY_SHARE = 0.5  # of the steps between samples that are zero: a current that is held, not a motion
ROUGH = 1.0  # ratio of the RMS step to the standard deviation; white noise has 1.41


@dataclass(frozen=True, eq=False)
class Candidate:
    """One series: `stamps_ns` int64 and `values` float64, both (n,), with at least one finite value.

    `label` names it for people. `names` are the texts whose words say what it is, the most specific first: the field's
    and the topic's, or the column's alone. `kind` is the message type, empty in a log. `unit` is the stated one, and
    `stated` says where.
    """

    label: str
    names: tuple[str, ...]
    stamps_ns: Stamps
    values: Values
    kind: str = ""
    topic: str = ""
    field: str = ""
    unit: Unit | None = None
    stated: str = ""

    @cached_property
    def finite(self) -> Values:
        """The finite values."""
        there = np.isfinite(self.values)
        return self.values if there.all() else np.asarray(self.values[there])

    @cached_property
    def span(self) -> float:
        """Distance from the 1st to the 99th percentile, which ignores outliers."""
        low, high = np.percentile(self.finite, (1.0, 99.0))
        return float(high - low)

    @cached_property
    def peak(self) -> float:
        """99th percentile of the magnitude."""
        return float(np.percentile(np.abs(self.finite), 99.0))

    @property
    def low(self) -> float:
        """Smallest finite value."""
        return float(self.finite.min())

    @property
    def high(self) -> float:
        """Largest finite value."""
        return float(self.finite.max())

    @property
    def constant(self) -> bool:
        """True if all finite values are equal."""
        return self.low == self.high

    @cached_property
    def counts_up(self) -> bool:
        """True for a time or a counter: every step goes up by about as much."""
        steps = np.diff(self.finite)
        return bool(len(steps) > 2 and (steps > 0.0).all() and steps.max() < 100.0 * np.median(steps))

    @cached_property
    def held(self) -> bool:
        """True if the number changes in steps and is held between them."""
        steps = np.diff(self.finite)
        return bool(not self.constant and (steps == 0.0).mean() > STEADY_SHARE)

    @cached_property
    def rough(self) -> bool:
        """True if the samples jump about like noise instead of moving like a stroke."""
        steps = np.diff(self.finite)
        spread = float(self.finite.std())
        return bool(len(steps) > 0 and spread > 0.0 and np.sqrt(np.mean(steps**2)) > ROUGH * spread)

    @cached_property
    def rate_Hz(self) -> float:
        """Mean rate; 0 if the span of the stamps is empty."""
        span = int(self.stamps_ns.max() - self.stamps_ns.min()) if len(self.stamps_ns) else 0
        return (len(self.stamps_ns) - 1) * 1e9 / span if span else 0.0


BETWEEN_BAGS_NS = 10_000_000_000


def find_bag_candidates(paths: Sequence[Path]) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Return the candidates that all bags have, one bag after the other, and why topics were not examined.

    Raises RecordingError if there are none.
    """
    bags = [read_fields(path) for path in paths]
    series = [{(s.topic, s.type, s.field): s for s in bag.series} for bag in bags]
    common = [key for key in series[0] if all(key in one for one in series)]
    if not common:
        names = ", ".join(str(path) for path in paths)
        raise RecordingError(f"{names}: no numbers in {'any topic' if len(paths) == 1 else 'a topic that all have'}")
    offsets, end = [], 0
    for bag in bags:
        first = min(int(one.stamps_ns.min()) for one in bag.series)
        last = max(int(one.stamps_ns.max()) for one in bag.series)
        offsets.append(end - first)
        end += last - first + BETWEEN_BAGS_NS
    keys = sorted(common, key=lambda key: key[0])  # by topic; within a message as its fields come
    found = tuple(_join([one[key] for one in series], offsets) for key in keys)
    return found, {name: why for bag in bags for name, why in bag.skipped.items()}


def _join(parts: Sequence[FieldSeries], offsets: Sequence[int]) -> Candidate:
    """Return the candidate of a field, the stamps of each bag moved by its offset [ns]."""
    first = parts[0]
    field_name, unit = split_unit(first.field.replace("[", "_").replace("]", ""))
    topic_name, topic_unit = split_unit(first.topic)
    where = "from the field's name" if unit else "from the topic's name"
    return Candidate(
        label=f"{first.topic} {first.field}",
        names=(field_name, topic_name, first.type.rpartition("/")[2]),
        stamps_ns=np.concatenate([part.stamps_ns + offset for part, offset in zip(parts, offsets, strict=True)]),
        values=np.concatenate([part.values for part in parts]),
        kind=first.type,
        topic=first.topic,
        field=first.field,
        unit=unit or topic_unit,
        stated=where if unit or topic_unit else "",
    )
