"""Campaigns vary the sizes of structures with physics inside; their models are proved though they have no gain."""

import pytest
from campaign_parts import made

from ces_identify.campaign.cell import compute_cell
from ces_identify.campaign.plan import CampaignError, jobs, load_campaign
from ces_identify.campaign.rows import front, is_proved
from ces_identify.jobs import DONE
from ces_observer.model import parse_model

CAMPAIGN = """\
bags: {one: [one]}
structures:
  relaxation: {springs: [1, auto]}
  chambers: {curves: 2}
seed: [1]
limits: {time: 3}
"""


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    path = tmp_path_factory.mktemp("physical") / "c.yaml"
    path.write_text(CAMPAIGN)
    campaign = load_campaign(path)
    recordings = {one: made(1, name=one.name) for one in campaign.paths}
    return [compute_cell(job, [recordings[p] for p in job.paths]) for job in jobs(campaign, recordings, "")]


def test_every_size_is_a_cell_with_a_proved_model(rows):
    assert [done.row["status"] for done in rows] == [DONE] * 3
    assert [done.row["structure"] for done in rows] == ["relaxation", "relaxation", "chambers"]
    for done in rows:
        model = parse_model(*done.files.values(), "test")
        assert done.row["gain"] is None
        assert is_proved(done.row)
        assert model.certificate["force_bound_any_input_N"] > 0.0
        assert done.row["selection_J"] < 20.0
    springs = [len(parse_model(*done.files.values(), "test").body.springs) for done in rows[:2]]
    assert springs == [2, 3]  # and the slow one


def test_they_are_on_the_front_beside_models_with_a_gain(rows):
    proved = [done.row for done in rows]
    polynomial = {**proved[0], "parameters": 5, "selection_J": 50.0, "gain": 0.9}
    unproved = {**proved[0], "parameters": 3, "selection_J": 0.1, "force_bound_N": None}
    on_front = front([*proved, polynomial, unproved])
    assert polynomial in on_front
    assert unproved not in on_front
    assert on_front[-1] in proved


def test_a_size_out_of_range_is_refused(tmp_path):
    (tmp_path / "c.yaml").write_text(CAMPAIGN.replace("curves: 2", "curves: 40"))
    with pytest.raises(CampaignError, match=r"curves: .*40.*2 to 8"):
        load_campaign(tmp_path / "c.yaml")
