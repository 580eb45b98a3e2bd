"""How much numba optimises the monitor's kernels; imported before numba is."""

import contextlib
import os
from collections.abc import Iterator

OPTIMISATION = "NUMBA_OPT"


@contextlib.contextmanager
def light_compilation() -> Iterator[None]:
    """What loads numba meanwhile, or is a process begun meanwhile, compiles with less optimisation.

    It takes half the time, and the monitor's kernels, short plain loops, run as fast. numba reads
    the setting when it is loaded; one that the user has made stays.
    """
    before = os.environ.get(OPTIMISATION)
    os.environ[OPTIMISATION] = before or "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[OPTIMISATION]
