"""What every request must pass and every response carries: reading only, for pages of this server in this browser."""

from __future__ import annotations

import ipaddress
import socket

from flask import Flask, Response, request

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# Pages from the folder: their own scripts and styles, as in the file, in an origin of their own, and no connections.
FILE_POLICY = (
    "sandbox allow-scripts allow-modals; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
POLICY = "Content-Security-Policy"
READING = ("GET", "HEAD")
LOOPBACK_NAMES = ("localhost",)
OTHER_SITES = ("cross-site", "same-site")


def protect(app: Flask, host: str) -> None:
    """Check all requests to `app`, which listens on `host`, and complete the headers of its responses."""

    @app.before_request
    def check() -> Response | None:
        if request.method not in READING:
            return _refuse(405, "this server only shows; it takes GET and HEAD")
        if not is_own_name(request.host, host):
            return _refuse(421, "unknown Host; open the address that ces serve has printed")
        navigates = request.headers.get("Sec-Fetch-Mode") == "navigate"
        if request.headers.get("Sec-Fetch-Site") in OTHER_SITES and not navigates:
            return _refuse(403, "requests from other sites are refused")
        return None

    @app.after_request
    def complete(response: Response) -> Response:
        for name, value in {**HEADERS, POLICY: PAGE_POLICY}.items():
            response.headers.setdefault(name, value)
        return response


def _refuse(status: int, reason: str) -> Response:
    """Return a refusal without the frame of the pages, which names the folder: who asks may be another site."""
    return Response(f"{reason}\n", status, mimetype="text/plain")


def is_own_name(host_header: str, bound: str) -> bool:
    """Return whether a Host header names this server, bound to `bound`.

    A page of another site that makes its own name point here (DNS rebinding) sends that name. On loopback only its
    names are right, with any port, which a tunnel may change; on another address also this computer's name, and all
    addresses, which are no names.
    """
    name, shared = _strip_port(host_header).lower(), not is_loopback(bound)
    if name in (*LOOPBACK_NAMES, bound.lower()) or (shared and name in _own_names()):
        return True
    address = _parse_address(name)
    return address is not None and (address.is_loopback or shared)


def is_loopback(host: str) -> bool:
    """Return whether `host`, a name or an address, is this computer only."""
    address = _parse_address(host)
    return host.lower() in LOOPBACK_NAMES if address is None else address.is_loopback


def _own_names() -> tuple[str, str]:
    """Return the names by which a network knows this computer."""
    name = socket.gethostname().lower()
    return name, f"{name}.local"


def _strip_port(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host if host.count(":") > 1 else host.partition(":")[0]


def _parse_address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None
