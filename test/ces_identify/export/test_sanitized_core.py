"""The core under sanitizers: whatever the counts of a flat file are, it is refused or stays within its arrays."""

import random
import subprocess

import numpy as np
import pytest
from exported_c import rough_samples
from exported_models import MODELS
from tick_forms import STRICT, Samples, arrays_of, core_texts

from ces_observer.tick.estimator import check_model

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc")]
SANITIZERS = "address,undefined,float-cast-overflow,float-divide-by-zero"
MUTATIONS = 150  # of each model
COUNT = 400  # samples of each case
WILD = (-(2**63), 2**63 - 1, 2**31, 2**62)
MAIN = """
#include "ces_core.h"
#include <stdio.h>
#include <stdlib.h>

static void *take(FILE *file, size_t count, size_t width)
{
    void *array = malloc(count * width); /* no longer than it is: a report says what goes beyond */
    if (array == NULL || fread(array, width, count, file) != count) {
        exit(3);
    }
    return array;
}

int main(int argc, char **argv)
{
    FILE *file = fopen(argv[1], "rb");
    int64_t head[2] = {0, 0}; /* cases, samples */
    int64_t refused = 0;
    if (argc < 2 || file == NULL || fread(head, sizeof head[0], 2, file) != 2) {
        return 3;
    }
    size_t count = (size_t)head[1];
    int64_t *stamps = take(file, count, 8);
    double *inputs = take(file, 3 * count, 8);
    double *rows = malloc(5 * count * 8), *later = malloc(8 * 4 * count);
    int64_t *reasons = malloc(count * 8), *later_stamps = malloc(count * 8);
    for (int64_t i = 0; i < head[0]; i++) {
        void *a[8];
        int64_t size[8];
        for (int j = 0; j < 8; j++) {
            int64_t *length = take(file, 1, 8);
            size[j] = *length;
            free(length);
            a[j] = take(file, (size_t)size[j], 8);
        }
        if (ces_check_model(a[0], a[1], size[0], size[1], size[2], size[3], a[4], a[5], size[4], size[5], size[6],
                size[7])) {
            (void)ces_run_samples(a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], head[1],
                stamps, inputs, rows, reasons, later_stamps, later);
        } else {
            refused++;
        }
        for (int j = 0; j < 8; j++) {
            free(a[j]);
        }
    }
    printf("%d\\n", (int)refused);
    free(stamps), free(inputs), free(rows), free(later), free(reasons), free(later_stamps), fclose(file);
    return 0;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """Return the path of the core, compiled with sanitizers around cases in a file."""
    folder = tmp_path_factory.mktemp("core")
    header, source = core_texts()
    for name, text in {"ces_core.h": header, "ces_core.c": source, "main.c": MAIN}.items():
        (folder / name).write_text(text)
    flags = [*STRICT, "-O1", "-g", f"-fsanitize={SANITIZERS}", "-fno-sanitize-recover=all"]
    done = subprocess.run(
        ["cc", *flags, "-o", "run", "main.c", "ces_core.c", "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if "sanitize" in done.stderr or "asan" in done.stderr:
        pytest.skip("the compiler has no sanitizers; install libasan and libubsan of its version")
    assert done.returncode == 0, done.stderr
    return folder / "run"


def run(program, folder, cases, samples: Samples) -> int:
    """Run cases, each eight arrays; return how many were refused. The program fails at the first report."""
    with (folder / "cases").open("wb") as file:
        file.write(np.array([len(cases), len(samples.stamps)]).tobytes())
        file.write(samples.stamps.tobytes() + np.ascontiguousarray(samples.inputs).tobytes())
        for arrays in cases:
            for array in arrays:
                file.write(np.array([len(array)]).tobytes() + array.tobytes())
    done = subprocess.run([program, folder / "cases"], capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


@pytest.mark.parametrize("name", MODELS)
def test_all_samples_of_all_models_give_no_report(program, tmp_path, name) -> None:
    model = MODELS[name]()
    assert run(program, tmp_path, [arrays_of(model)], rough_samples(model)) == 0


def mutate(arrays, dice: random.Random):
    """Return a copy with one to three wrong whole numbers, and sometimes an array that ends too early."""
    copy = [array.copy() for array in arrays]
    for _ in range(dice.choice((1, 1, 2, 3))):
        counts = copy[dice.choice([j for j in (1, 5) if len(copy[j]) > 1])]
        at = dice.randrange(len(counts))
        near = max(-(2**62), min(int(counts[at]), 2**62)) + dice.choice((-1, 1, 2, -7, 40))
        counts[at] = dice.choice((near, dice.randrange(-3, 300), dice.choice((*WILD, -1))))
    if dice.random() < 0.2:
        j = dice.choice([j for j in range(8) if len(copy[j]) > 1])
        copy[j] = copy[j][: -dice.randrange(1, min(9, len(copy[j])))]
    return copy


@pytest.mark.parametrize("name", MODELS)
def test_wrong_counts_are_refused_or_harmless(program, tmp_path, name) -> None:
    model, dice = MODELS[name](), random.Random(name)
    arrays = arrays_of(model)
    cases = [mutate(arrays, dice) for _ in range(MUTATIONS)]
    rough = rough_samples(model)
    kept = slice(len(rough.stamps) - COUNT, None)
    refused = run(program, tmp_path, cases, Samples(rough.stamps[kept], rough.inputs[kept]))
    assert refused > 0.2 * MUTATIONS
    lists = [[array.tolist() for array in case] for case in cases]
    sizes = [list(map(len, case)) for case in lists]
    checked = [
        check_model(*(x for j in (0, 4) for x in (case[j], case[j + 1], *size[j : j + 4])))
        for case, size in zip(lists, sizes, strict=True)
    ]
    assert checked.count(False) == refused  # Python refuses the same
