"""Whether a limited process has room for what live control loads.

Libraries that run short end the whole process: Zenoh aborts where it gets no descriptor, OpenBLAS
exits where it gets no memory. So it is asked for before, and given back at once.
"""

import contextlib
import mmap
import os

DESCRIPTORS = 16  # Zenoh has 10 open when nobody is connected
MEMORY = 320 << 20  # bytes of address space; numpy and Zenoh were seen to do with 250 MB


def check_resources() -> None:
    """Have as many descriptors and as much memory as live control will want, for a moment.

    Raises
    ------
    OSError
        If this process may not have them.
    """
    with contextlib.ExitStack() as given_back:
        for descriptor in (end for _ in range(DESCRIPTORS // 2) for end in os.pipe()):
            given_back.callback(os.close, descriptor)
    # Address space alone: no page of it is touched.
    mmap.mmap(-1, MEMORY).close()
