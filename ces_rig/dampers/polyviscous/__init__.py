"""The electro-rheological damper: a yield force and viscous branches with a knee."""

from ces_rig.dampers.model import DamperKind
from ces_rig.dampers.polyviscous import effects, kernel
from ces_rig.dampers.polyviscous.parameters import Polyviscous

KIND = DamperKind.of(Polyviscous(), effects, kernel)
