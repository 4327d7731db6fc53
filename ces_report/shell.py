"""The frame of all report pages: head, style, script and footer, readable names of values, and template folders.

A page's template extends `shell.html.j2`. Other packages keep their templates and styles in folders of their own.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from importlib import resources
from typing import Self

from jinja2 import Environment, FunctionLoader, StrictUndefined, Template
from markupsafe import Markup

from ces_observer import __version__
from ces_report.typesetting import three_figures

HERE = "ces_report"
POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
SCRIPTS = ("plots.js", "values.js", "tables.js")
UNITS = {"_m_s": "m/s", "_Hz": "Hz", "_percent": "%", "_s": "s", "_m": "m", "_A": "A", "_N": "N"}


@dataclass(frozen=True)
class PageHead:
    """What a page says of itself: `title` (empty: the program's), the user's `note`, command, date of the recordings.

    The note is free text: damper, operator, what was tested.
    """

    title: str = ""
    note: str = ""
    command: str = ""
    recorded: str = ""
    written: str = field(default_factory=lambda: datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"))

    def titled(self, title: str) -> Self:
        """Return the head with a title if it has none."""
        return replace(self, title=self.title or title)

    @property
    def origin(self) -> str:
        """When the recordings were made, if that is known, and when and by what the page was written."""
        recorded = f"Recorded {self.recorded}; page" if self.recorded else "Page"
        return f"{recorded} written {self.written} by ces_observer {__version__}."


def page_template(name: str, package: str = HERE, styles: tuple[str, ...] = ()) -> Template:
    """Return the template `name` of `package`; the package's `styles` follow the common style sheet."""

    def source(template: str) -> str:
        folder = package if resources.files(package).joinpath(template).is_file() else HERE
        return _resource(folder, template)

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, loader=FunctionLoader(source)
    )
    css = [_resource(HERE, "report.css"), *(_resource(package, style) for style in styles)]
    environment.globals.update(css=Markup("\n".join(css)), version=__version__)  # our own style sheets: no escaping
    digest = base64.b64encode(hashlib.sha256(_script().encode()).digest()).decode()
    policy = f"{POLICY}; script-src 'sha256-{digest}'"  # no network, no script but ours
    environment.globals.update(script=Markup(_script()), policy=Markup(policy))
    environment.filters.update(readable=format_key, three_figures=three_figures, command=command_block)
    return environment.get_template(name)


def format_key(key: str) -> str:
    """Return `max_gap_s` as `max gap [s]`."""
    for ending, unit in UNITS.items():
        if key.endswith(ending):
            return f"{key.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


def replace_unencodable(page: str) -> str:
    """Return the text with replacements for characters that UTF-8 cannot encode (possible in file names)."""
    return page.encode("utf-8", "replace").decode("utf-8")


def command_block(command: str) -> Markup:
    """Return a command in monospace; a click selects all of it."""
    return Markup('<div class="command"><code>{}</code></div>').format(command)


@cache
def _script() -> str:
    """Return the script of all pages as text that HTML and XML read in the same way."""
    parts = "\n".join(_resource(HERE, name) for name in SCRIPTS)
    return f"//<![CDATA[\n{parts}\n//]]>"


def _resource(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
