"""One tick in every form, bit for bit: CPython, its compiled extension, Numba, the printed core, exported C and FMU."""

import numpy as np
import pytest
from compiled_core import build_core
from exported_c import a_million_samples, as_samples, hostile, rough_samples, with_delay
from exported_models import MODELS, PLAIN, make
from tick_forms import (
    Samples,
    assert_equal_bits,
    compile_core,
    compile_export,
    python_ticks,
    run_core,
    run_export,
    run_extension,
    run_fmu,
    run_numba,
    run_source,
    run_ticks,
)

from ces_observer.tick.tracker import OK, UNBOUNDED

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc")]
PYTHON_COUNT = 20_000  # of the samples: CPython is slow
LONG = {
    "a delay, polynomial": lambda: with_delay(make(*PLAIN), 0.003),
    **{
        name: MODELS[name]
        for name in (
            *("hydraulic", "a delay, network", "rules", "recurrent", "measured speed"),
            *("constructed inputs", "a delay, measured acceleration"),
        )
    },
}


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    return compile_core(tmp_path_factory.mktemp("core"))


@pytest.fixture(scope="module")
def extension(tmp_path_factory):
    return build_core(tmp_path_factory.mktemp("extension"))


@pytest.mark.parametrize("name", MODELS)
def test_all_models_give_the_same_in_every_form(core, extension, tmp_path, name) -> None:
    model = MODELS[name]()
    samples = rough_samples(model)
    expected = run_core(core, model, samples)
    some = Samples(*(column[:PYTHON_COUNT] for column in samples))
    assert_equal_bits(run_source(model, some), run_core(core, model, some), "CPython")
    assert_equal_bits(run_extension(extension, model, samples), expected, "extension of CPython")
    assert_equal_bits(run_numba(model, samples), expected, "Numba")
    exported = compile_export(tmp_path, model)
    assert_equal_bits(run_export(exported, samples), expected, "exported C")
    assert len(expected.later) > 1000 if model.sampling.delay_s else not len(expected.later)
    force = expected.rows[:, 0]
    np.testing.assert_array_equal(np.isnan(force), (expected.reasons != OK) | bool(model.sampling.delay_s))
    inputs = np.column_stack(hostile(3000, 1))
    forces = run_ticks(exported, inputs)
    np.testing.assert_array_equal(forces.view(np.int64), python_ticks(model, inputs).view(np.int64))


@pytest.mark.parametrize("name", LONG)
def test_a_million_hostile_samples_give_the_same_in_compiled_forms(core, extension, tmp_path, name) -> None:
    model = LONG[name]()
    samples = as_samples(model, *a_million_samples())
    expected = run_core(core, model, samples)
    assert set(range(UNBOUNDED)) <= {*expected.reasons.tolist(), UNBOUNDED}
    assert_equal_bits(run_extension(extension, model, samples), expected, "extension of CPython")
    assert_equal_bits(run_numba(model, samples), expected, "Numba")
    assert_equal_bits(run_export(compile_export(tmp_path, model), samples), expected, "exported C")
    if not model.sampling.motion:
        _compare_fmu(tmp_path, model, core, samples)


def _compare_fmu(folder, model, core, samples) -> None:
    """Compare an FMU's outputs with the core's, on the samples in the order of their stamps, which FMI asks for."""
    stamps, first = np.unique(samples.stamps - samples.stamps[0], return_index=True)
    kept = (stamps >= 0) & (stamps < 10**13)  # [ns]: seconds as doubles give the same stamps
    assert kept.sum() > 900_000
    ordered = Samples(stamps[kept], np.ascontiguousarray(samples.inputs[first[kept]]))
    expected, found = run_core(core, model, ordered), run_fmu(folder, model, ordered)
    ok = (expected.reasons == OK)[:-1]
    np.testing.assert_array_equal(found["reason"], expected.reasons[:-1])
    np.testing.assert_array_equal(found["clamped"], expected.rows[:-1, 4])
    np.testing.assert_array_equal(found["speed"], expected.rows[:-1, 2])
    if "force" in found:
        np.testing.assert_array_equal(found["valid"], ok)
        np.testing.assert_array_equal(found["force"], np.where(ok, expected.rows[:-1, 0], 0.0))
    if "force_delayed" in found:
        valid = found["valid"] != 0
        assert np.isin(found["force_delayed"][valid], expected.later[:, 2]).all()
        assert valid.mean() > 0.2
