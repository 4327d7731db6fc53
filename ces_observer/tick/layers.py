"""Affine layers y = W x + b, whose sums have one order everywhere: that of the columns, then the bias."""

from ces_observer.tick.arrays import Floats


def apply_layer(p: Floats, s: Floats, table: int, rows: int, width: int, x: int, y: int) -> None:
    """Set `rows` numbers from s[y] on; p[table] begins W, whose rows of `width` numbers each end with their bias.

    Four rows at a time share the reading of x, and no addition waits for the one before it.
    """
    row_size = width + 1
    end = x + width
    last = y + rows
    first = table - x
    while y + 4 <= last:
        second = first + row_size
        third = second + row_size
        fourth = third + row_size
        a = 0.0
        b = 0.0
        c = 0.0
        d = 0.0
        for j in range(x, end):
            value = s[j]
            a += p[first + j] * value
            b += p[second + j] * value
            c += p[third + j] * value
            d += p[fourth + j] * value
        s[y] = a + p[first + end]
        s[y + 1] = b + p[second + end]
        s[y + 2] = c + p[third + end]
        s[y + 3] = d + p[fourth + end]
        first = fourth + row_size
        y += 4
    while y < last:
        a = 0.0
        for j in range(x, end):
            a += p[first + j] * s[j]
        s[y] = a + p[first + end]
        first += row_size
        y += 1
