"""The results of a campaign: their names, the models on the front of cost against size, and the recommended one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ces_identify.jobs import DONE, Row, read_rows
from ces_observer.errors import CesError

COUNTED = ("terms", "units", "rules", "springs", "curves", "memberships")
COST_TOLERANCE = 0.1  # relative to the lowest selection cost: the excess allowed for a smaller model
RESULTS = "results.jsonl"
RESULT_COLUMNS = (
    "key", "status", "reason", "bags", "structure", "size", "parameters", "selection_J", "costs", "pooled", "gain",
    "force_bound_N", "seconds", "trials", "ended", "tick_us",
)  # fmt: skip
IDENTIFICATION = "identification"
COMMON_AXES = ("seed", "rate", "delay", "certificate")


@dataclass(frozen=True)
class CellNames:
    """Names cells by their structure and the settings in `varied`, and with their set of bags if there are several."""

    varied: tuple[str, ...]
    with_bags: bool

    def name(self, row: Row) -> str:
        """Return the structure of a cell and its settings that vary: polynomial, 12 terms, seed 1."""
        return ", ".join(filter(None, [row["structure"], self.settings(row)]))

    def full_name(self, row: Row) -> str:
        """Return the name of a cell with its set of bags, if there are several."""
        return f"{row['bags']}: {self.name(row)}" if self.with_bags else self.name(row)

    def settings(self, row: Row) -> str:
        """Return the settings of a cell that vary: 12 terms, seed 1."""
        return ", ".join(describe_setting(key, row) for key in self.varied if key in row)


def describe_setting(key: str, row: Row) -> str:
    """Return a setting of a row as text: 12 terms, seed 1, certificate yes."""
    value = row[key]
    if isinstance(value, bool):
        return f"{key} {'yes' if value else 'no'}"
    if key == "delay":
        return f"delay {1e3 * value:g} ms"
    return f"{value} {key}" if key in COUNTED else f"{key} {value}"


def front(rows: Sequence[Row], size: str = "parameters") -> list[Row]:
    """Return the rows that no other beats in both `size` (a column) and selection cost, smallest model first.

    All rows belong to one set of bags. Models without a certificate count only if none has one.
    """
    best: list[Row] = []
    models = [row for row in rows if row["status"] == DONE and row["selection_J"] is not None]
    models = [row for row in models if is_proved(row)] or models
    for row in sorted(models, key=lambda r: (r[size], r["selection_J"])):
        if not best or row["selection_J"] < best[-1]["selection_J"]:
            best.append(row)
    return best


def is_proved(row: Row) -> bool:
    """Return whether the row's model has a certificate."""
    return row.get("force_bound_N") is not None


def recommend_model(rows: Sequence[Row]) -> Row | None:
    """Return the smallest model on the front within 10 % of its lowest cost, None if there is no model."""
    best = front(rows)
    return next((row for row in best if row["selection_J"] <= (1.0 + COST_TOLERANCE) * best[-1]["selection_J"]), None)


