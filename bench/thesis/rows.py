"""Tables 5.1 to 5.3 and figures 5.1 to 5.8 of the thesis: every row with its size and cost, every panel with its row.

J. Söderberg, *Black-box modeling of a semi-active motorcycle damper*, KTH 2011 (XR-EE-RT 2011:001), chapter 5.
Experiments are named as in `ces_rig/experiments/thesis/`.
"""

from __future__ import annotations

from dataclasses import dataclass

POLYNOMIAL, NETWORK, ANFIS = "polynomial", "sigmoid", "anfis"
SPEED_FORCE, TIME = "speed-force", "time"


@dataclass(frozen=True)
class ThesisRow:
    """A row: the experiments for identification and evaluation, the model's size, the cost J [%] and the figure.

    The size is the number of regressors; Y, C, V and neurons; or the memberships A x B of current and speed. `cost` is
    None where the thesis has "-" because the model was unstable.
    """

    title: str
    source: str
    target: str
    size: tuple[int, ...]
    cost: float | None
    figure: str


@dataclass(frozen=True)
class ThesisTable:
    """A table: its number, title, and what its column of sizes holds."""

    number: str
    title: str
    size: str
    rows: tuple[ThesisRow, ...]


TABLES = {
    POLYNOMIAL: ThesisTable(
        "5.1",
        "polynomial NARX",
        "regressors",
        (
            ThesisRow("Sine 4 Hz", "sine_4hz", "sine_4hz", (7,), 2.34, "5.1(a)"),
            ThesisRow("Sine 12 Hz", "sine_12hz", "sine_12hz", (10,), 1.77, "5.1(b)"),
            ThesisRow("Sine 16 Hz", "sine_16hz", "sine_16hz", (11,), 1.63, ""),
            ThesisRow("LP filtered white noise", "noise", "noise", (9,), 14.79, "5.2"),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (5,), 6.92, ""),
            ThesisRow("Sine 4 Hz on the sweep model", "sweep", "sine_4hz", (5,), 63.79, "5.3(a)"),
            ThesisRow("Sine 4 Hz on the white noise model", "noise", "sine_4hz", (9,), 136.24, "5.3(b)"),
        ),
    ),
    NETWORK: ThesisTable(
        "5.2",
        "sigmoid network NARX",
        "Y, C, V; neurons",
        (
            ThesisRow("Sine 4 Hz", "sine_4hz", "sine_4hz", (2, 2, 2, 15), 1.24, "5.4"),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (2, 2, 2, 20), 2.72, "5.5(a)"),
            ThesisRow("Sine 4 Hz on the sweep model", "sweep", "sine_4hz", (2, 2, 2, 20), 22.02, "5.5(b)"),
            ThesisRow("LP filtered white noise", "noise", "noise", (2, 3, 3, 16), 11.24, ""),
            ThesisRow("LP filtered white noise", "noise", "noise", (2, 4, 5, 30), 9.86, "5.6(a)"),
            ThesisRow("Sine 4 Hz on the white noise model", "noise", "sine_4hz", (2, 4, 5, 30), 38.87, "5.6(b)"),
        ),
    ),
    ANFIS: ThesisTable(
        "5.3",
        "neuro-fuzzy (ANFIS)",
        "A x B",
        (
            ThesisRow("Sine 4 Hz", "sine_4hz", "sine_4hz", (4, 4), 2.12, "5.7(a)"),
            ThesisRow("Sine 16 Hz", "sine_16hz", "sine_16hz", (4, 4), 3.38, "5.7(b)"),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (3, 3), 6.6, ""),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (6, 6), 5.2, ""),
            ThesisRow("Sine 16 Hz on the sine 4 Hz model", "sine_4hz", "sine_16hz", (4, 4), None, "5.8"),
        ),
    ),
}


@dataclass(frozen=True)
class ThesisPanel:
    """A plot of a figure: its row, over speed or over time, and whether with the reference curve of reg1."""

    structure: str
    row: ThesisRow
    kind: str = SPEED_FORCE
    with_reference: bool = False


def panels() -> dict[str, tuple[ThesisPanel, ThesisPanel]]:
    """Return the two plots of each figure of the thesis, by its number."""
    found = {row.figure: (structure, row) for structure, table in TABLES.items() for row in table.rows if row.figure}
    both = {}
    for number in (f"5.{n}" for n in range(1, 9)):
        if number in found:  # one row, over speed and over time
            both[number] = ThesisPanel(*found[number]), ThesisPanel(*found[number], TIME)
        else:
            both[number] = (
                ThesisPanel(*found[f"{number}(a)"]),
                ThesisPanel(*found[f"{number}(b)"], with_reference=number == "5.1"),
            )
    return both


def format_size(row: ThesisRow) -> str:
    """Return the size as the thesis prints it."""
    if len(row.size) == 4:
        return "{}, {}, {}; {}".format(*row.size)
    return " x ".join(map(str, row.size))
