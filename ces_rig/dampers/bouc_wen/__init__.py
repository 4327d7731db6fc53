"""The magneto-rheological damper: a modified Bouc-Wen model."""

from ces_rig.dampers.bouc_wen import effects, kernel
from ces_rig.dampers.bouc_wen.parameters import BoucWen
from ces_rig.dampers.model import DamperKind

KIND = DamperKind.of(BoucWen(), effects, kernel)