@dataclass(frozen=True)
class CampaignRows:
    """The rows of a campaign's cells that have a result, of `planned` cells in all.

    `planned_names` are those of the plan; without a plan, names show the settings that differ among the rows.
    """

    rows: tuple[Row, ...]
    planned: int
    planned_names: CellNames | None = None

    @cached_property
    def done(self) -> list[Row]:
        """Cells with a model, by their selection cost."""
        rows = [row for row in self.rows if row["status"] == DONE]
        return sorted(rows, key=lambda row: (row["selection_J"] is None, row["selection_J"] or 0.0))

    @property
    def failed(self) -> list[Row]:
        """Cells without a model; `reason` says why."""
        return [row for row in self.rows if row["status"] != DONE]

    @cached_property
    def bags(self) -> list[str]:
        """Sets of bags that models were identified on."""
        return list(dict.fromkeys(row["bags"] for row in self.rows))

    @cached_property
    def sets(self) -> list[str]:
        """Sets of bags that models were validated on."""
        names = dict.fromkeys(cost["set"] for row in self.rows for cost in row.get("costs", ()))
        return [name for name in names if name != IDENTIFICATION]

    @cached_property
    def varied(self) -> list[str]:
        """Settings that differ among cells of one structure."""
        values: dict[str, dict[str, set[str]]] = {}
        for row in self.rows:
            for name in row.keys() - set(RESULT_COLUMNS):
                values.setdefault(name, {}).setdefault(row["structure"], set()).add(str(row[name]))
        names = dict.fromkeys(name for row in self.rows for name in row if name in values)
        return [name for name in names if any(len(found) > 1 for found in values[name].values())]

    @cached_property
    def names(self) -> CellNames:
        """Names of the cells."""
        return self.planned_names or CellNames(tuple(self.varied), len(self.bags) > 1)

    def of_bags(self, name: str) -> list[Row]:
        """Return the cells with a model that was identified on one set of bags."""
        return [row for row in self.done if row["bags"] == name]

    def of_delay(self, bags: str) -> dict[float, list[Row]]:
        """Return the same by their delay [s]: a model that is known at once has no rival among later ones."""
        rows = self.of_bags(bags)
        delays = sorted({row.get("delay", 0.0) for row in rows})
        return {delay: [row for row in rows if row.get("delay", 0.0) == delay] for delay in delays}

    def front_keys(self) -> set[str]:
        """Return the keys of the models on the front of their set of bags and delay."""
        return {row["key"] for name in self.bags for rows in self.of_delay(name).values() for row in front(rows)}

    def recommended(self) -> dict[str, Row]:
        """Return the recommended model of each set of bags, and of each delay if there are several."""
        found = {}
        for bags in self.bags:
            groups = self.of_delay(bags)
            for delay, rows in groups.items():
                name = f"{bags}, delay {1e3 * delay:g} ms" if len(groups) > 1 else bags
                found[name] = recommend_model(rows)
        return {name: row for name, row in found.items() if row is not None}

    def effects(self, bags: str) -> dict[str, list[tuple[str, list[float]]]]:
        """Return for each axis its values with the selection costs of their cells; sizes belong to their structure."""
        axes = {}
        for axis in ("structure", *self.varied):
            costs: dict[str, list[float]] = {}
            for row in self.of_bags(bags):
                if axis in row and row["selection_J"] is not None:
                    value = [] if axis == "structure" else [describe_setting(axis, row)]
                    value = value if axis in COMMON_AXES else [row["structure"], *value]
                    costs.setdefault(", ".join(value), []).append(row["selection_J"])
            if len(costs) > 1:
                axes[axis] = sorted(costs.items(), key=lambda item: _in_order(item[0]))
        return axes


def read_campaign(folder: Path) -> CampaignRows:
    """Return the rows in a campaign's folder; raises CesError if there are none or a line cannot be read."""
    path = folder / RESULTS
    try:
        with path.open("rb") as file:
            rows = tuple(read_rows(file, path, "a campaign").values())
    except OSError as error:
        raise CesError(f"{path}: cannot be read: {error.strerror}") from None
    if not rows or not all(isinstance(row, dict) and {"status", "bags", "structure"} <= row.keys() for row in rows):
        raise CesError(f"{path}: holds no results of a campaign; `ces identify --campaign` writes them")
    return CampaignRows(rows, len(rows))


def pooled_cost(row: Row, name: str) -> tuple[float | None, tuple[float, float] | None]:
    """Return J [%] of a row over a set of bags and its 95 % interval; None where there is none."""
    pooled = row.get("pooled", {}).get(name, {})
    interval = pooled.get("ci95")
    return pooled.get("J"), None if interval is None else (interval[0], interval[1])


def _in_order(text: str) -> list[tuple[int, float | str]]:
    """Return a key that sorts texts by the numbers in them."""
    parts = re.split(r"(\d+(?:\.\d+)?)", text)
    return [(0, float(part)) if i % 2 else (1, part) for i, part in enumerate(parts)]
