"""MATLAB objects in MAT files (`timeseries`, `timetable`, ...): not read, but named, with what to do about them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from scipy.io.matlab import MatlabOpaque

SYSTEM = "MCOS"  # MATLAB's class system, beside the class in what scipy reads
MAX_SHOWN = 3
REMEDIES = {  # MATLAB code that saves an object NAME as a structure that is read
    "timeseries": "NAME = struct('time', NAME.Time, 'data', squeeze(NAME.Data)); save('plain.mat', 'NAME')",
    "table": "s = table2struct(NAME, 'ToScalar', true); save('plain.mat', '-struct', 's')",
    "timetable": "s = table2struct(timetable2table(NAME, 'ConvertRowTimes', false), 'ToScalar', true); "
    "t = NAME.Properties.RowTimes; s.t = seconds(t - t(1)); save('plain.mat', '-struct', 's')",
    "Simulink.SimulationData.Dataset": "s = struct(); for k = 1:NAME.numElements, e = NAME{k}; "
    "s.(matlab.lang.makeValidName(e.Name)) = struct('time', e.Values.Time, 'data', squeeze(e.Values.Data)); end; "
    "save('plain.mat', '-struct', 's')",
}


@dataclass(frozen=True)
class MatlabObject:
    """An object, whose content is not read; `kind` is its class."""

    kind: str


def replace_objects(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables of a file that scipy read, its objects as `MatlabObject` by their own names."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        own, kind = _read_class(value) if isinstance(value, MatlabOpaque) else ("", "")
        found[own or str(name)] = MatlabObject(kind) if kind else value
    return found


def _read_class(value: Any) -> tuple[str, str]:
    """Return name and class of an object; the name is '' where scipy (from 1.18) gives it elsewhere."""
    cells = value.ravel()[0]
    texts = [cell.decode() if isinstance(cell, bytes) else cell for cell in cells if isinstance(cell, bytes | str)]
    own = [text for text in texts if text != SYSTEM]
    return (own[0] if len(own) > 1 else ""), own[-1]


def list_objects(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, MatlabObject]]:
    """Yield path and object of every object in a tree."""
    for name, value in tree.items():
        if isinstance(value, MatlabObject):
            yield f"{prefix}{name}", value
        elif isinstance(value, Mapping) and not str(name).startswith(("__", "#")):
            yield from list_objects(value, f"{prefix}{name}.")


def describe_object(value: object, where: str) -> str:
    """Return what to do about a value that is a MATLAB object, '' for any other value."""
    if not isinstance(value, MatlabObject):
        return ""
    code = REMEDIES.get(value.kind, "").replace("NAME", where)
    remedy = f"in MATLAB: {code}" if code else "save its numbers as vectors or as a structure"
    return f"'{where}' is a MATLAB object ({value.kind}), which is not read; {remedy}"


def describe_objects(tree: Mapping[str, Any]) -> str:
    """Return which objects a tree holds and what to do about one of them, '' if it holds none."""
    found = sorted(list_objects(tree), key=lambda one: one[1].kind not in REMEDIES)
    if not found:
        return ""
    first = describe_object(found[0][1], found[0][0])
    others = [f"'{name}' ({value.kind})" for name, value in found[1 : 1 + MAX_SHOWN]]
    more = [f"{len(found) - 1 - MAX_SHOWN} more"] if len(found) > 1 + MAX_SHOWN else []
    return f"{first}; likewise {', '.join([*others, *more])}" if others else first
