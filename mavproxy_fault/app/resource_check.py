"""Checks that the process may use the descriptors and memory that live control needs.

Without them Zenoh aborts the process and OpenBLAS exits. So they are requested beforehand and
released at once.
"""

import contextlib
import mmap
import os

DESCRIPTORS = 16  # Zenoh opens 10 without a client; the rest is margin
MEMORY = 320 << 20  # bytes of address space; numpy and Zenoh were observed to need 250 MB


def check_resources() -> None:
    """Acquire the descriptors and memory that live control needs, and release them.

    Raises
    ------
    OSError
        If the limits of the process are too low.
    """
    with contextlib.ExitStack() as given_back:
        for descriptor in (end for _ in range(DESCRIPTORS // 2) for end in os.pipe()):
            given_back.callback(os.close, descriptor)
    # Address space only: no page is touched.
    mmap.mmap(-1, MEMORY).close()
