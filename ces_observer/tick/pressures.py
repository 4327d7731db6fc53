"""The step of a hydraulic network: two chambers and a reservoir, joined by three edges whose flows rise with the drop.

Edges: P from compression to rebound chamber (piston), B from compression chamber to reservoir (base valve), E from
rebound chamber to reservoir (external valve). With pressures p_c, p_r above the reservoir's, as forces [N] on the rod
side's area, flows as speeds [m/s] of it, r = 1 + area ratio, s = r p_c - p_r, T the tick, x the stroke, d the drive:

    U_c(k) - kept U_c(k-1) = T (r w - P - B),   U_c = C_c e^(g_c x) phi(p_c)
    U_r(k) - kept U_r(k-1) = T ( -w + P - E),   U_r = C_r e^(g_r x) phi(p_r)
    w = d - M/T (f(k) - f(k-1)) - creep f(k),   f = s + sum_j z_j,   z_j(k) = clip(keep z_j(k-1) + T k_j w, -+yield_j)
    P = h (b q_P(dp) + (1 - b) y(k-1) root(dp) + A(x - M f(k-1)) passage(dp)),  dp = p_c - p_r,  b = T / (lag + T),
        y(k) = (1 - b) y(k-1) + b q_P(dp) / root(dp),  root(z) = z / sqrt(|z| + e),
        passage(z) = 2 z / (sqrt(n + 4 |z|) + sqrt(n));  likewise B with p_c and E with p_r, without A
    h = e^(fade heat(k-1)),  heat a low-pass of 100 s of |f d|

U are the volumes stored, of which a tick keeps e^(-T / leak), as if chambers leaked; C the compliances of the
chambers' oil, which change with their length, and M that of mounts in series, which may creep; w is the speed behind
them, and z_j are springs that yield there (`mount`): friction, and a fluid that the current stiffens. phi is that of
oil with air: with R the reservoir's absolute pressure, phi' = 1 + air (R / (p + R))^2, as straight pieces; below the
first it stays as soft, a void that must be refilled. q_P(dp), q_B(p_c) and q_E(p_r) are piecewise linear, increasing,
through the origin (`edges`). A valve's opening y follows its steady flow with a lag: a check that closes late passes
oil back. A >= 0 is a bypass that depends on the stroke behind the mount, such as a groove: a laminar and a turbulent
resistance in series. Oil that warms is thinner: all flows grow by h, which is held within e^(-2) and e^2.

`ces_observer.structures.hydraulic` proves that a step has one solution and that the force is bounded. A tick solves
the step on the pieces of the last one and goes on from piece to piece (Newton's method). Steps along which the convex
function, whose slopes the balances are, would rise again are halved.
"""

from math import exp, sqrt

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.curves import interpolate, is_curve
from ces_observer.tick.edges import (
    BASE, EDGE_NODES, EDGE_PIECE, EDGE_SHARE, EDGES, EXTERNAL, K_EDGES_END, LAST_ROW, LINE_FLOW, LINE_HIGH, LINE_LOW,
    LINE_SLOPE, N_EDGES_END, OPENING, P_EDGES_END, PISTON, S_EDGES_END, find_line, set_row,
)  # fmt: skip
from ces_observer.tick.model import LARGEST, SMALLEST, are_between, clamp
from ces_observer.tick.mount import (
    MOUNT_GIVE, PULL, WAY_HIGH, WAY_LOW, WAY_SHARE, WAY_SHIFT, begin_mount, end_mount, find_piece_of_way, mount_reset,
)  # fmt: skip

WARMING_S = 100.0  # in which a damper takes up its heat
WARMEST = 2.0  # growth of its flows, as a logarithm
MAX_STEPS = 300  # Newton steps and halvings of a tick
CLOSE = 1e-12  # relative change of the pressures that ends a step,
NEAR = 1e-6  # and of a Newton step that squares its error
TURN = 0.1  # share of the slope along a step, reversed, from which the step is halved,
TURN_PATIENCE = 20  # for this many steps; then none may turn
ROUNDING = 1e-9  # relative
STILL_N = 1e-6  # drops below may be rounding, whose sign says nothing: an opening stays as it is
MAX_LOGARITHM = 700.0  # of a number that a float holds

OIL_PIECES = 9

# p: r; C by tick [m/s/N] and their growths [1/m]; M [m/N]; fade [1/W] and its share of a tick; e, n and the pressure at
# which both are held [N]; the growth of friction [1/N]; the share of U kept; the ends of the pieces of phi [N]
(
    RATIO, COMPLIANCE_C, COMPLIANCE_R, GROWTH_C, GROWTH_R, SPRING, FADE, WARMING, LAMINAR, NARROW, MAX_PRESSURE,
    FRICTION_GROWTH, KEPT_VOLUME, OIL_ENDS,
) = range(P_EDGES_END, P_EDGES_END + 14)  # fmt: skip
# values at 0 N [N] and slopes of the pieces
OIL_VALUES = OIL_ENDS + OIL_PIECES + 1
OIL_SLOPES = OIL_VALUES + OIL_PIECES
P_PRESSURES_END = OIL_SLOPES + OIL_PIECES

