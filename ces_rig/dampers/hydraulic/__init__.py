"""The hydraulic CES damper: chambers, valves, pilot stage, seal, mount and heat."""

from ces_rig.dampers.hydraulic import effects, kernel
from ces_rig.dampers.hydraulic.parameters import Damper, Hydraulic
from ces_rig.dampers.model import DamperKind
from ces_rig.nested_numbers import replace_numbers

KIND = DamperKind.of(Hydraulic(replace_numbers(Damper(), effects.DESIGN)), effects, kernel)
