"""What gives way in series with a damper, and the springs that yield behind it: friction (Prandtl 1928).

    w(k)   = drive(k) - mount (f(k) - f(k-1)) - creep f(k),   f = s + sum_j z_j
    z_j(k) = clip(keep z_j(k-1) + step_j w(k), -+limit_j),    limit_j = yield_j + setting moved_j

w is the speed behind the mount, s the force of the network, z_j those of the springs, which relax: a tick keeps the
share e^(-T / relax) of them (Maxwell 1867). With `left` the speed if none of them changed further, w = share (left +
shift) on pieces, since w only grows with each spring that yields.
"""

from math import inf

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.model import LARGEST, SMALLEST, are_between, clamp, lies_within
from ces_observer.tick.valve import K_VALVE_END, KEEP, N_VALVE_END, P_VALVE_END, S_VALVE_END

# p: by tick, what the mount gives [m/s/N], with its creep; the share of w while no spring yields
MOUNT_SPRING, MOUNT_GIVE, MOUNT_HELD, P_MOUNT_END = range(P_VALVE_END, P_VALVE_END + 4)

# n: the number of springs, their steps [Ns/m], yields and moved yields [N] one after the other in p; forces, limits
# [N], reaches [m/s] and what still holds [Ns/m] in s; their order by reach in k
SPRINGS, SPRING_NUMBERS, SPRING_STATES, SPRING_ORDER, N_MOUNT_END = range(N_VALVE_END, N_VALVE_END + 5)

# s: force on the mount and friction [N], w [m/s], and the piece: shift [m/s], share, and between which w it holds
PULL, FRICTION, WAY, WAY_SHIFT, WAY_SHARE, WAY_LOW, WAY_HIGH, S_MOUNT_END = range(S_VALVE_END, S_VALVE_END + 8)

K_MOUNT_END = K_VALVE_END


def mount_reset(n: Ints, s: Floats) -> None:
    """Forget the past: no force."""
    for m in range(n[SPRINGS]):
        s[n[SPRING_STATES] + m] = 0.0
    s[FRICTION] = 0.0
    s[PULL] = 0.0


def begin_mount(p: Floats, n: Ints, s: Floats, drive: float, setting: float) -> float:
    """Begin a tick at a setting of the valve; return `left` [m/s] if the network's force were 0."""
    count = n[SPRINGS]
    yields = n[SPRING_NUMBERS] + count
    forces = n[SPRING_STATES]
    total = 0.0
    for m in range(count):
        limit = p[yields + m] + setting * p[yields + count + m]
        s[forces + count + m] = limit
        s[forces + m] = clamp(p[KEEP] * s[forces + m], -limit, limit)
        total += s[forces + m]
    return drive + p[MOUNT_SPRING] * s[PULL] - p[MOUNT_GIVE] * total


def find_piece_of_way(p: Floats, n: Ints, s: Floats, k: Ints, left: float) -> None:
    """Find the piece of w at `left` [m/s]: WAY_SHIFT, WAY_SHARE, WAY_LOW and WAY_HIGH."""
    count = n[SPRINGS]
    forces = n[SPRING_STATES]
    limits = forces + count
    reaches = limits + count
    shift = 0.0
    share = p[MOUNT_HELD]
    low = 0.0
    high = inf  # that of the spring that yields first
    for m in range(count):
        change = s[limits + m] - s[forces + m] if left > 0.0 else s[limits + m] + s[forces + m]
        reach = change / p[n[SPRING_NUMBERS] + m]
        s[reaches + m] = reach
        high = reach if reach < high else high
    if not abs(share * left) <= high:
        sort_springs(p, n, s, k)
        give = -p[MOUNT_GIVE] if left > 0.0 else p[MOUNT_GIVE]
        high = inf
        for j in range(count):
            m = k[n[SPRING_ORDER] + j]
            if abs(share * (left + shift)) <= s[reaches + m]:
                high = s[reaches + m]
                break
            change = s[limits + m] - s[forces + m] if left > 0.0 else s[limits + m] + s[forces + m]
            shift += give * change
            share = 1.0 / (1.0 + p[MOUNT_GIVE] * s[reaches + count + j])
            low = s[reaches + m]
    s[WAY_SHIFT] = shift
    s[WAY_SHARE] = share
    s[WAY_LOW] = low if left > 0.0 else -high
    s[WAY_HIGH] = high if left > 0.0 else -low


def sort_springs(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Sort the springs by their reaches, and sum the steps of those behind each in that order."""
    count = n[SPRINGS]
    order = n[SPRING_ORDER]
    reaches = n[SPRING_STATES] + 2 * count
    for m in range(count):
        j = m
        while j > 0 and s[reaches + k[order + j - 1]] > s[reaches + m]:
            k[order + j] = k[order + j - 1]
            j -= 1
        k[order + j] = m
    held = 0.0
    for i in range(count):
        j = count - 1 - i
        s[reaches + count + j] = held
        held += p[n[SPRING_NUMBERS] + k[order + j]]


def end_mount(p: Floats, n: Ints, s: Floats, way: float, network: float) -> None:
    """End the tick with w [m/s] and the network's force [N]."""
    count = n[SPRINGS]
    forces = n[SPRING_STATES]
    total = 0.0
    for m in range(count):
        limit = s[forces + count + m]
        s[forces + m] = clamp(s[forces + m] + p[n[SPRING_NUMBERS] + m] * way, -limit, limit)
        total += s[forces + m]
    s[WAY] = way
    s[FRICTION] = total
    s[PULL] = network + total


def check_mount(
    p: Floats, n: Ints, numbers: int, states: int, flags: int, first_number: int, first_state: int, first_flag: int
) -> bool:
    """Return whether its tables lie behind the named places of p, s and k, and its numbers can be used."""
    count = n[SPRINGS]
    at = n[SPRING_NUMBERS]
    fits = lies_within(at, 3 * count, first_number, numbers)
    fits = fits and lies_within(n[SPRING_STATES], 4 * count, first_state, states)
    fits = fits and lies_within(n[SPRING_ORDER], count, first_flag, flags)
    fits = fits and are_between(p, at, count, 1, SMALLEST, LARGEST)
    fits = fits and are_between(p, at + count, 2 * count, 1, 0.0, LARGEST)
    return fits and p[MOUNT_SPRING] >= 0.0 and p[MOUNT_GIVE] >= 0.0 and 0.0 < p[MOUNT_HELD] <= 1.0
