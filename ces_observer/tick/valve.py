"""The path from the current to the setting of a valve, from 0 to 1: dead time, remanence, characteristic, pilot lag.

    delayed(k) = current(k - delay), interpolated between ticks
    play_j(k)  = clip(d + keep (play_j(k-1) - d), d -+ half_j),  d = delayed(k),  keep = e^(-T / relax)
    remanence  = mean of the plays, whose half widths are 1/3, 1 and 5/3 of the hysteresis (Prandtl-Ishlinskii operator)
    target     = characteristic(remanence), rising from 0 to 1, constant beyond its ends
    setting(k) = setting(k-1) + T / (lag + T) (target - setting(k-1)), with one lag for rising and one for falling

Every stage is driven by the current alone, and the difference of two pasts only falls: the setting stays within 0 to 1.
"""

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.curves import find_on_line, interpolate, is_curve, is_rising
from ces_observer.tick.model import K_STRUCTURE, N_STRUCTURE, P_STRUCTURE, S_STRUCTURE, STARTED, clamp, lies_within

PLAYS = 3
MAX_DELAY = 1000  # ticks

# p: the part of a tick in the delay, the shares T / (lag + T), and the half widths of the plays [A], 0
# without them; KEEP, the share of what is stored that a tick keeps
VALVE_PART, VALVE_RISE, VALVE_FALL, PLAY_HALF = range(P_STRUCTURE, P_STRUCTURE + 4)
KEEP = PLAY_HALF + PLAYS
P_VALVE_END = KEEP + 1

# n: whole ticks of the delay, the nodes of the characteristic, and the ring of past currents in s
VALVE_DELAY, VALVE_NODES, VALVE_CURRENTS, VALVE_SETTINGS, VALVE_RING, N_VALVE_END = range(N_STRUCTURE, N_STRUCTURE + 6)

# s: the setting, and the places of the plays [A]
SETTING, PLAY = range(S_STRUCTURE, S_STRUCTURE + 2)
S_VALVE_END = PLAY + PLAYS

# k: the place of the newest current in the ring
RING_NEWEST, K_VALVE_END = range(K_STRUCTURE, K_STRUCTURE + 2)


def valve_start(p: Floats, n: Ints, s: Floats, k: Ints, current: float) -> None:
    """Begin: all earlier currents equal the first one [A], in the middle of the magnetic loop."""
    for j in range(n[VALVE_DELAY] + 2):
        s[n[VALVE_RING] + j] = current
    k[RING_NEWEST] = 0
    for j in range(PLAYS):
        s[PLAY + j] = current
    steady = interpolate(p, n[VALVE_CURRENTS], n[VALVE_SETTINGS], n[VALVE_NODES], current)
    s[SETTING] = clamp(steady, 0.0, 1.0)


def valve_tick(p: Floats, n: Ints, s: Floats, k: Ints, current: float) -> float:
    """Return the setting after this tick's current [A]."""
    if k[STARTED] == 0:
        valve_start(p, n, s, k, current)
    ring = n[VALVE_RING]
    size = n[VALVE_DELAY] + 2
    newest = k[RING_NEWEST] + 1 if k[RING_NEWEST] + 1 < size else 0
    older = newest + 1 if newest + 1 < size else 0
    newer = older + 1 if older + 1 < size else 0
    s[ring + newest] = current
    k[RING_NEWEST] = newest
    remanent = s[ring + newer] + p[VALVE_PART] * (s[ring + older] - s[ring + newer])
    if p[PLAY_HALF] > 0.0:
        total = 0.0
        for j in range(PLAYS):
            half = p[PLAY_HALF + j]
            kept = remanent + p[KEEP] * (s[PLAY + j] - remanent)
            s[PLAY + j] = clamp(kept, remanent - half, remanent + half)
            total += s[PLAY + j]
        remanent = total / 3.0
    nodes = n[VALVE_NODES]
    currents = n[VALVE_CURRENTS]
    target = 0.0
    if remanent > p[currents + nodes - 1]:
        target = 1.0
    elif not remanent <= p[currents]:
        target = find_on_line(p, currents, n[VALVE_SETTINGS], nodes, remanent)
    setting = s[SETTING]
    change = target - setting
    setting += (p[VALVE_RISE] if change > 0.0 else p[VALVE_FALL]) * change
    s[SETTING] = setting
    return setting


def check_valve(p: Floats, n: Ints, numbers: int, states: int, first_number: int, first_state: int) -> bool:
    """Return whether its tables lie behind the named places of p and s, and its numbers can be used."""
    nodes = n[VALVE_NODES]
    settings = n[VALVE_SETTINGS]
    fits = is_curve(p, n[VALVE_CURRENTS], settings, nodes, first_number, numbers) and is_rising(p, settings, nodes)
    fits = fits and p[settings] == 0.0 and p[settings + nodes - 1] == 1.0 and 0.0 <= p[VALVE_PART] < 1.0
    fits = fits and 0.0 < p[VALVE_RISE] <= 1.0 and 0.0 < p[VALVE_FALL] <= 1.0 and 0 <= n[VALVE_DELAY] <= MAX_DELAY
    fits = fits and 0.0 <= p[KEEP] <= 1.0
    return fits and lies_within(n[VALVE_RING], n[VALVE_DELAY] + 2, first_state, states)
