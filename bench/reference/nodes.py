"""The page of nodes: parameters from their tables, topics and services from the security policy, diagnostics' keys."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from bench.reference.tables import as_text, codes, span, table
from ces_cli.identify.options import EXIT_WHEN_DONE
from ces_observer.nodes import parameter_table
from ces_observer.options import Option
from ces_rig.live.rig import OF_THE_NODE as OF_THE_RIG_NODE
from ces_rig.live.rig import OF_THE_RIG

POLICY = Path(__file__).resolve().parents[2] / "config" / "security" / "policy.xml"
UNIT = re.compile(r" \[([^\],]+)\]")
HEAD = """
Parameters are in the files of `config/`, with advice. † marks those that may change while the node runs. Names of
topics without `/` are in the node's namespace; topics of the signals are those of the signals file.
"""
NODES = {  # and what each does
    "observer": "Estimates the force from position and current.",
    "controller": "Commands the current that gives a wanted force.",
    "rig": "The virtual rig in real time (synthetic data).",
    "identify": "Identifies a model and publishes it.",
}
SIGNALS = "`position`, `current`, `force`, `temperature`, `speed`, `acceleration`, each with"
DIAGNOSTICS = (
    ("reason", "ok, or why the force is withheld: the estimator's reason"),
    ("rate [Hz]", "position samples per second"),
    ("age of the last position on arrival [s]", "clock of the node minus its stamp"),
    ("share outside the envelope", "of the forces of the last second; what becomes of such inputs follows"),
    ("position samples, forces estimated", "since the start"),
    ("messages without the field", "received messages in which the signal's field is missing"),
    ("withheld: REASON", "forces withheld, by reason"),
    ("episodes of withholding", "their number; by reason with total length; the last ones"),
    ("position has not changed", "times, and how long: vehicle at rest, or stuck sensor"),
    ("latency from stamp to publish [ms]", "p50, p99, max of the last second"),
    ("process load, executor load [% of a core]", "of the node; of its callbacks"),
    ("INPUT: rate, age, jitter, longest interval, longest burst", "of each input in the last second"),
    ("INPUT: dropped", "samples missing between stamps: in this node's queue, lost on the way, not sent"),
    ("INPUT: out of order, duplicates, interruptions", "since the start"),
    ("datagrams dropped by the kernel", "the receive buffer was full"),
    ("running cost J [%], threshold of J [%]", "against the measured force, if there is one"),
    ("snapshot", "what became of the last request for a recording"),
    ("model, SHA-256", "what runs, and how the last change went"),
    ("scheduling, processors, memory locked", "the real-time options in force"),
    ("unexpected errors", "exceptions in callbacks, and the last one"),
)


def nodes_page() -> str:
    """Return the page."""
    wanted = parameter_table
    tables: dict[str, tuple[Option, ...]] = {
        "observer": (*wanted.OF_THE_NODE, *wanted.OF_A_DAMPER, wanted.NAME),
        "controller": wanted.OF_THE_CONTROLLER,
        "rig": (*OF_THE_RIG_NODE, *OF_THE_RIG),
        "identify": (EXIT_WHEN_DONE,),
    }
    text = ["# Nodes", HEAD]
    for name, about in NODES.items():
        text += [f"## `{name}`\n\n{about}\n", _topics(name)]
        text.append(table(("parameter", "default", "range", "meaning"), map(_row, tables[name])))
        if name == "observer":
            text.append(f"`{wanted.DAMPERS}`: {wanted.DAMPERS_MEANING}. Signals: {SIGNALS}\n")
            text.append(table(("key", "meaning"), ((f"`{key}`", about) for key, about in wanted.SIGNAL_KEYS.items())))
        if name == "identify":
            text.append("`bags` and all [options of `ces identify`](programs.md#identify), with `_` for `-`.\n")
    keys = ((f"`{key}`", about) for key, about in DIAGNOSTICS)
    return "\n".join([*text, "## Keys of `/diagnostics`\n", table(("key of the observer", "meaning"), keys)])


def _topics(name: str) -> str:
    root = ElementTree.parse(POLICY).getroot()
    profile = next(p for p in root.iter("profile") if p.get("node") == name)
    words = {"publish": "Publishes", "subscribe": "subscribes to", "reply": "services"}
    found = []
    for group in profile:
        for kind, word in words.items():
            if group.get(kind) == "ALLOW" and group.tag in ("topics", "services"):
                names: Iterable[str] = (one.text or "" for one in group)
                found.append(f"{word} {codes(one.replace('~/*', '~/NAME') for one in names)}")
    return "; ".join(found) + ".\n"


def _row(option: Option) -> tuple[str, str, str, str]:
    meaning = option.described
    unit = UNIT.search(meaning)
    limits = ", ".join(option.choices) or span(option.low, option.high)
    if unit and not option.choices:
        meaning, limits = UNIT.sub("", meaning, count=1), f"{limits} {unit[1] if unit[1] != '1' else ''}".strip()
    mark = " †" if option.live else ""
    default = as_text(option.default)
    return f"`{option.name}`{mark}", f"`{default}`" if default else "", limits, meaning
