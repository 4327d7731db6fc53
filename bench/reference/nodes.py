"""The page of nodes: parameters from their tables, topics and services from the security policy, diagnostics' keys."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

from bench.reference.tables import as_text, codes, span, table
from ces_cli.identify.request import EXIT_WHEN_DONE
from ces_observer.control.control_loop import KEYS as CONTROLLER_KEYS
from ces_observer.health.diagnostics import Figure, Figures
from ces_observer.health.health import KEYS as OBSERVER_KEYS
from ces_observer.nodes import parameter_table
from ces_observer.options import Option
from ces_rig.live.rig import OF_THE_NODE as OF_THE_RIG_NODE
from ces_rig.live.rig import OF_THE_RIG

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "config" / "security" / "policy.xml"
UNIT = re.compile(r" \[(?!-)([^\],]+)\]")
HEAD = """
Parameters are in the files of `config/`, with advice. † marks those that may change while the node runs. Names of
topics without `/` are in the node's namespace; topics of the signals are those of the signals file.
"""
NODES = {  # and what each does
    "observer": "Estimates the force from position and current.",
    "controller": "Commands the current that gives a wanted force.",
    "rig": "The virtual rig in real time (synthetic data).",
    "identify": "Identifies a model, writes its file and publishes its costs.",
}
SIGNALS = (
    "`position`, `current`, `force`, `temperature`, `speed`, `acceleration`, each with `topic`, `type`, `field`, "
    "`scale`, `offset` and `delay` ([meaning](files.md#signals))."
)
OF_THE_PROCESS = (
    "model",
    "model sha256",
    "delay_s",
    "computed by",
    "last change of the model",
    "models refused",
    "datagrams dropped by the kernel",
    "state",
    "unexpected errors",
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
    text, described = ["# Nodes", HEAD], set[str]()
    for name, about in NODES.items():
        text += [f"## `{name}`\n\n{about}\n", _topics(name)]
        text.append(table(("parameter", "default", "range", "meaning"), _rows(tables[name], described)))
        if name == "observer":
            text.append(f"`{wanted.DAMPERS}`: {wanted.DAMPERS_MEANING}. Signals: {SIGNALS}\n")
        if name == "identify":
            text.append("`bags` and all [options of `ces identify`](programs.md#identify), with `_` for `-`.\n")
    tasks = [(f"`DAMPER {name}`", _keys(keys)) for name, keys in OBSERVER_KEYS.items()]
    tasks += [(f"`controller {name}`", _keys(keys)) for name, keys in CONTROLLER_KEYS.items()]
    text += ["## Keys of `/diagnostics`\n", table(("task", "keys"), tasks)]
    more = f"Also {codes(OF_THE_PROCESS)}.\n"
    return "\n".join([*text, "## Keys of `~/details`\n", table(("keys of the observer", "meaning"), _figures()), more])


def _keys(keys: Iterable[str]) -> str:
    """Return keys as code; those of one latency are one."""
    return codes(dict.fromkeys(re.sub(r"(?<=, )(p50|p99|max) ", "p50 (p99, max) ", key) for key in keys))


def _figures() -> Iterator[tuple[str, str]]:
    """Yield keys and meaning of the observer's figures; those without a meaning stand beside the one before."""
    figures = [figure for figure in vars(Figures).values() if isinstance(figure, Figure)]
    first = [i for i, figure in enumerate(figures) if figure.meaning]
    for begin, end in zip(first, [*first[1:], len(figures)], strict=True):
        yield codes(figure.key for figure in figures[begin:end]), figures[begin].meaning


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


def _rows(options: Iterable[Option], described: set[str]) -> Iterator[tuple[str, str, str, str]]:
    """Yield the rows of a node; what an earlier node has, too, is not described again."""
    for option in options:
        row = _row(option)
        yield (*row[:3], "as above") if "|".join(row) in described else row
        described.add("|".join(row))


def _row(option: Option) -> tuple[str, str, str, str]:
    meaning = option.described
    unit = UNIT.search(meaning)
    limits = ", ".join(option.choices) or span(option.low, option.high)
    if unit and not option.choices:
        meaning, limits = UNIT.sub("", meaning, count=1), f"{limits} {unit[1] if unit[1] != '1' else ''}".strip()
    mark = " †" if option.live else ""
    default = as_text(option.default)
    return f"`{option.name}`{mark}", f"`{default}`" if default else "", limits, meaning
