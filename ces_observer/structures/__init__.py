"""Model structures: one file each, registered here by their names in model files."""

from ces_observer.structures.chambers import Chambers
from ces_observer.structures.fuzzy import Fuzzy
from ces_observer.structures.network import Network
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.relaxation import Relaxation
from ces_observer.structures.structure import Structure

STRUCTURES: dict[str, type[Structure]] = {one.name: one for one in (Polynomial, Network, Fuzzy, Relaxation, Chambers)}
