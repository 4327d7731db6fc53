"""Comparing models by clicking: choose recordings, compute in another process, show the page of `ces compare`."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flask import Blueprint, Response, abort, render_template, request, url_for

from ces_serve.files.item import MODEL, RECORDING, Item
from ces_serve.web.events import Event, Events, streams
from ces_serve.web.security import FILE_POLICY, POLICY
from ces_serve.web.site import Site, site, stamp
from ces_serve.web.work_events import stream_work

MAX_MODELS, MAX_RECORDINGS = 8, 12  # on a page, as many as its charts can show
MAX_OTHERS = 100  # models offered beside those that were chosen
LIMIT_S = 180.0

pages = Blueprint("compare", __name__)


@pages.get("/compare")
def choose() -> str:
    """Return the page where recordings are chosen for the chosen models."""
    listing = site().catalogue.listing()
    models = _chosen(MODEL, "model")
    others = [one for one in listing.of_kind(MODEL) if one not in models]
    recordings = listing.of_kind(RECORDING)
    suggested = _suggest(models, recordings)
    return render_template(
        "compare.html",
        title="Compare models",
        kind=MODEL,
        models=models,
        others=others[:MAX_OTHERS],
        more=len(others[MAX_OTHERS:]),
        recordings=sorted(recordings, key=lambda one: one.path not in suggested),
        suggested=suggested,
        uses={one.path: _describe_use(one, models) for one in recordings},
        max_models=MAX_MODELS,
        max_recordings=MAX_RECORDINGS,
    )


@pages.get("/compare/result")
def result() -> str:
    """Return the page that waits for a comparison and then shows it."""
    models, bags = _chosen(MODEL, "model"), _chosen(RECORDING, "bag")
    problem = _check(models, bags)
    given: dict[str, Any] = {"model": [one.path for one in models], "bag": [one.path for one in bags]}
    return render_template(
        "comparing.html",
        title="Comparing",
        kind=MODEL,
        models=models,
        bags=bags,
        problem=problem,
        back=url_for("compare.choose", model=given["model"]),
        work="" if problem else url_for("compare.compute", **given),
    )


@pages.get("/events/compare")
def compute() -> Response:
    """Stream the progress of a comparison and the address of its page; it stops when the browser leaves."""
    models, bags = _chosen(MODEL, "model"), _chosen(RECORDING, "bag")
    problem = _check(models, bags)
    if problem:
        abort(400, problem)
    where = site()
    try:
        files, recordings = ([where.folder.find(one.path) for one in chosen] for chosen in (models, bags))
        key = _key(files, recordings, where.signals)
    except OSError as error:
        abort(404, str(error))
    named = {"models": [str(path) for path in files], "bags": [str(path) for path in recordings]}
    task = {"name": "compare", "signals": where.signals, **named}
    return streams().respond(_compute(where, key, task))


@pages.get("/compare/page/<key>")
def page(key: str) -> Response:
    """Return a page that was computed, as the program writes it."""
    html = site().compared.get(key)
    if html is None:
        abort(404, "this comparison is no longer kept; compare again")
    response = Response(html, mimetype="text/html")
    response.headers[POLICY] = FILE_POLICY
    return response


def _compute(where: Site, key: str, task: dict[str, Any]) -> Events:
    """Yield progress, then the address of the page; one comparison at a time."""
    address = url_for("compare.page", key=key)
    if where.compared.get(key) is not None:
        yield "done", address
        return

    def finish(html: str) -> Event:
        where.compared.keep(key, html)
        return "done", address

    yield from stream_work(task, LIMIT_S, where.comparing, finish)


def _chosen(kind: str, name: str) -> list[Item]:
    """Return the things that the address names, each once and only those that the folder has."""
    listing = site().catalogue.listing()
    paths = dict.fromkeys(request.args.getlist(name)[: 10 * MAX_RECORDINGS])
    return [one for path in paths if (one := listing.find(kind, path)) is not None]


def _check(models: Sequence[Item], bags: Sequence[Item]) -> str:
    """Return what is wrong with a choice, empty if nothing is."""
    if not 2 <= len(models) <= MAX_MODELS:
        return f"models chosen: {len(models)}; choose 2 to {MAX_MODELS}"
    if not 1 <= len(bags) <= MAX_RECORDINGS:
        return f"recordings chosen: {len(bags)}; choose 1 to {MAX_RECORDINGS}"
    return ""


def _suggest(models: Sequence[Item], recordings: Sequence[Item]) -> set[str]:
    """Return the recordings on which all models were validated, else one that no model was identified on."""
    validated = [set(one.facts["validation"]) for one in models]
    common = set.intersection(*validated) if validated else set()
    found = [one.path for one in recordings if one.name in common]
    if not found:
        used = {name for one in models for name in one.facts["recordings"]}
        found = [one.path for one in recordings if one.name not in used][:1]
    return set(found[:MAX_RECORDINGS])


def _describe_use(recording: Item, models: Sequence[Item]) -> str:
    """Return how many of the models were identified or validated on a recording of this name."""
    fit = sum(recording.name in one.facts["recordings"] for one in models)
    test = sum(recording.name in one.facts["validation"] for one in models)
    said = [f"{what} {count} of {len(models)}" for what, count in (("identified", fit), ("validated", test)) if count]
    return ", ".join(said)


def _key(models: Sequence[Path], bags: Sequence[Path], signals: str | None) -> str:
    """Return what changes when one of the files changes."""
    text = repr(([stamp(path) for path in models], [stamp(path) for path in bags], signals))
    return hashlib.sha256(text.encode()).hexdigest()[:24]
