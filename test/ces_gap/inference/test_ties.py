"""Ties: an alternative that leaves clearly more of the held-out gap is none."""

from __future__ import annotations

import pytest

from ces_gap.inference.ties import CLEARLY_MORE, ClosedShare, confirm_ties, leaves_clearly_more


def leaving(rms: float, width: float = 0.3) -> ClosedShare:
    """What leaves a share of the gap's RMS."""
    return ClosedShare(1.0 - rms**2, 1.0 - rms**2 - width, 1.0 - rms**2 + width)


BEST = leaving(0.52)
NAN = float("nan")


@pytest.mark.parametrize(("rms", "width", "clearly"), [(0.53, 0.3, False), (0.61, 0.3, True), (0.55, 0.01, True)])
def test_more_is_clear_by_its_size_or_beyond_the_interval(rms: float, width: float, clearly: bool) -> None:
    assert (rms > CLEARLY_MORE * 0.52) == (rms == 0.61)
    assert leaves_clearly_more(leaving(rms, width), BEST) == clearly
    assert not any(leaves_clearly_more(other, BEST) for other in (BEST, leaving(0.3), ClosedShare(NAN, NAN, NAN)))


def test_a_tie_needs_closeness_on_held_out_recordings() -> None:
    group = ("backlash", "mount_compliance", "compressibility")
    scored = {frozenset(("compressibility",)): leaving(0.82), frozenset(("mount_compliance",)): leaving(0.53)}
    assert confirm_ties([group], ["backlash"], BEST, scored) == (("backlash", "mount_compliance"),)
    assert confirm_ties([group[::2]], ["backlash"], BEST, scored) == ()
    assert confirm_ties([group], ["backlash"], BEST, {}) == (group,)  # not scored: nothing speaks against it
    assert confirm_ties((), ["backlash"], BEST, scored) == ()


def test_an_alternative_is_scored_beside_the_other_effects() -> None:
    groups = (("backlash", "compressibility"), ("friction", "inertia"))
    others = {
        frozenset(("compressibility",)): leaving(0.9),
        frozenset(("compressibility", "friction")): leaving(0.21),
        frozenset(("backlash", "inertia")): leaving(0.4),
    }
    assert confirm_ties(groups, ("friction", "backlash"), leaving(0.2), others) == (("backlash", "compressibility"),)
