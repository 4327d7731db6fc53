"""The variables of an FMU that are piston position, speed, valve current and damping force, and their units.

FMPy's model description and the user's names go in; `Ports` come out. Variables without a name from the user are found
by declared unit, then by name; an ambiguous choice raises an error that lists the variables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ces_observer.errors import CesError

SPEC = re.compile(r"(.+\.fmu)(?::(.*))?", re.IGNORECASE | re.DOTALL)  # FILE.fmu:names
INPUTS = ("position", "speed", "current")
ROLES = (*INPUTS, "force")
WORDS = {
    "position": {"position", "pos", "x", "z", "stroke", "displacement", "disp", "travel"},
    "speed": {"speed", "velocity", "vel", "v"},
    "current": {"current", "cur", "i", "voltage"},
    "force": {"force", "f"},
}
DIMENSIONS = {  # exponents of kg, m, s, A; a valve may be driven by a voltage, which then replaces the current
    "position": {(0, 1, 0, 0)},
    "speed": {(0, 1, -1, 0)},
    "current": {(0, 0, 0, 1), (1, 2, -3, -1)},
    "force": {(1, 1, -2, 0)},
}
VALID = "valid"  # name of a Boolean output: the force may be used


@dataclass(frozen=True)
class Port:
    """A real variable of the FMU: SI value = `factor` · its value + `offset`."""

    name: str
    reference: int
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Ports:
    """The input variables (some of position, speed, current) and the force; `valid` is a value reference, if any."""

    inputs: Mapping[str, Port]
    force: Port
    valid: int | None = None


def read_names(text: str, where: str) -> dict[str, str]:
    """Read `position=x,current=i,force=F` (any of them); an empty name means no such variable. Raises CesError."""
    names: dict[str, str] = {}
    for part in filter(None, re.split(r",(?=\w+=)", text)):
        role, equals, name = part.partition("=")
        if role not in ROLES or not equals or role in names:
            raise CesError(f"{where}: '{part}'; expected each of {', '.join(ROLES)} at most once, as position=NAME")
        names[role] = name
    return names


def choose_ports(description: Any, names: Mapping[str, str], where: str) -> Ports:
    """Return the variables that `names` gives or, for the other roles, that units and names identify.

    `description` is FMPy's ModelDescription. Raises CesError, naming `where` and listing the variables, if a variable
    is missing or ambiguous, without a force, or with neither position nor speed.
    """
    chooser = _Chooser(description, where)
    ports = {role: chooser.choose(role, names.get(role)) for role in ROLES}
    force = ports.pop("force")
    inputs = {role: port for role, port in ports.items() if port is not None}
    if force is None:
        raise chooser.unclear_error("no output that is the damping force; name it", "force")
    if not inputs.keys() & {"position", "speed"}:
        raise chooser.unclear_error("no input that is the piston's position or speed; name it", "position")
    if "current" not in inputs and "current" not in names and chooser.has_other_inputs(inputs):
        raise chooser.unclear_error(
            "no input that is the valve current; name it, or give current= if there is none", "current"
        )
    return Ports(inputs, force, chooser.find_valid())


class _Chooser:
    def __init__(self, description: Any, where: str) -> None:
        self.where = where
        self.units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
        self.variables = list(description.modelVariables)
        self.inputs = [v for v in self.variables if v.causality == "input" and v.type == "Real"]
        self.outputs = [v for v in self.variables if v.causality == "output" and v.type == "Real"]

    def choose(self, role: str, name: str | None) -> Port | None:
        """Return the port of a role; None if there is none."""
        variables = self.outputs if role == "force" else self.inputs
        if name == "":
            return None
        if name is not None:
            return self._find_by_name(role, name, variables)
        matches = [v for v in variables if self._dimension(v) in DIMENSIONS[role]]
        if not matches:
            matches = [v for v in variables if self._dimension(v) is None and _words(v.name) & WORDS[role]]
        if len(matches) > 1:
            matches = [v for v in matches if _words(v.name) & WORDS[role]] or matches
        if len(matches) > 1:
            raise self.unclear_error(f"{' and '.join(v.name for v in matches)} may each be the {role}; name one", role)
        return self._port(matches[0]) if matches else None

    def has_other_inputs(self, inputs: Mapping[str, Port]) -> bool:
        """Return whether any other real input could be a current."""
        taken = {port.name for port in inputs.values()}
        return any(v.name not in taken and self._dimension(v) is None for v in self.inputs)

    def find_valid(self) -> int | None:
        """Return the value reference of the Boolean output VALID, None if there is none."""
        valid = (v for v in self.variables if (v.name, v.type, v.causality) == (VALID, "Boolean", "output"))
        return next((int(v.valueReference) for v in valid), None)

    def unclear_error(self, what: str, role: str) -> CesError:
        """Return the error that asks the user for a name."""
        path = self.where.rpartition("/")[2]
        return CesError(
            f"{self.where}: {what} ({path}:{role}=NAME); inputs: {self._list(self.inputs)}; "
            f"outputs: {self._list(self.outputs)}"
        )

    def _find_by_name(self, role: str, name: str, variables: Sequence[Any]) -> Port:
        for variable in variables:
            if variable.name == name:
                return self._port(variable)
        raise self.unclear_error(f"no real {'output' if role == 'force' else 'input'} '{name}' for the {role}", role)

    def _port(self, variable: Any) -> Port:
        base = self.units.get(_unit(variable))
        factor, offset = (base.factor, base.offset) if base is not None else (1.0, 0.0)
        return Port(variable.name, int(variable.valueReference), float(factor), float(offset))

    def _dimension(self, variable: Any) -> tuple[int, int, int, int] | None:
        base = self.units.get(_unit(variable))
        return None if base is None else (base.kg, base.m, base.s, base.A)

    def _list(self, variables: Iterable[Any]) -> str:
        return ", ".join(f"{v.name} [{_unit(v) or '?'}]" for v in variables) or "none"


def _unit(variable: Any) -> str | None:
    declared = variable.declaredType.unit if variable.declaredType is not None else None
    return variable.unit or declared


def _words(name: str) -> set[str]:
    """Return the words of the last part of a name: `damper.pistonForce_N` gives piston, force and n."""
    last = name.rpartition(".")[2]
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", last)}
