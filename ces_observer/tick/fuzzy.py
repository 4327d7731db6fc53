"""A neuro-fuzzy model (ANFIS: first-order Takagi-Sugeno rules, generalised-bell memberships; Jang 1993).

force = scale * (sum over rules of firing * (constant + linear . phi)) / sum over rules of firing, with phi the lagged
regressors. A rule's firing is the product of one membership of each premise; a premise is a lagged input x, and
a membership 1 / (1 + |(x - centre) / width|^exponent).
"""

from math import inf, pow

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.lagged import LAGGED_COUNT, LAGGED_PHI, N_LAGGED, check_lagged, lagged_force, lagged_inputs
from ces_observer.tick.lagged import apply_layer
from ces_observer.tick.model import LARGEST, P_STRUCTURE, SMALLEST, S_STRUCTURE, are_between, are_indices, lies_within

# p: force for an output of 1 [N]
FUZZY_SCALE, P_FUZZY = range(P_STRUCTURE, P_STRUCTURE + 2)

# n: premises, whose values are the last regressors; bells and rules; where these begin: in p the bells (centre, width,
# exponent) and the layer of the rules; in n the premise of each bell and the bells of each rule; in s the memberships,
# the outputs of the rules and their firings
(
    FUZZY_PREMISES, FUZZY_BELLS, FUZZY_RULES, FUZZY_SHAPES, FUZZY_LAYER, FUZZY_OWNERS, FUZZY_CHOICES, FUZZY_MEMBERSHIPS,
    FUZZY_OUTPUTS, FUZZY_FIRINGS, N_FUZZY,
) = range(N_LAGGED, N_LAGGED + 11)  # fmt: skip

# s: the firings of all rules together
FUZZY_FIRED, S_FUZZY = range(S_STRUCTURE, S_STRUCTURE + 2)

# so that no power overflows
MAX_FUZZY_DISTANCE = 2e15  # of an input from a centre, in widths
MAX_FUZZY_EXPONENT = 20.0


def fuzzy_memberships(p: Floats, n: Ints, s: Floats) -> None:
    """Fill in the memberships of the premises in s."""
    first = n[FUZZY_MEMBERSHIPS]
    owner = n[FUZZY_OWNERS]
    shape = n[FUZZY_SHAPES]
    premises = n[LAGGED_PHI] + n[LAGGED_COUNT] - n[FUZZY_PREMISES]
    for i in range(first, first + n[FUZZY_BELLS]):
        distance = abs((s[premises + n[owner]] - p[shape]) / p[shape + 1])
        if distance > MAX_FUZZY_DISTANCE:
            distance = MAX_FUZZY_DISTANCE
        s[i] = 1.0 / (1.0 + pow(distance, p[shape + 2]))
        owner += 1
        shape += 3


def fuzzy_force(p: Floats, n: Ints, s: Floats) -> float:
    """Return the force [N] at the regressors in s, and leave memberships, outputs and firings there."""
    fuzzy_memberships(p, n, s)
    premises = n[FUZZY_PREMISES]
    rules = n[FUZZY_RULES]
    output = n[FUZZY_OUTPUTS]
    firings = n[FUZZY_FIRINGS]
    choice = n[FUZZY_CHOICES]
    memberships = n[FUZZY_MEMBERSHIPS]
    apply_layer(p, s, n[FUZZY_LAYER], rules, n[LAGGED_COUNT] - premises, n[LAGGED_PHI], output)
    fired = 0.0
    total = 0.0
    for i in range(firings, firings + rules):
        firing = 1.0
        for j in range(choice, choice + premises):
            firing *= s[memberships + n[j]]
        s[i] = firing
        fired += firing
        total += firing * s[output]
        choice += premises
        output += 1
    s[FUZZY_FIRED] = fired
    return p[FUZZY_SCALE] * total / fired if fired != 0.0 else inf


def fuzzy_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    lagged_inputs(p, n, s, k, position, speed, current)
    return lagged_force(p, n, s, k, fuzzy_force(p, n, s))


def check_fuzzy(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays p, n, s and k of these sizes."""
    if counts < N_FUZZY or numbers < P_FUZZY or states < S_FUZZY:
        return False
    premises = n[FUZZY_PREMISES]
    bells = n[FUZZY_BELLS]
    rules = n[FUZZY_RULES]
    shapes = n[FUZZY_SHAPES]
    if not (check_lagged(p, n, numbers, counts, states, flags) and 1 <= premises < n[LAGGED_COUNT]):
        return False
    fits = 1 <= rules <= states and lies_within(n[FUZZY_MEMBERSHIPS], bells, 0, states)
    fits = fits and lies_within(n[FUZZY_OUTPUTS], rules, 0, states) and lies_within(n[FUZZY_FIRINGS], rules, 0, states)
    fits = fits and lies_within(n[FUZZY_LAYER], rules * (n[LAGGED_COUNT] - premises + 1), 0, numbers)
    fits = fits and lies_within(shapes, 3 * bells, 0, numbers) and lies_within(n[FUZZY_OWNERS], bells, 0, counts)
    fits = fits and lies_within(n[FUZZY_CHOICES], rules * premises, 0, counts)
    fits = fits and are_indices(n, n[FUZZY_OWNERS], bells, 1, 0, premises)
    fits = fits and are_indices(n, n[FUZZY_CHOICES], rules * premises, 1, 0, bells)
    fits = fits and are_between(p, shapes + 1, bells, 3, SMALLEST, LARGEST)
    return fits and are_between(p, shapes + 2, bells, 3, SMALLEST, MAX_FUZZY_EXPONENT)
