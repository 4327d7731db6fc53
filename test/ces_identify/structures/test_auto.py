"""How structures are compared: what is left out of short fits, ties, and what is said of them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from planted import NETWORK, planted

from ces_identify.polynomial.search_limits import TIME_IS_UP, Limits
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import Series, prepare
from ces_identify.structures import KITS, auto
from ces_identify.structures.auto import DIFFERENCE, LEFT_OUT, TIE, BestStructure, advise, default_sizes, select_fitter
from ces_identify.structures.kit import Fitted, IdentifyOptions
from ces_identify.structures.left_out import choose_left_out, compare_costs, cost_of
from ces_observer.errors import CesError

RATE_HZ = 200.0
PHYSICAL = next(name for name, kit in KITS.items() if kit.models)


def make_series(current, speed, name="made"):
    """A series with a current [A] and a speed [m/s] at each tick."""
    n = len(current)
    force = 1000.0 * speed * current
    plain = {"position": np.cumsum(speed) / RATE_HZ, "speed": speed, "current": current, "force": force}
    segments, scored = np.array([[0, n]]), np.ones(n, bool)
    return Series(
        name, RATE_HZ, np.arange(n) / RATE_HZ, **plain, segments=segments, scored=scored, warm_up=0, dropped={}
    )


def dyno(currents=(0.3, 0.4, 0.5, 0.6), speeds=(0.1, 0.3, 0.6, 0.9, 1.2), seconds=3.0):
    """Sines of several peak speeds for each of several held currents."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    cells = [(i, v) for i in currents for v in speeds]
    current = np.concatenate([np.full(len(t), i) for i, _ in cells])
    return make_series(current, np.concatenate([v * np.sin(2 * np.pi * 3 * t) for _, v in cells]))


def test_a_current_and_a_speed_are_left_out_where_conditions_are_held():
    one = dyno()
    first, second = choose_left_out([one])
    assert (first.about, second.about) == (
        "current 0.4 A and peak speed 0.9 m/s",
        "current 0.5 A and peak speed 0.3 m/s",
    )
    (mask,) = first.masks
    assert set(np.unique(one.current[~mask])) == {0.3, 0.5, 0.6}
    assert np.abs(one.speed[mask & (one.current != 0.4)]).max() == pytest.approx(0.9)
    hidden = first.hide([one])[0]
    assert np.isnan(hidden.force[mask]).all() and not hidden.scored[mask].any()
    assert (hidden.force[~mask] == one.force[~mask]).all()


def test_recordings_of_one_current_each_are_left_out_whole_and_noise_on_the_current_is_none():
    random = np.random.default_rng(0)
    rides = random.normal(0.0, 0.3, (3, 4000))
    held = [make_series(i + random.normal(0.0, 0.005, 4000), v) for i, v in zip((0.2, 0.6, 1.0), rides, strict=True)]
    (fold,) = choose_left_out(held)
    assert fold.about == "current 0.6 A"
    assert [one.current.mean() for one in fold.hide(held)] == pytest.approx([0.2, 1.0], abs=0.01)


@pytest.mark.parametrize(
    "series",
    [
        dyno(currents=(0.3, 0.6), speeds=(0.1, 0.3)),
        make_series(0.5 + 0.2 * np.sin(np.arange(6000) / 40.0), np.random.default_rng(1).normal(0.0, 0.3, 6000)),
        make_series(np.full(6000, 0.5), np.random.default_rng(2).normal(0.0, 0.3, 6000)),
        make_series(np.linspace(0.3, 0.7, 900), np.sin(np.arange(900) / 9.0)),
    ],
)
def test_blocks_are_left_out_elsewhere(series):
    (fold,) = choose_left_out([series])
    assert fold.about.startswith("every fourth block")
    (mask,) = fold.masks
    assert 0.1 < mask.mean() < 0.3
    assert (fold.units[0][1:] >= fold.units[0][:-1]).all()


def squares(errors):
    return np.array([errors, np.ones(len(errors))])


def test_a_difference_has_an_interval_and_only_a_clear_one_counts():
    random = np.random.default_rng(0)
    noise = random.uniform(0.5, 1.5, 12)
    found = {"a": squares(noise), "b": squares(1.5 * noise * random.uniform(0.9, 1.1, 12)), "c": squares(noise[::-1])}
    clear, none = compare_costs(found, "a", "b"), compare_costs(found, "a", "c")
    assert clear.low < clear.ratio < clear.high and clear.ratio == pytest.approx(1.5**0.5, rel=0.05)
    assert (clear.is_none, none.is_none) == (False, True)
    assert cost_of(found["a"]) == pytest.approx(100.0 * np.sqrt(noise.mean()))
    assert compare_costs({"a": squares([1.0]), "b": squares([9.0])}, "a", "b").is_none  # one observation says nothing


def judge(by_name, chosen=""):
    return auto._judge(auto._Comparison("blocks", by_name), chosen)


