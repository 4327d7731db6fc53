"""How `ces compare` judges pairs of models on parts of measured recordings, against the whole rest of them.

    python -m bench.measured_differences DATA [--terms 3 6 12] [--seconds 5 8 12 17]

DATA holds `dyke_mr` and `utfsm_mr` (see `bench.gaps.real_gaps`). Polynomials of few terms, whose search lasts seconds,
are identified on the first 30 % of Dyke's recording, and of UTFSM's three sweeps together. Each pair is compared on
the rest, and on consecutive windows of it. The rest's order of the costs is taken as the truth, and so are its costs:
a window that finds the other order is *wrong*; *holds* is the share of the windows' intervals of J that hold the rest's
J. A sweep changes its frequency all the time, so that its windows differ by more than chance.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from ces_identify.comparison.compared_model import ComparedModel, make_compared_model
from ces_identify.comparison.comparison import compare
from ces_identify.comparison.pair_results import BETTER, SAME, SHORT
from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import Limits
from ces_identify.recordings.log_import import import_log
from ces_identify.recordings.log_mapping import load_dyno_mapping
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import ModelSimulation
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.polynomial import fit_polynomial

LEARNED = 0.3
MAPPINGS = Path(__file__).parents[1] / "config" / "import"
SETS = {"dyke_mr": "ranran_50.csv", "utfsm_mr": "sweep_15Hz_*A.csv"}
SEARCH_S = 10.0  # [s] of each identification


def read_parts(data: Path, folder: str) -> tuple[list[Recording], list[Recording]]:
    """Return what models are identified on, and the rest, of the recordings of a set."""
    mapping = load_dyno_mapping(MAPPINGS / f"{folder}.yaml")
    whole = [import_log(path, mapping) for path in sorted((data / folder).glob(SETS[folder]))]
    return [one.part(0.0, LEARNED) for one in whole], [one.part(LEARNED, 1.0) for one in whole]


def identify_models(learned: Sequence[Recording], terms: Sequence[int]) -> list[ComparedModel]:
    """Return a polynomial of each number of terms, at most."""
    models = []
    for count in terms:
        options = IdentifyOptions(split=1.0, limits=Limits(count, SEARCH_S, starts=1, threads=1), band=False)
        model = identify(learned, options=options, fitter=fit_polynomial).model
        models.append(make_compared_model(f"{count} terms", ModelSimulation(model)))
    return models


def cut_windows(recording: Recording, seconds: float) -> Iterator[Recording]:
    """Yield the consecutive windows of a recording; none if there would be one only, which is the recording itself."""
    stamps = recording.channel("position").stamps_ns
    count = int((stamps[-1] - stamps[0]) * 1e-9 / seconds)
    yield from (recording.part(k / count, (k + 1) / count) for k in range(count) if count > 1)


def judge_windows(models: Sequence[ComparedModel], rest: Recording, seconds: float, found: Counter[str]) -> None:
    """Count the verdicts of all pairs in the windows of `rest`, and the intervals that hold its costs."""
    truth = compare(models, [rest], timing=False)
    for window in cut_windows(rest, seconds):
        one = compare(models, [window], timing=False)
        for model, true in zip(one.models, truth.models, strict=True):
            if model.pooled_interval is not None:
                found["intervals"] += 1
                found["hold"] += model.pooled_interval.low <= true.pooled <= model.pooled_interval.high
        for pair in one.pairs:
            better = truth.models[pair.first].pooled < truth.models[pair.second].pooled
            wrong = pair.verdict == BETTER and (pair.better == pair.first) != better
            found["wrong" if wrong else pair.verdict] += 1


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--terms", type=int, nargs="+", default=(3, 6, 12))
    parser.add_argument("--seconds", type=float, nargs="+", default=(5.0, 8.0, 12.0, 17.0))
    options = parser.parse_args()
    print(
        "| recording | J % of the rest | window s | pairs | better | wrong | cannot be told apart | too short | holds |"
    )
    print("|---|---|" + "---:|" * 7)
    for folder in SETS:
        learned, rests = read_parts(options.data, folder)
        models = identify_models(learned, options.terms)
        for rest in rests:
            costs = ", ".join(f"{one.pooled:.1f}" for one in compare(models, [rest], timing=False).models)
            for seconds in options.seconds:
                found: Counter[str] = Counter()
                judge_windows(models, rest, seconds, found)
                if not found:
                    continue
                counts = [found[name] for name in (BETTER, "wrong", SAME, SHORT)]
                cells = [f"{seconds:g}", sum(counts), *counts, f"{found['hold']} of {found['intervals']}"]
                print(f"| {rest.name} | {costs} | {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
