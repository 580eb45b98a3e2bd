"""A wheel's kernels once more, one after the other in a fixed order: `python -m ... DRAFT`.

numba numbers functions as it comes to them, names some of them after addresses, and keeps where
their sources lie. Flights and their processes come to them in another order each time, and pip
builds each wheel in a folder of another name, so that no two folders are the same. This compiles
what lies in one of them, for the same types of arguments, into the folder of this process; made
twice, anywhere, it has the same bytes.
"""

import sys
from importlib import import_module
from importlib.machinery import SourceFileLoader
from itertools import count
from pathlib import Path
from types import CodeType
from typing import Any


def main(draft: Path) -> None:
    """Compile everything that is found under a folder: the proxy's object file and the kernels."""
    _forget_places()
    _number_what_has_addresses()
    from mavproxy_fault.compiled import object_file
    from mavproxy_fault.numerics.compile import MADE

    if any(draft.glob("*.o")):
        object_file.make()  # first, as a function's number stands in one of its symbols
    indices = sorted(draft.rglob("*.nbi"))
    for index in indices:
        import_module(index.parent.name)  # a folder has its module's name
    dispatchers = {dispatcher._cache._impl.filename_base: dispatcher for dispatcher in MADE}
    for index in indices:
        for signature in sorted(_signatures(index), key=str):
            dispatchers[index.stem].compile(signature)


def _forget_places() -> None:
    """Let the code of all modules to come, numba's too, be that of `package/module.py`."""
    whole = SourceFileLoader.get_code

    def placeless(loader: SourceFileLoader, name: str) -> CodeType | None:
        code = whole(loader, name)
        return code and _of_file(code, f"{name.replace('.', '/')}.py")

    SourceFileLoader.get_code = placeless  # type: ignore[assignment, method-assign]


def _of_file(code: CodeType, name: str) -> CodeType:
    """The code, and all within it, under another file's name."""
    constants = [
        _of_file(one, name) if isinstance(one, CodeType) else one for one in code.co_consts
    ]
    return code.replace(co_filename=name, co_consts=tuple(constants))


def _number_what_has_addresses() -> None:
    """Make numba use numbers or qualified names where it would use addresses."""
    from numba.core.registry import CPUDispatcher
    from numba.np.ufunc import array_exprs  # type: ignore[attr-defined]

    numbers = count()
    # The module's calls of the builtin find this name first.
    array_exprs.hash = lambda _: next(numbers)
    # Functions that are given as arguments stand in the names of those that take them.
    CPUDispatcher.__repr__ = lambda given: (
        f"{given.py_func.__module__}.{given.py_func.__qualname__}"
    )


def _signatures(index: Path) -> list[Any]:
    """The types of arguments that there is code for."""
    from numba.core.caching import IndexDataCacheFile

    from mavproxy_fault.numerics.code_cache import mark

    file = IndexDataCacheFile(str(index.parent), index.stem, mark())
    return [signature for signature, *_ in file._load_index()]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
