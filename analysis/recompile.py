"""A wheel's kernels once more, one after the other in a fixed order: `python -m ... DRAFT`.

numba numbers functions as it comes to them and names some of them after addresses. Flights and
their processes come to them in another order each time, so that no two folders are the same. This
compiles what lies in one of them, for the same types of arguments, into the folder of this process;
made twice it has the same bytes.
"""

import sys
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile
from numba.core.registry import CPUDispatcher
from numba.np.ufunc import array_exprs  # type: ignore[attr-defined]

from mavproxy_fault.compiled import object_file
from mavproxy_fault.numerics.code_cache import mark
from mavproxy_fault.numerics.compile import MADE


def main(draft: Path) -> None:
    """Compile the proxy's object file, and everything that is found under a folder."""
    object_file.make()  # first, as a function's number stands in one of its symbols
    numbers = count()
    # The module's calls of the builtin find this name first.
    array_exprs.hash = lambda _: next(numbers)
    # Functions that are given as arguments stand in the names of those that take them.
    CPUDispatcher.__repr__ = lambda given: (
        f"{given.py_func.__module__}.{given.py_func.__qualname__}"
    )
    indices = sorted(draft.rglob("*.nbi"))
    for index in indices:
        import_module(index.parent.name)  # a folder has its module's name
    dispatchers = {dispatcher._cache._impl.filename_base: dispatcher for dispatcher in MADE}
    for index in indices:
        for signature in sorted(_signatures(index), key=str):
            dispatchers[index.stem].compile(signature)


def _signatures(index: Path) -> list[Any]:
    """The types of arguments that there is code for."""
    file = IndexDataCacheFile(str(index.parent), index.stem, mark())
    return [signature for signature, *_ in file._load_index()]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