# n: nodes of the bypass, none without one, and its tables in p: positions [m] and the logarithms of its openings
BYPASS_NODES, BYPASS_POSITIONS, BYPASS_LOGARITHMS, N_PRESSURES_END = range(N_EDGES_END, N_EDGES_END + 4)

# s: pressures [N]; volumes, and compliances at this stroke, by tick; heat [W] and 1 / h; the setting at which the edges
# are blended
(
    PRESSURE_C, PRESSURE_R, VOLUME_C, VOLUME_R, STORED_C, STORED_R, HEAT, THICKNESS, BLENDED_AT, S_PRESSURES_END,
) = range(S_EDGES_END, S_EDGES_END + 10)  # fmt: skip

# k: pieces of the oil in both chambers
OIL_C, OIL_R, K_PRESSURES_END = range(K_EDGES_END, K_EDGES_END + 3)


def pressures_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past: chambers at the reservoir's pressure, valves closed."""
    mount_reset(n, s)
    s[PRESSURE_C] = 0.0
    s[PRESSURE_R] = 0.0
    s[VOLUME_C] = 0.0
    s[VOLUME_R] = 0.0
    s[HEAT] = 0.0
    s[BLENDED_AT] = 0.0
    for edge in range(EDGES):
        s[OPENING + edge] = 0.0
        k[EDGE_PIECE + edge] = (n[EDGE_NODES + edge] - 1) // 2
        set_row(p, n, s, k, edge, 0.0)
    k[OIL_C] = find_oil(p, 0, 0.0)
    k[OIL_R] = k[OIL_C]


