"""The mono-tube damper with shim stacks and a piloted spool in its piston: for sealed tests only."""

from ces_rig.dampers.model import DamperKind
from ces_rig.dampers.monotube import effects, kernel
from ces_rig.dampers.monotube.parameters import Monotube

KIND = DamperKind.of(Monotube(), effects, kernel)
