"""The constants of SHA-256, by their definition [1]_; MAVLink's signatures need them compiled.

References
----------
.. [1] NIST FIPS 180-4, "Secure Hash Standard", sections 4.2.2 and 5.3.3.
"""

import itertools
from array import array
from functools import cache

ROUNDS = 64  # of a block, each with its constant
STATE = 8  # 32-bit words


@cache
def sha256_constants() -> "array[int]":
    """The constants of the rounds, and the initial state behind them."""
    primes = itertools.islice(
        (n for n in itertools.count(2) if all(n % below for below in range(2, n))), ROUNDS
    )
    first = list(primes)
    # The first 32 bits of the fractional parts of cube roots and of square roots.
    return array("I", [_root_fraction(n, 3) for n in first] + [
        _root_fraction(n, 2) for n in first[:STATE]
    ])  # fmt: skip


def _root_fraction(number: int, degree: int) -> int:
    """The first 32 bits of the fractional part of a root."""
    wanted, root = number << 32 * degree, 0
    for bit in reversed(range(40)):
        if (root | 1 << bit) ** degree <= wanted:
            root |= 1 << bit
    return root & 0xFFFFFFFF
