"""Points of a Sobol sequence, scrambled, in as many dimensions as a sweep has axes.

Sources: Sobol 1967; primitive polynomials and initial direction numbers of Joe & Kuo 2008 (the
first 16 dimensions); scrambling by a random lower triangular matrix per dimension and a digital
shift (Matousek 1998), which keeps every stratification of the points. `core/sampling/sobol.h` has
the four dimensions that light paths need; here any point of the sequence is reckoned for itself.
"""

from __future__ import annotations

import hashlib

MAX_DIMENSIONS = 16
BITS = 32

# Degree s, inner coefficients a of the polynomial, and m_1 ... m_s, of dimensions 2 to 16.
_JOE_KUO = (
    (1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)), (4, 4, (1, 3, 5, 13)), (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)), (5, 7, (1, 1, 7, 11, 19)), (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)), (5, 14, (1, 3, 5, 5, 31)), (6, 1, (1, 3, 3, 9, 7, 49)),
    (6, 13, (1, 1, 1, 15, 21, 21)), (6, 16, (1, 3, 1, 13, 27, 49)),
)  # fmt: skip


class Sobol:
    """The sequence of one seed; the first n points are the same however many follow."""

    def __init__(self, dimensions: int, seed: int) -> None:
        """Reckon the tables of 1 to 16 dimensions."""
        if not 1 <= dimensions <= MAX_DIMENSIONS:
            raise ValueError(f"1 to {MAX_DIMENSIONS} dimensions, not {dimensions}")
        self._tables = [_tables(d, seed) for d in range(dimensions)]

    def point(self, index: int) -> tuple[float, ...]:
        """Return the coordinates, each inside (0, 1), of point `index` < 2^32."""
        a, b, c, d = index & 255, index >> 8 & 255, index >> 16 & 255, index >> 24
        return tuple(
            ((t0[a] ^ t1[b] ^ t2[c] ^ t3[d]) + 0.5) * 2.0**-BITS for t0, t1, t2, t3 in self._tables
        )


def _tables(dimension: int, seed: int) -> list[list[int]]:
    """Return what each byte of an index contributes; the shift is part of the lowest byte's."""
    *rows, shift = _random_words(dimension, seed)
    columns = [_scrambled(v, rows) for v in _directions(dimension)]
    tables = []
    for byte in range(4):
        table = [0] * 256
        for index in range(1, 256):
            lowest = (index & -index).bit_length() - 1
            table[index] = table[index & (index - 1)] ^ columns[8 * byte + lowest]
        tables.append(table)
    tables[0] = [word ^ shift for word in tables[0]]
    return tables


def _directions(dimension: int) -> list[int]:
    if dimension == 0:
        return [1 << (BITS - 1 - i) for i in range(BITS)]
    s, a, m = _JOE_KUO[dimension - 1]
    v = [m[i] << (BITS - 1 - i) for i in range(s)]
    for i in range(s, BITS):
        x = v[i - s] ^ (v[i - s] >> s)
        for k in range(1, s):
            if (a >> (s - 1 - k)) & 1:
                x ^= v[i - k]
        v.append(x)
    return v


def _scrambled(word: int, rows: list[int]) -> int:
    """Multiply by a matrix over bits: bit r (from the top) is the parity of `row r & word`."""
    out = 0
    for row in rows:
        out = out << 1 | ((row & word).bit_count() & 1)
    return out


def _random_words(dimension: int, seed: int) -> list[int]:
    """Return 32 rows of a lower triangular matrix with unit diagonal, and a shift."""
    words = []
    for row in range(BITS + 1):
        digest = hashlib.sha256(f"matiere sobol {seed} {dimension} {row}".encode()).digest()
        word = int.from_bytes(digest[:4], "big")
        if row < BITS:
            diagonal = 1 << (BITS - 1 - row)
            word = (word & ~(2 * diagonal - 1) | diagonal) & (1 << BITS) - 1
        words.append(word)
    return words
