"""What a diagnosis of one unit of a fleet gives, and what tells its results apart."""

import json
from pathlib import Path

import cheap_diagnosis
import pytest
from cheap_diagnosis import OFFSETS_N, Offset, Options, made

from ces_gap.fleet import DiagnosisRequest, diagnose_unit, job_of
from ces_identify.jobs import CRASHED, DONE, FAILED
from ces_identify.simulations.simulation import FunctionSimulation, function_simulation

ROOT = Path(__file__).parents[2]
SPEC = "cheap_diagnosis:damper"


def answer(job, request, recordings):
    return diagnose_unit(job, [request], recordings)


def make_request(**more):
    arguments = {"simulation": FunctionSimulation(SPEC, cheap_diagnosis.damper), "spec": SPEC, "reference": ()}
    arguments |= {"options": Options(), "diagnose": cheap_diagnosis.diagnose, "files": cheap_diagnosis.files}
    return DiagnosisRequest(**{**arguments, **more})


def jobs(folder, names=tuple(OFFSETS_N), request=None):
    """Jobs with their recordings; each vehicle has two."""
    fleet = {name: [made(name, OFFSETS_N.get(name, 5.0), seed) for seed in (1, 2)] for name in names}
    return [
        (job_of(name, recordings, request or make_request(), "", folder), recordings)
        for name, recordings in fleet.items()
    ]


def as_results(answers):
    return {
        a.row["name"]: (
            {k: v for k, v in a.row.items() if k != "seconds"},
            {Path(f).name: t for f, t in a.files.items()},
        )
        for a in answers
    }


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The results, with a failure and a crash."""
    work = jobs(tmp_path_factory.mktemp("fleet"), (*OFFSETS_N, "refused", "broken"))
    return as_results(answer(job, make_request(), recordings) for job, recordings in work)


def test_a_row_describes_the_result(expected):
    answers = expected
    row, files = answers["c"]
    assert row["status"] == DONE
    assert row["verdict"] == "named"
    assert row["effects"] == ["stand_in_offset"]
    assert row["gap_N"] == pytest.approx(90.0, abs=1.0)
    assert row["shrink"] == pytest.approx(1.0 - 3.0 / 90.0, abs=0.02)
    assert json.loads(files["gap.json"])["rms_N"] == pytest.approx(row["gap_N"], rel=1e-4)
    assert row["recordings"] == ["c", "c"]
    assert answers["a"][0]["verdict"] == "no_gap"
    assert answers["refused"][0]["status"] == FAILED
    assert answers["refused"][0]["reason"] == "refused: too short"
    assert answers["broken"][0]["status"] == CRASHED
    assert answers["broken"][0]["reason"] == "ZeroDivisionError: by zero"
    json.dumps([row for row, _ in answers.values()], allow_nan=False)


def test_different_requests_have_different_keys(tmp_path, monkeypatch):
    (tmp_path / "coded.py").write_text("def force(t, x, i):\n    return x\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    coded = make_request(simulation=function_simulation("coded:force"), spec="coded:force")
    (tmp_path / "m.json").write_text("1")
    monkeypatch.chdir(tmp_path)
    filed = make_request(spec="m.json")
    digests = [q.digest() for q in (make_request(), make_request(options=Options(seed=2)), coded, filed)]
    digests.append(make_request(options=Options(effects=(Offset(),))).digest())
    digests.append(make_request(reference=(made("r", 1.0),)).digest())
    (tmp_path / "coded.py").write_text("def force(t, x, i):\n    return 2 * x\n")
    (tmp_path / "m.json").write_text("2")
    digests += [coded.digest(), filed.digest()]
    assert len(set(digests)) == len(digests)
    assert make_request(options=Options(threads=9)).digest() == make_request().digest()
    recordings = [made("a", 1.0)]
    keys = [
        job_of("a", recordings, make_request(), "s", tmp_path),
        job_of("a", recordings, make_request(), "other", tmp_path),
    ]
    keys.append(job_of("a", [made("a", 2.0)], make_request(), "s", tmp_path))
    assert len({job.key for job in keys}) == 3
    assert job_of("a", recordings, filed, "", tmp_path).sim["spec"] == "../../m.json"
    assert job_of("renamed", recordings, make_request(), "s", tmp_path).key == keys[0].key
