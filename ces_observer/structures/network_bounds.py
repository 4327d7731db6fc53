"""How much a sigmoid network's past forces can count for, and what its inputs alone can make: proved bounds.

The slope s' of a sigmoid lies in (0, 1/4]. Between two pasts the mean value theorem gives the output's change as
sum_j g_j (change of y(k - j)) with g_j in the interval sum over (linear_j + sum_i weight_i slope_ij s'_i), whatever
the inputs. So sum_j max |g_j| < 1 makes the recursion a contraction, and from a past of zeros
|y| <= max |b| / (1 - sum) for ever, b being the output at a past of zeros: bounded over the input envelope by interval
arithmetic, outward rounded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ces_observer.proof.intervals import Interval, added, down, largest, product, up
from ces_observer.structures.lagged import Range, Regressor
from ces_observer.structures.network import Network, sigmoid

CLAIM = (
    "sum_j |dF/dF(k-j)| <= gain < 1 for any past and inputs; "
    "|F| <= drive_N for a past of zeros and every input in the input envelope"
)
METHOD = "slope of every sigmoid in (0, 1/4]; interval arithmetic, outward rounding"
SLOPE: Interval = (0.0, 0.25)
ROUNDING = 1e-15  # relative error of exp, an addition and a division, with room


def bounds(network: Network, envelope: Mapping[str, Range]) -> tuple[float, float]:
    """Return upper bounds on the sum of absolute gains of past forces, and on |force| [N] at a past of zeros."""
    gain = 0.0
    for j, regressor in enumerate(network.regressors):
        if regressor.signal == "force":
            gain = up(gain + up(largest(_slope(network, j)) * up(network.scale_N / regressor.spread)))
    return gain, up(largest(_drive(network, envelope)) * network.scale_N)


def regressor_interval(regressor: Regressor, envelope: Mapping[str, Range]) -> Interval:
    """Return an interval that holds a regressor for every input in the envelope, and past forces of zero."""
    low, high = envelope.get(regressor.signal, (0.0, 0.0))
    shifted = added((low, high), (-regressor.mean, -regressor.mean))
    return down(shifted[0] / regressor.spread), up(shifted[1] / regressor.spread)


def affine(constant: float, slopes: Sequence[float], at: Sequence[Interval]) -> Interval:
    """Return an interval that holds constant + slopes . x for every x in the box `at`."""
    total = (constant, constant)
    for slope, interval in zip(slopes, at, strict=True):
        total = added(total, product((slope, slope), interval))
    return total


def _slope(network: Network, j: int) -> Interval:
    """Return an interval that holds the derivative of the scaled output with respect to regressor j."""
    total = (network.linear[j], network.linear[j])
    for unit in network.units:
        steepest = product((unit.weight, unit.weight), (unit.slopes[j], unit.slopes[j]))
        total = added(total, product(steepest, SLOPE))
    return total


def _drive(network: Network, envelope: Mapping[str, Range]) -> Interval:
    at = [regressor_interval(r, envelope) for r in network.regressors]
    total = affine(network.constant, network.linear, at)
    for unit in network.units:
        low, high = affine(unit.bias, unit.slopes, at)
        risen = sigmoid(low) * (1.0 - ROUNDING), min(1.0, sigmoid(high) * (1.0 + ROUNDING))
        total = added(total, product((unit.weight, unit.weight), risen))
    return total
