"""Public names that a package imports only when they are first used, so that `import PACKAGE` stays quick."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

from ces_observer.errors import suggest


def import_on_use(package: str, sources: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """Return the `__getattr__` of `package` (PEP 562); `sources` holds the names by the module that defines them."""
    home = {name: module for module, names in sources.items() for name in names}

    def find(name: str) -> Any:
        if name not in home:
            near = suggest(name, dir(import_module(package))) if name[0] != "_" else ""
            raise AttributeError(f"module '{package}' has no attribute '{name}'{near}")
        return getattr(import_module(home[name]), name)

    return find
