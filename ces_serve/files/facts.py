"""What a list shows of each kind of thing: its main file goes in, a few facts come out.

Every function raises UnreadableError, or one of WRONG_CONTENT for a file whose values are not those that our programs
write. Costs are in percent, forces in N, lengths in m.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from html import unescape
from math import isfinite
from pathlib import Path
from typing import Any

from ces_observer.model import load_model
from ces_observer.proof.certificate import summarize
from ces_serve.files.bounded_reading import Json, UnreadableError, read_head, read_json, read_rows

Facts = dict[str, Any]
WRONG_CONTENT = (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError)
DONE = "done"
POLYNOMIAL = "polynomial_narx"
TITLE = re.compile(rb"<title>(.*?)</title>", re.DOTALL)
METADATA = {
    "seconds": re.compile(rb"duration:\s*\n\s*nanoseconds:\s*(\d+)"),
    "messages": re.compile(rb"\n  message_count:\s*(\d+)"),
}
METADATA_BYTES = 200_000


def model_facts(path: Path) -> Facts:
    """Return the facts of a model file."""
    content = read_json(path)
    provenance = content.get("provenance") or {}
    costs = provenance.get("cost_J_percent") or []
    validation, fit = (_mean(c["J"] for c in costs if c["role"] == role) for role in ("validation", "identification"))
    certificate = content["certificate"]
    facts: Facts = {
        "structure": structure_name(content["structure"]),
        "size": _size(content, path),
        "cost_J": validation,
        "fit_J": fit,
        "rate_Hz": float(content["sampling"]["rate_Hz"]),
        "recordings": [str(one["recording"]) for one in provenance.get("identification") or []],
        "validation": [str(one["recording"]) for one in provenance.get("validation") or []],
        "certificate": "not proved" if certificate is None else summarize(certificate),
        "proved": certificate is not None,
    }
    facts["search"] = " ".join([*facts["recordings"], *facts["validation"]])
    facts["summary"] = f"{facts['structure']}, {facts['size']}"
    return facts


def report_facts(path: Path) -> Facts:
    """Return the facts of a report page."""
    found = TITLE.search(read_head(path))
    title = unescape(found[1].decode("utf-8", "replace")).strip() if found else path.name
    return {"title": title, "summary": title}


def campaign_facts(path: Path) -> Facts:
    """Return the facts of a campaign's results."""
    rows = read_rows(path)
    done = [row for row in rows if row["status"] == DONE]
    costs = [float(row["selection_J"]) for row in done if row["selection_J"] is not None]
    structures = sorted({str(row["structure"]) for row in done})
    counts = f"{len(done)} models" + (f", {len(rows) - len(done)} failed" if len(done) < len(rows) else "")
    return {
        "count": len(done),
        "failed": len(rows) - len(done),
        "structures": structures,
        "selection_J": min(costs, default=None),
        "summary": f"{counts}: {', '.join(structures)}",
    }


def diagnosis_facts(path: Path) -> Facts:
    """Return the facts of a diagnosis."""
    content = read_json(path)
    gap, after = content["gap"], content["composition"]["gap_after_N"]
    return {
        "verdict": str(content["verdict"]).replace("_", " "),
        "effects": [str(effect).replace("_", " ") for effect in content["composition"]["effects"]],
        "gap_N": number(gap["rms_N"]),
        "after_N": number(after),
        "cost_J": number(gap["cost_J"]),
        "simulation": str(content.get("simulation", "")),
        "summary": str(content["sentence"]),
    }


def fleet_facts(path: Path) -> Facts:
    """Return the facts of a fleet's diagnoses."""
    rows = read_rows(path)
    verdicts = Counter(str(row["verdict"]).replace("_", " ") for row in rows if row["status"] == DONE)
    gaps = [row["gap_N"] for row in rows if row["status"] == DONE and row["gap_N"] is not None]
    return {
        "count": len(rows),
        "largest_gap_N": max(map(float, gaps), default=None),
        "summary": f"{len(rows)} units: "
        + (", ".join(f"{n} {v}" for v, n in verdicts.most_common()) or "none diagnosed"),
        "search": " ".join(str(row["name"]) for row in rows),
    }


def iteration_facts(path: Path) -> Facts:
    """Return the facts of an iteration."""
    rows = read_rows(path)
    if not rows:
        return {"count": 0, "summary": "no iteration finished yet"}
    last = rows[-1]
    fresh = number(last["fresh_J"])
    said = "" if fresh is None else f", J {fresh:.2f} % on the last fresh recording"
    return {
        "count": len(rows),
        "recorded_s": float(last["total_s"]),
        "fit_J": float(last["fit_J"]),
        "fresh_J": fresh,
        "cost_J": fresh,
        "coverage": float(last["coverage"]),
        "summary": f"{len(rows)} iterations, {float(last['total_s']):.0f} s recorded{said}",
    }


def stroke_facts(path: Path) -> Facts:
    """Return the facts of a learned stroke."""
    content = read_json(path)
    first, confirmed = float(content["first_error_m"]), float(content["confirmed_error_m"])
    return {
        "stopped": str(content["stopped"]),
        "count": int(content["iterations"]),
        "first_m": first,
        "confirmed_m": confirmed,
        "summary": f"error {1e3 * first:.3f} mm before, {1e3 * confirmed:.3f} mm after; {content['stopped']}",
    }


def recording_facts(path: Path) -> Facts:
    """Return the facts of a bag without opening it: a rosbag2 folder, or a bag file."""
    files = [one for one in path.iterdir() if one.is_file()] if path.is_dir() else [path]
    facts: Facts = {"bytes": sum(one.stat().st_size for one in files), "seconds": None, "messages": None}
    if path.is_dir():
        raw = read_head(path / "metadata.yaml", METADATA_BYTES)
        found = {name: pattern.search(raw) for name, pattern in METADATA.items()}
        seconds, messages = found["seconds"], found["messages"]
        facts["seconds"] = int(seconds[1]) * 1e-9 if seconds else None
        facts["messages"] = int(messages[1]) if messages else None
    length = "" if facts["seconds"] is None else f"{facts['seconds']:.1f} s, "
    return {**facts, "summary": f"{length}{facts['bytes'] / 1e6:.1f} MB"}


def structure_name(name: str) -> str:
    """Return a structure's name as in the option --structure."""
    return str(name).removesuffix("_narx")


def number(value: object) -> float | None:
    """Return a finite number, None for null; raises UnreadableError for anything else."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise UnreadableError("a value is not a number")
    return float(value)


def _mean(costs: Iterable[Any]) -> float | None:
    values = [value for value in map(number, costs) if value is not None]
    return sum(values) / len(values) if values else None


def _size(content: Mapping[str, Any] | Json, path: Path) -> str:
    """Return a model's size in words; a polynomial's without the proof of its bounds, which takes milliseconds."""
    if content["structure"] == POLYNOMIAL:
        return f"{len(content['terms'])} terms"
    return load_model(path).size
