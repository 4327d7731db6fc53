"""One cell: its settings reach the search, its row holds the result, and its failure does not stop the others."""

from dataclasses import replace

import pytest
from campaign_parts import CAMPAIGN, RULES, made

from ces_identify.campaign import cells as module
from ces_identify.campaign.cells import compute_cell
from ces_identify.campaign.plan import jobs, load_campaign
from ces_identify.jobs import CRASHED, DONE, FAILED
from ces_identify.prepare.series import prepare
from ces_identify.validation.evaluate import evaluate
from ces_observer.model import parse_model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """The jobs of a campaign and its recordings by path."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "rules.yaml").write_text(RULES)
    text = CAMPAIGN.replace("sigmoid: {units: 2}", "sigmoid: {units: 2}\n  anfis: {rules: 2x1}") + "split: 0.8\n"
    (folder / "c.yaml").write_text(text.replace("seed", "rate: 200\nseed"))
    campaign = load_campaign(folder / "c.yaml")
    recordings = {path: made(seed, name=path.name) for seed, path in enumerate(campaign.paths, start=1)}
    return {(j.cell.bags, j.cell.structure): j for j in jobs(campaign, recordings, "")}, recordings


def computed(work, bags, structure):
    jobs, recordings = work
    job = jobs[bags, structure]
    return compute_cell(job, [recordings[p] for p in job.paths])


@pytest.mark.parametrize(
    ("structure", "size"), [("polynomial", " terms"), ("sigmoid", "2 sigmoid units"), ("anfis", "2 rules")]
)
def test_a_row_tells_settings_size_and_costs(work, structure, size):
    done = computed(work, "one", structure)
    row, model = done.row, parse_model(*done.files.values(), "test")
    assert (row["status"], row["bags"], row["seed"]) == (DONE, "one", 2)
    assert row["size"] == model.size and size in row["size"]
    assert model.sampling.rate_Hz == 200.0
    assert 0.0 < row["selection_J"] < 60.0
    assert row["gain"] == model.certificate["gain"] < 1.0
    assert [(c["set"], c["recording"], c["role"]) for c in row["costs"]] == [
        ("identification", "one", "identification"),
        ("rest", "one", "validation"),
        ("other", "two", "validation"),
    ]
    again = evaluate(model, [prepare(made(2, name="two"), model.sampling)], "validation")[0].cost
    assert row["costs"][-1]["J"] == pytest.approx(again, abs=1e-5)


@pytest.fixture
def comparison(tmp_path):
    """The jobs of a campaign of the thesis' procedures, by the settings that vary, and its recording."""
    structures = (
        "{polynomial: {method: [gauss-newton, thesis], terms: 6, candidates: rules.yaml}, "
        "sigmoid: {units: 2, lags: ['1,2,3']}, anfis: {rules: 2x2}}"
    )
    (tmp_path / "rules.yaml").write_text(RULES)
    (tmp_path / "c.yaml").write_text(f"bags: {{a: one}}\nstructures: {structures}\nlimits: {{time: 10}}\n")
    campaign = load_campaign(tmp_path / "c.yaml")
    recordings = {path: made(1, name=path.name) for path in campaign.paths}
    by_settings = {j.cell.settings.get("method", j.cell.structure): j for j in jobs(campaign, recordings, "")}
    return by_settings, list(recordings.values())


def test_lags_rules_and_the_procedure_of_the_thesis_reach_the_cells(comparison):
    by_settings, recordings = comparison
    done = {name: compute_cell(job, recordings) for name, job in by_settings.items()}
    assert {name: one.row["status"] for name, one in done.items()} == dict.fromkeys(by_settings, DONE)
    models = {name: parse_model(*one.files.values(), "test") for name, one in done.items()}
    assert [(r.signal, r.lag) for r in models["sigmoid"].body.regressors] == [
        *(("force", 1), ("speed", 0), ("speed", 1), ("speed", 2), ("current", 0), ("current", 1))
    ]
    assert len(models["anfis"].body.rules) == 4
    methods = {name: models[name].provenance["selection"]["method"] for name in ("gauss-newton", "thesis")}
    assert methods == {name: f"{name}, judged by free run" for name in ("gauss-newton", "thesis")}


def test_data_that_hold_too_little_fail_the_cell_in_a_line(work):
    jobs, recordings = work
    short = made(1, seconds=1.0)
    done = compute_cell(jobs["one", "polynomial"], [short, *list(recordings.values())[1:]])
    assert done.row["status"] == FAILED
    assert done.row["reason"]
    assert "\n" not in done.row["reason"]
    assert not done.files


def test_an_unexpected_error_crashes_the_cell_only_and_is_logged(work, monkeypatch, caplog):
    def broken(*given, **more):
        raise ZeroDivisionError("one\ntwo")

    monkeypatch.setattr(module, "identify", broken)
    done = computed(work, "one", "polynomial")
    assert (done.row["status"], done.row["reason"]) == (CRASHED, "ZeroDivisionError: one two")
    assert "in broken" in caplog.text


def test_a_search_that_was_interrupted_is_no_result(work, monkeypatch):
    identify = module.identify

    def cut(*given, **more):
        result = identify(*given, **more)
        return replace(result, search_results=tuple(replace(f, ended="interrupted") for f in result.search_results))

    monkeypatch.setattr(module, "identify", cut)
    with pytest.raises(KeyboardInterrupt):
        computed(work, "one", "polynomial")
