import numpy as np
from residual_series import coloured, single_run

from ces_identify.numerics.correlation import autocorrelation, covariance, find_runs, longest_memory, memory


def remembered(x):
    most = longest_memory(len(x), single_run(len(x)))
    return memory(autocorrelation(x, single_run(len(x)), most + 5), len(x), most)


def slow_covariance(x, y, runs, most):
    sums, pairs = np.zeros(most + 1), np.zeros(most + 1)
    for start, stop in runs:
        for k in range(start, stop):
            for lag in range(most + 1):
                if k + lag < stop:
                    sums[lag] += x[k] * y[k + lag]
                    pairs[lag] += 1
    return sums, pairs


def test_no_product_spans_a_gap():
    random = np.random.default_rng(1)
    x, y = random.normal(size=(2, 60))
    runs = np.array([[0, 25], [25, 28], [28, 60]])
    for ours, slow in zip(covariance(x, y, runs, 10), slow_covariance(x, y, runs, 10), strict=True):
        np.testing.assert_allclose(ours, slow, atol=1e-12)
    assert not np.allclose(covariance(x, y, runs, 10)[0], covariance(x, y, single_run(60), 10)[0])


def test_runs_end_at_gaps_and_at_ticks_left_out():
    mask = np.array([0, 1, 1, 0, 1, 1, 1, 1, 0, 0, 1], bool)
    segments = np.array([[0, 6], [6, 11]])
    np.testing.assert_array_equal(find_runs(mask, segments), [[0, 2], [2, 4], [4, 6], [6, 7]])


def test_memory_grows_with_the_pole_and_is_nothing_for_white_noise():
    lengths = [remembered(coloured(5000, pole, 3)) for pole in (0.0, 0.5, 0.9, 0.97)]
    assert lengths[0] <= 1
    assert lengths == sorted(lengths)
    assert 20 < lengths[2] < 60  # 0.9^k falls below 2 sqrt(log10(n) / n) = 0.054 at k = 28


def test_memory_of_what_never_forgets_is_bounded():
    assert remembered(np.sin(np.arange(4000) / 10.0)) == round(2 * np.sqrt(4000))
