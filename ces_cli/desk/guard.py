"""Who is answered: pages of this server in the browser of whoever has its token; and the headers of all answers."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress

from flask import Flask, Response, request

POLICY = "Content-Security-Policy"
EMPTY_STYLE = "'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='"  # the style element that plotly.js fills
HEADERS = {
    POLICY: f"default-src 'none'; script-src 'self'; style-src 'self' {EMPTY_STYLE}; img-src 'self' data:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with less, browsers name no origin
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# Files of the folder: their own scripts and styles, as in the file, in an origin of their own, and no connections.
FILE_POLICY = (
    "sandbox allow-scripts allow-modals; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)


def protect(app: Flask, token: str) -> None:
    """Check all requests to `app` and complete the headers of its responses; `/?token=` takes the token as a cookie."""
    cookie = f"ces_{hashlib.sha256(token.encode()).hexdigest()[:12]}"  # servers on other ports share the cookies

    @app.before_request
    def check() -> Response | None:
        asked, is_entry = request.headers, request.path == "/" and "token" in request.args
        given = request.args["token"] if is_entry else request.cookies.get(cookie, "")
        site, mode = asked.get("Sec-Fetch-Site"), asked.get("Sec-Fetch-Mode")
        is_page = request.method != "POST" or asked.get("Origin") == f"http://{request.host}"
        refusals = {
            "405 this server takes GET, HEAD and POST": request.method not in ("GET", "HEAD", "POST"),
            "421 unknown Host; open the address that ces serve has printed": not is_own_name(request.host),
            "403 requests from other sites are refused": site in ("cross-site", "same-site") and mode != "navigate",
            "403 only pages of this server change anything": not is_page,
            "403 open the address that ces serve has printed": not hmac.compare_digest(given.encode(), token.encode()),
        }
        for reason in (text for text, is_so in refusals.items() if is_so):
            return Response(f"{reason[4:]}\n", int(reason[:3]), mimetype="text/plain")  # and nothing of the folder
        return None

    @app.after_request
    def complete(response: Response) -> Response:
        if request.path == "/" and "token" in request.args and response.status_code == 200:
            response.set_cookie(cookie, token, httponly=True, samesite="Strict")
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response


def is_own_name(host: str) -> bool:
    """Return whether a Host header names this computer, with any port; DNS rebinding sends the name of its site."""
    name = (host[1:].partition("]") if host.startswith("[") else host.partition(":"))[0].lower()
    try:
        return name == "localhost" or ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False
