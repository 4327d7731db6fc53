"""Model structures: each declares itself in its own module; all that are found here can be used."""

from importlib import import_module
from pkgutil import iter_modules

from ces_observer.structures.structure import Structure


def _find_structures() -> dict[str, type[Structure]]:
    """Return every structure that a module of this folder defines, by the name in model files."""
    modules = (import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__))
    classes = (cls for module in modules for cls in vars(module).values() if isinstance(cls, type))
    structures = (cls for cls in classes if issubclass(cls, Structure) and not cls.__abstractmethods__)
    return {cls.name: cls for cls in sorted(set(structures), key=lambda cls: (cls.rank, cls.name))}


STRUCTURES = _find_structures()
