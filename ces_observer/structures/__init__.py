"""Model structures: each declares itself in its own module; all that are found here can be used."""

from importlib import import_module
from pkgutil import iter_modules

from ces_observer.structures.structure import Structure


def _find_structures() -> dict[str, type[Structure]]:
    """Return every structure that a module of this folder defines, by the name in model files."""
    modules = (import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__))
    classes = (one for module in modules for one in vars(module).values() if isinstance(one, type))
    found = (one for one in classes if issubclass(one, Structure) and not one.__abstractmethods__)
    return {one.name: one for one in sorted(set(found), key=lambda one: (one.rank, one.name))}


STRUCTURES = _find_structures()
