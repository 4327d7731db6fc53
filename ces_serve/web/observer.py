"""The live view of running observers: one page, and a stream of what the listening process sends."""

from __future__ import annotations

from contextlib import closing
from zlib import crc32

from flask import Blueprint, Response, render_template, request, url_for

from ces_serve.live.link import ObserverLink
from ces_serve.web import curves
from ces_serve.web.events import ALIVE, Events, streams
from ces_serve.web.site import site

pages = Blueprint("observer", __name__)


@pages.get("/observer")
def show() -> str:
    """Return the page."""
    return render_template("observer.html", title="Observer", kind="observer", events=url_for("observer.listen"))


@pages.get("/events/observer")
def listen() -> Response:
    """Stream topics (each with its chart), estimates and statuses as they come."""
    return streams().respond(_listen(site().link, "narrow" in request.args))


def _listen(link: ObserverLink, narrow: bool) -> Events:
    with closing(link.messages()) as messages:
        for message in messages:
            if "topics" in message:
                yield "topics", [{"topic": topic, "chart": _chart(topic, narrow)} for topic in message["topics"]]
            elif message:
                yield "observer", message
            else:
                yield ALIVE


def _chart(topic: str, narrow: bool) -> str:
    """Return the chart of a topic, by its own id: a page keeps its charts while topics come and go."""
    return str(curves.observer_chart(f"observer{crc32(topic.encode()):08x}", topic.removesuffix("/estimate"), narrow))
