"""The table and the pictures of docs/gallery.md: measured dampers, each from raw log to verdict by one command.

    python -m bench.gallery DATA [--fits FOLDER] [--pictures FOLDER]

The command is that of the page, `examples/csv_to_model.py`, for the default structure and `auto`. A model that is in
FOLDER (out/gallery) is not identified again. Of data whose terms are not stated, nothing is drawn.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.markdown import markdown
from bench.thesis.plots import STYLE, plt, save_small, smooth_speed
from ces_data.reading import read_recording
from ces_identify.prepare.series import prepare
from ces_identify.validation.cost_table import NONE
from ces_identify.validation.evaluate import VALIDATION, Evaluation, cost_interval, evaluate, pooled_cost
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parent.parent
SPLIT = 0.6
STRUCTURES = {"polynomial": "#c4161c", "auto": "#2a7f3f"}  # and the colour of its force
MEASURED = "#7aa6dc"


@dataclass(frozen=True)
class MeasuredDamper:
    """Patterns of the logs to learn and of other experiments; the recordings of these to draw, from and to [s]."""

    title: str
    folder: str
    logs: Sequence[str]
    other: Sequence[str] = ()
    drawn: Mapping[str, tuple[float, float]] = field(default_factory=dict)


SLOW_SINES, FAST_SINES = ("sine_10mm2Hz_*.csv", "sine_25mm0x5Hz_*.csv"), ("sine_5mm4Hz_*.csv",)
DRAWN_SINES = {"sine_5mm4Hz_1.00A": (4.0, 4.5), "sine_5mm4Hz_0.00A": (4.0, 4.5)}
DRAWN_BRAKE = {"0.5Hz36lbtension1.5amplitude": (6.0, 9.0)}
DAMPERS = {
    "dyke": MeasuredDamper("Dyke", "dyke_mr", ("ranran_50.csv",)),
    "utfsm_sines": MeasuredDamper("UTFSM, sines", "utfsm_mr", SLOW_SINES, FAST_SINES, DRAWN_SINES),
    "utfsm_sweeps": MeasuredDamper("UTFSM, sweeps", "utfsm_mr", ("sweep_*.csv",), ("sine_*.csv",)),
    "brake": MeasuredDamper("Brake", "brfd_backlash", ("0.25Hz*.json", "1Hz*.json"), ("0.5Hz*.json",), DRAWN_BRAKE),
}


@dataclass(frozen=True)
class GalleryModel:
    """What an identified model does on the rest of its recordings and in other experiments."""

    structure: str
    later: Sequence[Evaluation]
    other: Sequence[Evaluation]


def identify(damper: MeasuredDamper, structure: str, data: Path, fit: Path) -> GalleryModel:
    """Run the command of the page unless its model is in `fit`, and evaluate that."""
    folder = data / damper.folder
    logs, other = ([log for one in some for log in sorted(folder.glob(one))] for some in (damper.logs, damper.other))
    if not (fit / "model.json").exists():
        words = [*logs, *(["--validate", *other] if other else []), "--split", str(SPLIT), "--structure", structure]
        mapping = ROOT / "config" / "import" / f"{damper.folder}.yaml"
        script = [sys.executable, ROOT / "examples" / "csv_to_model.py"]
        subprocess.run([*script, *words, "--mapping", mapping, "--out", fit], check=True, stdout=sys.stderr)
    model = load_model(fit / "model.json")
    series = [prepare(read_recording(fit / "recordings" / log.stem), model.sampling) for log in (*logs, *other)]
    rest = [one.part(SPLIT, 1.0) for one in series[: len(logs)]]
    runs = (evaluate(model, some, VALIDATION) for some in (rest, series[len(logs) :]))
    return GalleryModel(model.structure.removesuffix("_narx"), *runs)


def table_rows(found: Mapping[str, Mapping[str, GalleryModel]]) -> list[list[str]]:
    """Return a row for each damper and structure, below the heading."""
    rows = [["damper", "`--structure`", "J % later", "in band %", "J % other", "in band %", "outside %"]]
    for name, models in found.items():
        for structure, model in models.items():
            outside = mean_share(model.other, "outside_share")
            later, other = ((cost_text(runs), mean_share(runs, "coverage")) for runs in (model.later, model.other))
            kind = structure if structure == model.structure else f"{structure}: {model.structure}"
            rows.append([DAMPERS[name].title, kind, *later, *other, outside])
    return rows


def cost_text(runs: Sequence[Evaluation]) -> str:
    """Return J of all runs together with its interval, as text."""
    interval = cost_interval(runs) if runs else None
    ends = NONE if interval is None else f"{interval.low:.1f}-{interval.high:.1f}"
    return f"{pooled_cost(runs):.1f} ({ends})" if runs else NONE


def mean_share(runs: Sequence[Evaluation], name: str) -> str:
    """Return a share over the scored ticks of all runs in percent, as text."""
    shares = [getattr(run, name) for run in runs]
    return f"{100.0 * np.average(shares, weights=[run.scored_s for run in runs]):.0f}" if runs else NONE


def draw(damper: MeasuredDamper, models: Mapping[str, GalleryModel], path: Path) -> None:
    """Draw force and error over time, and force over speed, of the recordings to show."""
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(9.0, 3.1 * len(damper.drawn)), layout="constrained")
        rows = figure.subfigures(len(damper.drawn), 1, squeeze=False)[:, 0]
        for row, (name, ends_s) in zip(rows, damper.drawn.items(), strict=True):
            runs = {s: next(run for run in model.other if run.name == name) for s, model in models.items()}
            draw_row(row, runs, ends_s)
    save_small(figure, path, 48)


def draw_row(figure: Any, runs: Mapping[str, Evaluation], ends_s: tuple[float, float]) -> None:
    """Draw a part of one recording, with the models of both structures."""
    over_time = figure.add_gridspec(2, 5, height_ratios=(2, 1))
    force, error = figure.add_subplot(over_time[0, :3]), figure.add_subplot(over_time[1, :3])
    loop = figure.add_subplot(over_time[:, 3:])
    for structure, run in runs.items():
        series, colour = run.series, STRUCTURES[structure]
        chosen = slice(*np.searchsorted(series.time_s, ends_s))
        time_s, speed, measured = (x[chosen] for x in (series.time_s, smooth_speed(series), series.force / 1e3))
        simulated, label = run.run.force[chosen] / 1e3, f"{structure}, J = {run.cost:.1f} %"
        if structure == next(iter(runs)):
            force.plot(time_s, measured, color=MEASURED, lw=2.6, label="measured")
            loop.plot(speed, measured, color=MEASURED, lw=2.6)
        force.plot(time_s, simulated, color=colour, lw=1.0, label=label)
        error.plot(time_s, measured - simulated, color=colour, lw=1.0)
        loop.plot(speed, simulated, color=colour, lw=1.0)
    force.set(ylabel="force [kN]", xticklabels=[])
    error.set(ylabel="error [kN]", xlabel="time [s]")
    loop.set(ylabel="force [kN]", xlabel="speed [m/s], positive in compression")
    force.set_title(next(iter(runs.values())).name, loc="left", fontsize=9)
    figure.legend(loc="outside upper right", ncols=3, frameon=False)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, metavar="DATA", help="folder of the measured recordings")
    parser.add_argument("--fits", type=Path, default=ROOT / "out" / "gallery", help="folder of the models")
    parser.add_argument("--pictures", type=Path, default=ROOT / "docs" / "img", help="folder of the pictures")
    options = parser.parse_args(argv)
    found: dict[str, dict[str, GalleryModel]] = {}
    for name, damper in DAMPERS.items():
        fits = {structure: options.fits / f"{name}_{structure}" for structure in STRUCTURES}
        found[name] = {s: identify(damper, s, options.data, fit) for s, fit in fits.items()}
        if damper.drawn:
            draw(damper, found[name], options.pictures / f"gallery_{name}.png")
    print(markdown(table_rows(found)))


if __name__ == "__main__":
    main()