def test_a_tie_is_said_and_the_structure_with_more_physics_is_taken():
    noise = np.random.default_rng(0).uniform(0.5, 1.5, 12)
    tied = judge({"polynomial": squares(noise), PHYSICAL: squares(1.001 * noise[::-1]), "anfis": squares(9.0 * noise)})
    assert tied["structure"] == PHYSICAL
    assert tied[TIE].startswith(f"{PHYSICAL} and polynomial cannot be told apart: {PHYSICAL} ")
    assert list(tied["structures"])[-1] == "anfis" and tied[LEFT_OUT] == "blocks"
    clear = judge({"polynomial": squares(noise), PHYSICAL: squares(2.0 * noise)})
    assert clear["structure"] == "polynomial" and TIE not in clear
    assert clear[DIFFERENCE].startswith(f"J of {PHYSICAL} is 1.41 times that of polynomial (95 %: ")
    kept = judge({"polynomial": squares(2.0 * noise), PHYSICAL: squares(noise)}, "polynomial")
    assert kept["structure"] == "polynomial" and TIE not in kept
    assert f"--structure {PHYSICAL}" in advise(kept["structures"], "polynomial")


@pytest.fixture
def kits(monkeypatch):
    """Structures without a fit, each with an error of its own."""
    fitted = []

    def kit(option, error_N, models=None):
        def fit(series, sampling, options, listener):
            fitted.append((option, options.limits.work, sum(int(one.scored.sum()) for one in series)))
            if error_N is None:
                raise CesError("cannot be fitted")
            ended = TIME_IS_UP if options.limits.time < 1.0 else "done"
            return SimpleNamespace(model=option, results=[SimpleNamespace(ended=ended)])

        return SimpleNamespace(models=models, fitter=lambda sizes: fit, sizes=())

    errors = {"polynomial": 50.0, "hydraulic": 10.0, "other": None}
    made = {name: kit(name, e, models=name == "hydraulic" or None) for name, e in errors.items()}
    monkeypatch.setattr(auto, "KITS", made)
    noise = np.random.default_rng(0)

    def run(model, inputs, segments):
        return 1000.0 * inputs[1] * inputs[2] + errors[model] * noise.normal(size=inputs.shape[1]), None

    monkeypatch.setattr(auto, "run_batch", run)
    return fitted


def test_all_are_fitted_shortly_to_the_same_part_and_those_that_fail_are_left_out(kits):
    series = [dyno(currents=(0.3, 0.6), speeds=(0.1, 0.3))]
    found = auto._compare(("polynomial", "hydraulic", "other"), {}, series, NETWORK.sampling, IdentifyOptions())
    assert set(found.squares) == {"polynomial", "hydraulic"}
    assert {work for _, work, _ in kits} == {auto.SHORT_WORK}
    (ticks,) = {ticks for _, _, ticks in kits}
    assert ticks < len(series[0])
    assert judge(found.squares)["structure"] == "hydraulic"
    assert found.about == "every fourth block of 3 s"
    hurried = IdentifyOptions(limits=Limits(time=1.0))
    assert TIME_IS_UP in auto._compare(("polynomial",), {}, series, NETWORK.sampling, hurried).about


@pytest.mark.parametrize(("option", "shares"), [("polynomial", [0.65, 1.0]), (auto.AUTO, [0.35, 1.0])])
def test_a_time_limit_holds_for_fit_and_comparison_together(monkeypatch, option, shares):
    times = []

    def take(limits, result):
        times.append(limits.time)
        return result

    kits = {
        name: SimpleNamespace(
            models=models, fitter=lambda sizes: lambda *how: take(how[2].limits, Fitted(None, [], {}))
        )
        for name, models in (("polynomial", None), (PHYSICAL, True))
    }
    none = auto._Comparison("", {"polynomial": squares(np.ones(4))})
    monkeypatch.setattr(auto, "KITS", kits)
    monkeypatch.setattr(auto, "_compare", lambda *how: take(how[4].limits, none))
    select_fitter(option, {})([], None, IdentifyOptions(limits=Limits(time=1000.0)), None)
    assert times == pytest.approx([1000.0 * share for share in shares], abs=1.0)


@pytest.mark.parametrize(
    ("costs", "named"),
    [
        ({"polynomial": 5.0, "hydraulic": 4.4}, "hydraulic"),
        ({"polynomial": 5.0, "hydraulic": 4.6}, ""),
        ({"polynomial": 5.0, "hydraulic": 5.5}, ""),
        ({"polynomial": 5.0, "hydraulic": 4.0, "recurrent": 3.0}, "recurrent"),
        ({"polynomial": 5.0}, ""),
    ],
)
def test_advice_names_the_best_structure_only_if_it_is_clearly_better(costs, named):
    sentence = advise(costs, "polynomial")
    assert bool(sentence) == bool(named)
    assert not named or (f"--structure {named}" in sentence and f"{costs[named]:.2f} %" in sentence)


def test_a_physical_structure_is_not_compared_and_auto_compares_all():
    sizes = default_sizes()
    assert select_fitter("auto", sizes) == BestStructure(sizes)
    alone, own = select_fitter(PHYSICAL, sizes), KITS[PHYSICAL].fitter(sizes)
    assert (alone.func, alone.args) == (own.func, own.args)


@pytest.mark.slow
def test_auto_gives_the_same_answer_with_any_number_of_threads():
    recording = planted(NETWORK, 1)
    sampling = choose_sampling([recording])
    series = [prepare(recording, sampling)]

    def fit(threads):
        options = IdentifyOptions(limits=Limits(terms=4, starts=2, threads=threads))
        return BestStructure(default_sizes(), ("polynomial", "anfis"))(series, sampling, options, lambda result: None)

    one, four = fit(1), fit(4)
    assert one.model == four.model
    assert one.how == four.how
