"""The edges of a hydraulic network: flows that rise with the pressure drop, on straight pieces.

Each edge has rows of drops [N] over its flows [m/s], evenly spaced over the setting of the valve from 0 to 1, and
blended between two of them. The line of a piece is b times its flow, b = T / (lag + T) being the share of a tick.
"""

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.curves import is_curve, is_rising
from ces_observer.tick.model import lies_within
from ces_observer.tick.mount import K_MOUNT_END, N_MOUNT_END, P_MOUNT_END, S_MOUNT_END

PISTON, BASE, EXTERNAL, EDGES = range(4)

# p, for each edge: b
EDGE_SHARE, P_EDGES_END = range(P_MOUNT_END, P_MOUNT_END + 2 * EDGES, EDGES)

# n, for each edge: its nodes, the number of its last row, and its flows and rows of drops in p
EDGE_NODES, LAST_ROW, EDGE_FLOWS, EDGE_DROPS, N_EDGES_END = range(N_MOUNT_END, N_MOUNT_END + 5 * EDGES, EDGES)

# s, for each edge: the line, with b times flow at no drop and slope, and the drops at its ends; the share of the row
# above; the opening that it keeps from tick to tick
LINE_FLOW, LINE_SLOPE, LINE_LOW, LINE_HIGH, EDGE_BLEND, OPENING, S_EDGES_END = range(
    S_MOUNT_END, S_MOUNT_END + 7 * EDGES, EDGES
)

# k, for each edge: its row and piece
EDGE_ROW, EDGE_PIECE, K_EDGES_END = range(K_MOUNT_END, K_MOUNT_END + 3 * EDGES, EDGES)


def set_row(p: Floats, n: Ints, s: Floats, k: Ints, edge: int, setting: float) -> None:
    """Blend an edge's rows at a setting; the line is then that of its piece."""
    place = setting * float(n[LAST_ROW + edge])
    row = 0
    if place >= float(n[LAST_ROW + edge]):
        row = n[LAST_ROW + edge]
    elif place > 0.0:
        row = int(place)
    k[EDGE_ROW + edge] = row
    s[EDGE_BLEND + edge] = place - float(row)
    set_line(p, n, s, k, edge)


def set_line(p: Floats, n: Ints, s: Floats, k: Ints, edge: int) -> None:
    """Set the line of an edge's piece: b times the flow at no drop and the slope, and the drops [N] at its ends."""
    j = k[EDGE_PIECE + edge]
    flows = n[EDGE_FLOWS + edge] + j
    below = n[EDGE_DROPS + edge] + k[EDGE_ROW + edge] * n[EDGE_NODES + edge] + j
    above = below + n[EDGE_NODES + edge] if k[EDGE_ROW + edge] < n[LAST_ROW + edge] else below
    blend = s[EDGE_BLEND + edge]
    part = p[EDGE_SHARE + edge]
    low = p[below]
    rise = p[below + 1] - low
    steeper = p[above + 1] - p[above] - rise
    length = rise + blend * steeper
    low += blend * (p[above] - low)
    slope = part * (p[flows + 1] - p[flows]) / length
    s[LINE_FLOW + edge] = part * p[flows] - slope * low
    s[LINE_SLOPE + edge] = slope
    s[LINE_LOW + edge] = low
    s[LINE_HIGH + edge] = low + length


def find_line(p: Floats, n: Ints, s: Floats, k: Ints, edge: int, drop: float) -> bool:
    """Set the line of the piece that holds a drop [N] over an edge; return whether the piece is the same as before."""
    before = k[EDGE_PIECE + edge]
    last = n[EDGE_NODES + edge] - 2
    below = n[EDGE_DROPS + edge] + k[EDGE_ROW + edge] * n[EDGE_NODES + edge]
    above = below + n[EDGE_NODES + edge] if k[EDGE_ROW + edge] < n[LAST_ROW + edge] else below
    blend = s[EDGE_BLEND + edge]
    j = before
    while j < last and drop > p[below + j + 1] + blend * (p[above + j + 1] - p[below + j + 1]):
        j += 1
    while j > 0 and drop <= p[below + j] + blend * (p[above + j] - p[below + j]):
        j -= 1
    if j == before:
        return True
    k[EDGE_PIECE + edge] = j
    set_line(p, n, s, k, edge)
    return False


def check_edge(p: Floats, n: Ints, numbers: int, first: int, edge: int) -> bool:
    """Return whether an edge's flows and all of its rows rise, behind the named places of p, which end at `first`."""
    nodes = n[EDGE_NODES + edge]
    rows = n[LAST_ROW + edge] + 1
    drops = n[EDGE_DROPS + edge]
    if not (2 <= nodes <= numbers and 1 <= rows <= numbers and 0.0 < p[EDGE_SHARE + edge] <= 1.0):
        return False
    fits = is_curve(p, n[EDGE_FLOWS + edge], drops, nodes, first, numbers)
    if not (fits and lies_within(drops, rows * nodes, first, numbers)):
        return False
    for row in range(rows):
        if not is_rising(p, drops + row * nodes, nodes):
            return False
    return True
