"""A number that depends on how every operation of the tick rounds; the compiled core must give it bit for bit.

`ces_observer.core` computes it in Python and in the compiled core before that is used: a compiler may fuse a product
and a sum into one rounding, and libraries differ in the last digits of `exp` and its like.
"""

from math import cos, exp, floor, isfinite, log, pow, sin, sqrt, tanh


def rounding_sample(seed: int) -> float:
    """Return a number that pseudo-random products, sums and functions make from a seed from 0 to 2^31 - 1."""
    state = seed
    total = 0.0
    for i in range(32):
        state = (state * 1103515245 + 12345) % 2147483648
        x = float(state) / 2147483648.0
        state = (state * 1103515245 + 12345) % 2147483648
        y = float(state) / 2147483648.0 + 0.5
        total = total * x - (x * y - sqrt(y)) * float(i)
        total = total + exp(x) * tanh(total) / y
        total = total + log(y) * sin(total) - cos(y * total)
        total = total + pow(y, x) * (total * y + x * x) / (1.0 + abs(total))
        total = total - float(floor(total))
    return total if isfinite(total) else 0.0
