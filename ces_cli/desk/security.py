"""What every request must pass and every response carries: reading only, for pages of this server in this browser."""

from __future__ import annotations

import ipaddress
import socket

from flask import Flask, Response, request

POLICY = "Content-Security-Policy"
HEADERS = {
    POLICY: "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# Pages from the folder: their own scripts and styles, as in the file, in an origin of their own, and no connections.
FILE_POLICY = (
    "sandbox allow-scripts allow-modals; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def protect(app: Flask, host: str) -> None:
    """Check all requests to `app`, which listens on `host`, and complete the headers of its responses."""

    @app.before_request
    def check() -> Response | None:
        from_other_site = request.headers.get("Sec-Fetch-Site") in ("cross-site", "same-site")
        if request.method not in ("GET", "HEAD"):
            status, reason = 405, "this server only shows; it takes GET and HEAD"
        elif not is_own_name(request.host, host):
            status, reason = 421, "unknown Host; open the address that ces serve has printed"
        elif from_other_site and request.headers.get("Sec-Fetch-Mode") != "navigate":
            status, reason = 403, "requests from other sites are refused"
        else:
            return None
        # without the frame of the pages, which names the folder: who asks may be another site
        return Response(f"{reason}\n", status, mimetype="text/plain")

    @app.after_request
    def complete(response: Response) -> Response:
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response


def is_own_name(host_header: str, bound: str) -> bool:
    """Return whether a Host header names this server, bound to `bound`.

    A page of another site that makes its own name point here (DNS rebinding) sends that name. On loopback only its
    names are right, with any port, which a tunnel may change; on another address also this computer's name, and all
    addresses, which are no names.
    """
    bracketed = host_header.startswith("[")
    name = (host_header[1:].partition("]") if bracketed else host_header.partition(":"))[0].lower()
    own, shared = socket.gethostname().lower(), not is_loopback(bound)
    address = _parse_address(name)
    if address is not None and (shared or address.is_loopback):
        return True
    return name in ("localhost", bound.lower()) or (shared and name in (own, f"{own}.local"))


def is_loopback(host: str) -> bool:
    """Return whether `host`, a name or an address, is this computer only."""
    address = _parse_address(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def _parse_address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None
