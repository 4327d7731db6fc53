"""Makes the cases of a plan in parallel processes and seals their answers."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ces_rig.blind.case_folder import write_case
from ces_rig.blind.draw import draw_case
from ces_rig.blind.plan import BlindCase
from ces_rig.blind.seal import Label, write_arrays, write_seal
from ces_rig.errors import RigError

WRITTEN = ("cases", "seal", "seal.json")
SpareEffects = Sequence[tuple[str, ...]]


def make_cases(
    folder: Path,
    plan: Sequence[tuple[BlindCase, SpareEffects]],
    seconds: float,
    processes: int,
    about: Mapping[str, Any],
    on_label: Callable[[Label], None],
) -> str:
    """Write `folder/cases/NNNN/`, `folder/seal.json` and `folder/seal/`; return the published hash.

    `on_label` is called with each label when its case is ready. `folder` must be new or empty. Raises CesError.
    """
    if folder.exists() and any(folder.iterdir()):
        raise RigError(f"{folder}: is not empty; choose another folder for the cases")
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    labels = []
    try:
        for label in _make_in_processes(folder, plan, seconds, processes):
            labels.append(label)
            on_label(label)
    except BaseException:
        for name in ("cases", "seal"):
            shutil.rmtree(folder / name, ignore_errors=True)
        raise
    return write_seal(folder, {**about, "seconds": seconds}, sorted(labels, key=lambda x: str(x["case"])))


def remove_cases(folder: Path) -> None:
    """Remove the cases and the seal in `folder`; raises RigError if it holds anything else."""
    inside = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    other = [name for name in inside if name not in WRITTEN]
    if other:
        raise RigError(f"{folder}: holds more than blind cases ({other[0]}), so it is not replaced; choose another")
    for name in inside:
        shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink()


def _make_in_processes(
    folder: Path, plan: Sequence[tuple[BlindCase, SpareEffects]], seconds: float, processes: int
) -> Iterator[Label]:
    """Yield each label when its case is ready."""
    import joblib  # type: ignore[import-untyped]

    tasks = (joblib.delayed(make_case)(folder, case, seconds, spare) for case, spare in plan)
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        yield from joblib.Parallel(n_jobs=processes, batch_size=1, return_as="generator")(tasks)


def make_case(folder: Path, case: BlindCase, seconds: float, spare_effects: SpareEffects) -> Label:
    """Make one case and return its label; raises CesError."""
    answer = write_case(draw_case(case, seconds, spare_effects), folder / "cases" / f"{case.number:04d}")
    sha256 = write_arrays(folder, answer.label["case"], answer.arrays)
    return {**answer.label, "planned": list(case.effects), "arrays_sha256": sha256}