def advance_pressures(p: Floats, n: Ints, s: Floats, k: Ints, position: float, drive: float, setting: float) -> bool:
    """Step both pressures at a position [m], a drive [m/s] and a setting of the valve; return whether it was solved."""
    r = p[RATIO]
    small = p[LAMINAR]
    give = p[MOUNT_GIVE]
    p_c = s[PRESSURE_C]
    p_r = s[PRESSURE_R]
    c_c = p[COMPLIANCE_C] * exp(clamp(p[GROWTH_C] * position, -MAX_LOGARITHM, MAX_LOGARITHM))
    c_r = p[COMPLIANCE_R] * exp(clamp(p[GROWTH_R] * position, -MAX_LOGARITHM, MAX_LOGARITHM))
    thick = exp(-clamp(p[FADE] * s[HEAT], -WARMEST, WARMEST))  # it divides volumes instead of flows
    s[STORED_C] = c_c
    s[STORED_R] = c_r
    s[THICKNESS] = thick
    if setting != s[BLENDED_AT]:
        s[BLENDED_AT] = setting
        for edge in range(EDGES):
            if n[LAST_ROW + edge] > 0:
                set_row(p, n, s, k, edge, setting)

    # the pieces of the last step, with what does not change in this one
    oil_c = k[OIL_C]
    oil_r = k[OIL_R]
    u_c = thick * (p[KEPT_VOLUME] * s[VOLUME_C])
    u_r = thick * (p[KEPT_VOLUME] * s[VOLUME_R])
    c_c = thick * c_c
    c_r = thick * c_r
    phi_c = p[OIL_VALUES + oil_c]
    phi_r = p[OIL_VALUES + oil_r]
    soft_c = p[OIL_SLOPES + oil_c]
    soft_r = p[OIL_SLOPES + oil_r]
    c_low = p[OIL_ENDS + oil_c]
    c_high = p[OIL_ENDS + oil_c + 1]
    r_low = p[OIL_ENDS + oil_r]
    r_high = p[OIL_ENDS + oil_r + 1]
    free = begin_mount(p, n, s, drive, setting)
    left = free - give * (r * p_c - p_r)
    find_piece_of_way(p, n, s, k, left)
    shift = s[WAY_SHIFT]
    share = s[WAY_SHARE]
    low = s[WAY_LOW]
    high = s[WAY_HIGH]
    y_p = s[OPENING + PISTON]
    y_b = s[OPENING + BASE]
    y_e = s[OPENING + EXTERNAL]
    o_p = (1.0 - p[EDGE_SHARE + PISTON]) * y_p
    o_b = (1.0 - p[EDGE_SHARE + BASE]) * y_b
    o_e = (1.0 - p[EDGE_SHARE + EXTERNAL]) * y_e
    at_p = s[LINE_FLOW + PISTON]
    at_b = s[LINE_FLOW + BASE]
    at_e = s[LINE_FLOW + EXTERNAL]
    s_p = s[LINE_SLOPE + PISTON]
    s_b = s[LINE_SLOPE + BASE]
    s_e = s[LINE_SLOPE + EXTERNAL]
    p_low = s[LINE_LOW + PISTON]
    b_low = s[LINE_LOW + BASE]
    e_low = s[LINE_LOW + EXTERNAL]
    p_high = s[LINE_HIGH + PISTON]
    b_high = s[LINE_HIGH + BASE]
    e_high = s[LINE_HIGH + EXTERNAL]
    bypass = 0.0
    narrow = p[NARROW]
    rooted = sqrt(narrow)
    if n[BYPASS_NODES] > 0:
        at = n[BYPASS_POSITIONS]
        nodes = n[BYPASS_NODES]
        behind = clamp(position - p[SPRING] * s[PULL], p[at], p[at + nodes - 1])
        bypass = exp(interpolate(p, at, n[BYPASS_LOGARITHMS], nodes, behind))

    d_c = 0.0
    d_r = 0.0
    fall = 0.0
    same = True
    solved = False
    for step in range(MAX_STEPS):
        # flows and their slopes at these pressures, and what is left of the balances
        drop = p_c - p_r
        size = abs(drop) + small
        root = sqrt(size)
        across = at_p + s_p * drop + o_p * drop / root
        p_q = s_p + o_p * (0.5 * abs(drop) + small) / (size * root)
        if bypass > 0.0:
            root = sqrt(narrow + 4.0 * abs(drop))
            across += 2.0 * bypass * drop / (root + rooted)
            p_q += bypass / root
        size = abs(p_c) + small
        root = sqrt(size)
        below = at_b + s_b * p_c + o_b * p_c / root
        b_q = s_b + o_b * (0.5 * abs(p_c) + small) / (size * root)
        size = abs(p_r) + small
        root = sqrt(size)
        beyond = at_e + s_e * p_r + o_e * p_r / root
        e_q = s_e + o_e * (0.5 * abs(p_r) + small) / (size * root)
        way = thick * share * (left + shift)
        f_c = u_c - c_c * (phi_c + soft_c * p_c) + r * way - across - below
        f_r = u_r - c_r * (phi_r + soft_r * p_r) - way + across - beyond

        if step > 0 and f_c * d_c + f_r * d_r < -(TURN if step < TURN_PATIENCE else ROUNDING) * fall:
            d_c = 0.5 * d_c
            d_r = 0.5 * d_r
            same = False
            p_c -= d_c
            p_r -= d_r
        else:
            mount = thick * give * share
            own_c = c_c * soft_c + b_q
            own_r = c_r * soft_r + e_q
            both = p_q + r * mount
            a_c = own_c + p_q + r * r * mount
            a_r = own_r + p_q + mount
            determinant = own_c * a_r + own_r * (p_q + r * r * mount) + p_q * mount * (r - 1.0) * (r - 1.0)
            if not determinant > 0.0:
                break  # inputs that are no numbers
            d_c = (a_r * f_c + both * f_r) / determinant
            d_r = (both * f_c + a_c * f_r) / determinant
            fall = f_c * d_c + f_r * d_r
            same = True
            p_c += d_c
            p_r += d_r

        # the pieces on which the new pressures lie
        drop = p_c - p_r
        if not p_low < drop <= p_high:
            same = find_line(p, n, s, k, PISTON, drop) and same
            at_p = s[LINE_FLOW + PISTON]
            s_p = s[LINE_SLOPE + PISTON]
            p_low = s[LINE_LOW + PISTON]
            p_high = s[LINE_HIGH + PISTON]
        if not b_low < p_c <= b_high:
            same = find_line(p, n, s, k, BASE, p_c) and same
            at_b = s[LINE_FLOW + BASE]
            s_b = s[LINE_SLOPE + BASE]
            b_low = s[LINE_LOW + BASE]
            b_high = s[LINE_HIGH + BASE]
        if not e_low < p_r <= e_high:
            same = find_line(p, n, s, k, EXTERNAL, p_r) and same
            at_e = s[LINE_FLOW + EXTERNAL]
            s_e = s[LINE_SLOPE + EXTERNAL]
            e_low = s[LINE_LOW + EXTERNAL]
            e_high = s[LINE_HIGH + EXTERNAL]
        if not c_low < p_c <= c_high:
            same = False
            oil_c = find_oil(p, oil_c, p_c)
            phi_c = p[OIL_VALUES + oil_c]
            soft_c = p[OIL_SLOPES + oil_c]
            c_low = p[OIL_ENDS + oil_c]
            c_high = p[OIL_ENDS + oil_c + 1]
        if not r_low < p_r <= r_high:
            same = False
            oil_r = find_oil(p, oil_r, p_r)
            phi_r = p[OIL_VALUES + oil_r]
            soft_r = p[OIL_SLOPES + oil_r]
            r_low = p[OIL_ENDS + oil_r]
            r_high = p[OIL_ENDS + oil_r + 1]
        left = free - give * (r * p_c - p_r)
        if not low <= share * (left + shift) <= high:
            find_piece_of_way(p, n, s, k, left)
            same = same and shift == s[WAY_SHIFT] and share == s[WAY_SHARE]
            shift = s[WAY_SHIFT]
            share = s[WAY_SHARE]
            low = s[WAY_LOW]
            high = s[WAY_HIGH]
        close = NEAR if same else CLOSE
        if abs(d_c) <= close * (1.0 + abs(p_c)) and abs(d_r) <= close * (1.0 + abs(p_r)):
            solved = True
            break
    if not solved:
        return False

    most = p[MAX_PRESSURE]
    if not (-most <= p_c <= most and -most <= p_r <= most):
        p_c = clamp(p_c, -most, most)
        p_r = clamp(p_r, -most, most)
        oil_c = find_oil(p, oil_c, p_c)
        oil_r = find_oil(p, oil_r, p_r)
        find_line(p, n, s, k, PISTON, p_c - p_r)
        find_line(p, n, s, k, BASE, p_c)
        find_line(p, n, s, k, EXTERNAL, p_r)
        left = free - give * (r * p_c - p_r)
        find_piece_of_way(p, n, s, k, left)
    k[OIL_C] = oil_c
    k[OIL_R] = oil_r
    s[VOLUME_C] = c_c / thick * (p[OIL_VALUES + oil_c] + p[OIL_SLOPES + oil_c] * p_c)
    s[VOLUME_R] = c_r / thick * (p[OIL_VALUES + oil_r] + p[OIL_SLOPES + oil_r] * p_r)
    end_mount(p, n, s, s[WAY_SHARE] * (left + s[WAY_SHIFT]), r * p_c - p_r)
    s[HEAT] += p[WARMING] * (abs(s[PULL] * drive) - s[HEAT])
    drop = p_c - p_r
    if not -STILL_N < drop < STILL_N:
        flow = s[LINE_FLOW + PISTON] + s[LINE_SLOPE + PISTON] * drop
        s[OPENING + PISTON] = o_p + flow * sqrt(abs(drop) + small) / drop
    if not -STILL_N < p_c < STILL_N:
        flow = s[LINE_FLOW + BASE] + s[LINE_SLOPE + BASE] * p_c
        s[OPENING + BASE] = o_b + flow * sqrt(abs(p_c) + small) / p_c
    if not -STILL_N < p_r < STILL_N:
        flow = s[LINE_FLOW + EXTERNAL] + s[LINE_SLOPE + EXTERNAL] * p_r
        s[OPENING + EXTERNAL] = o_e + flow * sqrt(abs(p_r) + small) / p_r
    s[PRESSURE_C] = p_c
    s[PRESSURE_R] = p_r
    return True


