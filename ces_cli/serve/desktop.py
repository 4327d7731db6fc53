"""Opens an address in the browser of this desktop, beside the server that the browser asks."""

from __future__ import annotations

import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Mapping
from urllib.parse import urlsplit

from ces_cli.terminal import terminal

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
CHOSEN = "BROWSER"  # the person's own choice, also of editors that forward ports


def open_browser(url: str) -> None:
    """Open `url`, or say how to see it where there is no desktop, as over ssh.

    Browsers may be waited for until their end, so this happens in a thread. Without a desktop Python would start a text
    browser, if there is one, in the terminal of the server; the pages need more.
    """
    if has_desktop(os.environ):
        threading.Thread(target=_open, args=(url,), daemon=True).start()
    else:
        terminal.print_warning(f"--open: no desktop here; {explain_tunnel(url, socket.gethostname())}")


def has_desktop(environment: Mapping[str, str], platform: str = sys.platform) -> bool:
    """Return whether a browser with a window can be expected."""
    needs_display = platform not in ("darwin", "win32", "cygwin")
    return not needs_display or any(environment.get(name) for name in (*DISPLAYS, CHOSEN))


def explain_tunnel(url: str, computer: str) -> str:
    """Return how another computer can show the page at `url`, an address on `computer` itself."""
    port = urlsplit(url).port
    return f"on yours, run ssh -N -L {port}:localhost:{port} {computer} and open http://localhost:{port}/"


def _open(url: str) -> None:
    if not webbrowser.open(url):
        terminal.print_warning("--open: no browser could be started; open the address above")
