"""Write the reference pages, docs/reference/*.md, from the declarations in the code.

python -m bench.reference
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from bench.reference.effects import effects_page, structures_page
from bench.reference.files import files_page
from bench.reference.nodes import nodes_page
from bench.reference.programs import programs_page

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "reference"
PAGES: Mapping[str, Callable[[], str]] = {
    "programs": programs_page,
    "nodes": nodes_page,
    "files": files_page,
    "effects": effects_page,
    "structures": structures_page,
}
NOTE = "<!-- written by `make reference` from the declarations in the code: change them, not this page -->\n"


def main() -> None:
    """Write all pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        text = page().rstrip()
        (FOLDER / f"{name}.md").write_text(f"{NOTE}{text}\n", encoding="utf-8")
        print(f"docs/reference/{name}.md: {len(text.split())} words")


if __name__ == "__main__":
    main()
