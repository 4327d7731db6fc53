"""The smallest effect that a diagnosis finds, with a polynomial and with `--structure auto` as the simulation.

    python -m bench.gaps.smallest_gap --out FOLDER --dampers hydraulic:1 bouc_wen:1
    python -m bench.gaps.smallest_gap --out FOLDER      # only the tables

Both models are identified from the same two recordings of the new damper; two others are the references. An effect of
fixed proportions is scaled to the gaps of a ladder. Bisection finds the lowest rung at which the diagnosis says that
there is a gap, and the lowest at which the effect is the most probable cause of it, as well. FOLDER keeps the models
and a row for each diagnosis; an interrupted run continues.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.gaps.ladder_damper import (
    AUTO,
    EXTRA_REAL,
    GAPS_N,
    IDENTIFY,
    NONE,
    REFERENCE,
    SIMULATIONS,
    ChangedRecordings,
    LadderDamper,
    LadderRow,
    RowFile,
    tables,
)
from bench.measurement import print_note
from ces_data.recording import Recording
from ces_gap.effects.library import library
from ces_gap.inference.evidence import learn_baseline
from ces_gap.inference.fit import Refinement
from ces_gap.inference.search import search
from ces_gap.inference.verdict import calibration, decide
from ces_gap.inputs.checks import find_invisible_effects
from ces_gap.inputs.prepare import prepare_recordings
from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import Limits
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.structures import KITS
from ces_identify.structures.auto import select_fitter
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.model import Model, load_model
from ces_rig.dampers.effects import EFFECTS as LIBRARY_EFFECTS
from ces_rig.errors import RigError
from ces_rig.withheld.plants import rms

EFFECTS = ("friction", "valve_lag", "leakage", "force_scale")
SEARCH = Limits(terms=25, time=60.0, starts=4, threads=1)


@dataclass(frozen=True)
class CauseFound:
    """What a diagnosis says, and the RMS [N] of the simulation's error on the references: its own (`error_N`), and what
    the learned correction leaves of it in blocks left out (`corrected_N`).
    """

    verdict: str
    first: str  # most probable effect
    error_N: float
    corrected_N: float


def identify_model(damper: LadderDamper, option: str, limits: Limits = SEARCH) -> Model:
    """Return the model of the new damper from the recordings that are used for nothing else."""
    sizes = {size.name: size.default for kit in KITS.values() for size in kit.sizes}
    fitter = select_fitter(AUTO, sizes) if option == AUTO else KITS[option].fitter(sizes)
    return identify(damper.new(IDENTIFY), (), IdentifyOptions(limits=limits, band=False), fitter=fitter).model


def find_cause(simulation: Simulation, changed: ChangedRecordings, reference: Sequence[Recording]) -> CauseFound:
    """Return what `ces_gap.pipeline.diagnose` would say, without the stages after its decision."""
    inputs = prepare_recordings(simulation, changed.real, changed.held_out, reference)
    invisible = dict(find_invisible_effects(library(), inputs.real))
    baseline = learn_baseline(inputs)
    visible = [effect for effect in library() if effect.name not in invisible]
    result = search(baseline.evidence, visible, Refinement(inputs.slow), threads=1)
    decision = decide(baseline, result, inputs.best, calibration())
    odds = decision.probabilities.effects
    errors = np.concatenate([(t.force - t.simulated)[t.usable] for t in inputs.reference])
    return CauseFound(decision.verdict, max(odds, key=odds.__getitem__), rms(errors), baseline.evidence.noise.rms_N)


@dataclass
class Ladder:
    """One effect of one damper, with one simulation: diagnoses rungs on request, each once.

    Without an effect (NONE), the rungs are pairs of recordings of the new damper.
    """

    damper: LadderDamper
    name: str
    model: Model
    simulation: str
    effect: str
    rows: RowFile

    def row(self, rung: int) -> LadderRow:
        """Return the diagnosis at the gap GAPS_N[rung]; raises RigError if the effect cannot be as large."""
        known = {row.rung: row for row in self.rows.of(self.name, self.simulation, self.effect)}
        return known[rung] if rung in known else self._diagnose(rung)

    def _diagnose(self, rung: int) -> LadderRow:
        began = time.monotonic()
        changed = self._record(rung)
        found = find_cause(ModelSimulation(self.model), changed, self.damper.new(REFERENCE))
        row = LadderRow(
            self.name,
            self.simulation,
            self.model.structure,
            self.effect,
            rung,
            changed.gap_N,
            found.verdict,
            found.first,
            found.error_N,
            found.corrected_N,
        )
        self.rows.append(row)
        print_note(f"{row} {time.monotonic() - began:.0f} s")
        return row

    def _record(self, rung: int) -> ChangedRecordings:
        if self.effect == NONE:
            return self.damper.without_effect(rung)
        return self.damper.with_effect(self.damper.draw_effect(self.effect), GAPS_N[rung])

    def search(self, passes: Callable[[LadderRow], bool], first: int) -> int:
        """Return the lowest rung that passes, found by bisection from the rung `first`; len(GAPS_N) if none does.

        Rungs that have been diagnosed already narrow the search.
        """
        known = self.rows.of(self.name, self.simulation, self.effect)
        low = max((row.rung for row in known if not passes(row)), default=-1)
        high = min((row.rung for row in known if passes(row) and row.rung > low), default=len(GAPS_N))
        rung = first if low < first < high else (low + high) // 2
        while high - low > 1:
            low, high = (low, rung) if passes(self.row(rung)) else (rung, high)
            rung = (low + high) // 2
        return high


def climb(damper: LadderDamper, name: str, models: Mapping[str, Model], effect: str, rows: RowFile) -> None:
    """Diagnose the rungs that show the smallest gap and the smallest effect found, with each simulation."""
    lowest = len(GAPS_N) // 2
    for simulation, model in models.items():
        ladder = Ladder(damper, name, model, simulation, effect, rows)
        try:
            lowest = ladder.search(lambda row: row.finds_gap, min(lowest, len(GAPS_N) - 1))
            if lowest < len(GAPS_N):
                ladder.search(lambda row: row.finds_effect, lowest)
        except RigError as error:
            print_note(f"{name} {effect}: left out: {error}")


def read_or_identify(path: Path, damper: LadderDamper, option: str) -> Model:
    """Return the model in the file, which is identified if there is none."""
    if not path.exists():
        identify_model(damper, option).save(path)
    return load_model(path)


def measure_damper(name: str, effects: Sequence[str], folder: Path, rows: RowFile) -> None:
    """Append the diagnoses of the damper `kind:seed`: without an effect, and on the ladder of each."""
    kind, _, seed = name.partition(":")
    damper = LadderDamper.draw(kind, int(seed))
    models = {s: read_or_identify(folder / f"{kind}_{seed}_{s}.json", damper, s) for s in SIMULATIONS}
    for simulation, model in models.items():
        for pair in range(1 + len(EXTRA_REAL)):
            Ladder(damper, name, model, simulation, NONE, rows).row(pair)
    for effect in filter(damper.has, effects):
        climb(damper, name, models, effect, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="of models and rows.jsonl")
    parser.add_argument("--dampers", nargs="*", default=[], metavar="KIND:SEED")
    parser.add_argument("--effects", nargs="+", default=EFFECTS, choices=LIBRARY_EFFECTS, metavar="EFFECT")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = RowFile(options.out / "rows.jsonl")
    for name in options.dampers:
        measure_damper(name, options.effects, options.out, rows)
    print(tables(RowFile(rows.path).rows))


if __name__ == "__main__":
    main()