def find_oil(p: Floats, piece: int, pressure: float) -> int:
    """Return the piece of phi that holds a pressure [N], searched from `piece` on."""
    j = piece
    while j < OIL_PIECES - 1 and pressure > p[OIL_ENDS + j + 1]:
        j += 1
    while j > 0 and pressure <= p[OIL_ENDS + j]:
        j -= 1
    return j


def check_pressures(p: Floats, n: Ints, numbers: int, first: int) -> bool:
    """Return whether the bypass lies behind the named places of p, which end at `first`, and numbers can be used."""
    nodes = n[BYPASS_NODES]
    logarithms = n[BYPASS_LOGARITHMS]
    fits = nodes == 0 or (
        is_curve(p, n[BYPASS_POSITIONS], logarithms, nodes, first, numbers)
        and are_between(p, logarithms, nodes, 1, -MAX_LOGARITHM, MAX_LOGARITHM)
    )
    for j in range(OIL_PIECES):
        fits = fits and p[OIL_ENDS + j] < p[OIL_ENDS + j + 1]
    fits = fits and are_between(p, OIL_SLOPES, OIL_PIECES, 1, SMALLEST, LARGEST) and p[RATIO] >= 1.0
    fits = fits and 0.0 <= p[KEPT_VOLUME] <= 1.0 and p[COMPLIANCE_C] > 0.0 and p[COMPLIANCE_R] > 0.0
    return fits and p[LAMINAR] > 0.0 and p[NARROW] > 0.0 and p[MAX_PRESSURE] > 0.0
