"""Objects in MATLAB files, whose content is not read, and the MATLAB code that saves them readably."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


def describe_object(value: object, where: str) -> str:
    """Return what to do about a value that is a MATLAB object, '' for any other value."""
    if not isinstance(value, MatlabObject):
        return ""
    code = REMEDIES.get(value.kind, "").replace("NAME", where)
    remedy = f"in MATLAB: {code}" if code else "save its numbers as vectors or as a structure"
    return f"'{where}' is a MATLAB object ({value.kind}), which is not read; {remedy}"


def describe_objects(objects: Sequence[tuple[str, MatlabObject]]) -> str:
    """Return which objects a tree holds and what to do about one of them, '' if it holds none."""
    if not objects:
        return ""
    (name, kind_of_first), *rest = sorted(objects, key=lambda named: named[1].kind not in REMEDIES)
    others = [f"'{other}' ({value.kind})" for other, value in rest[:MAX_SHOWN]]
    more = [f"{len(rest) - MAX_SHOWN} more"] if len(rest) > MAX_SHOWN else []
    return describe_object(kind_of_first, name) + (f"; likewise {', '.join([*others, *more])}" if others else "")
