"""The shell that all pages share: head, style and footer, how values and names are told, and where templates lie.

A page's template extends `shell.html.j2`; pages of other packages keep theirs, and a style of their own, beside them.
"""

from __future__ import annotations

from importlib import resources

from jinja2 import Environment, FunctionLoader, StrictUndefined, Template
from markupsafe import Markup

from ces_identify.typesetting import three_figures
from ces_observer import __version__

HERE = "ces_identify.report"
UNITS = {"_m_s": "m/s", "_Hz": "Hz", "_percent": "%", "_s": "s", "_m": "m", "_A": "A", "_N": "N"}


def page_template(name: str, package: str = HERE, styles: tuple[str, ...] = ()) -> Template:
    """Return the template `name` of `package`; `styles` of the package follow the common style sheet."""

    def source(wanted: str) -> str:
        place = package if resources.files(package).joinpath(wanted).is_file() else HERE
        return _resource(place, wanted)

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(source),
    )
    css = [_resource(HERE, "report.css"), *(_resource(package, style) for style in styles)]
    environment.globals.update(
        css=Markup("\n".join(css)), version=__version__
    )  # the style sheets are this package's own
    environment.filters.update(spoken=format_key, three_figures=three_figures)
    return environment.get_template(name)


def format_key(key: str) -> str:
    """Return `max_gap_s` as `max gap [s]`."""
    for ending, unit in UNITS.items():
        if key.endswith(ending):
            return f"{key.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


def replace_unencodable(page: str) -> str:
    """Return the text with what UTF-8 cannot hold (names of files may) replaced."""
    return page.encode("utf-8", "replace").decode("utf-8")


def _resource(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
