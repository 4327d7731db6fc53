"""Small recordings and a small campaign for the tests of campaigns."""

from small_recordings import RULES, columns_as_channels, make_columns, write_columns

from ces_data.recording import Recording

RATE_HZ = 250.0
CAMPAIGN = """\
bags:
  one: [one]
  both: [one, two]
validate:
  other: two
structures:
  polynomial: {terms: [2, 4], candidates: rules.yaml}
  sigmoid: {units: 2}
seed: [1, 2]
limits: {time: 600}
"""


def made(seed, seconds=8.0, name="made"):
    """A recording of a damper whose force depends on the root of speed and on current."""
    channels = columns_as_channels(*make_columns(seconds, seed, RATE_HZ))
    return Recording(name, channels, sha256=f"made from {seed}")


def furnish(folder, text=CAMPAIGN):
    """Write two bags, candidate rules and a campaign into `folder`; return the campaign's path."""
    for seed, name in enumerate(("one", "two"), start=1):
        write_columns(folder / name, *make_columns(8.0, seed, RATE_HZ))
    (folder / "rules.yaml").write_text(RULES)
    (folder / "campaign.yaml").write_text(text)
    return folder / "campaign.yaml"
