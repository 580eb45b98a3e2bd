"""The folders of compiled functions' machine code, one for each state of the sources.

numba checks only a function's own file for changes, but our functions are inlined into each other
and contain constants of other files: after an update numba would use outdated code. So the folder
is named after a digest of all files involved in compiled code. Nothing here imports numba.
"""

import ast
import hashlib
import os
import re
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from mavproxy_fault.documents.atomic_file import write_atomic
from mavproxy_fault.numerics.baseline import runs_baseline

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

ROOT = Path(__file__).parents[2]
PACKAGES = ("mavproxy_fault", "simvehicle", "analysis")
COMPILED = re.compile(rb"^(?:from|import) (?:numba|mavproxy_fault\.numerics\.compile)\b", re.M)
IMPORTED = re.compile(rb"^(?:from|import) ((?:%s)\.[\w.]+)" % "|".join(PACKAGES).encode(), re.M)
SKIPPED = ("__pycache__", "machine_code")  # thousands of files, none of them a source
STALE_S = 86_400.0  # a process that still runs with yesterday's sources may yet compile


@cache
def mark() -> str:
    """Return the digest of the code in all compiled files, and in the files that those import."""
    files = {path: path.read_bytes() for name in PACKAGES for path in _sources(ROOT / name)}
    # Most contain neither word, which is a faster test.
    candidates = {
        path: text for path, text in files.items() if b"numba" in text or b".compile" in text
    }
    wanted = {path for path, text in candidates.items() if COMPILED.search(text)}
    for path in list(wanted):
        for name in IMPORTED.findall(files[path]):
            wanted.add(ROOT / f"{name.decode().replace('.', '/')}.py")
    return code_digest([files[path] for path in sorted(wanted & files.keys())])


def code_digest(sources: Sequence[bytes]) -> str:
    """Return a digest of sources that comments, docstrings and line numbers do not change.

    Parsing takes a third of a second for all kernels, so a file beside the kernels remembers it.
    """
    exact = hashlib.sha256(b"\0".join([sys.version.encode(), *sources])).hexdigest()[:16]
    name = f"{exact}.digest"
    for known in (installed() / name, place() / name):
        with suppress(OSError):
            return known.read_text()
    digest = hashlib.sha256()
    for source in sources:
        digest.update(ast.dump(_without_docstrings(ast.parse(source))).encode())
    found = digest.hexdigest()[:16]
    with suppress(OSError):  # nowhere to write to: it is parsed again next time
        write_atomic(place() / name, found)
    return found


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            match node.body:
                case [ast.Expr(ast.Constant(str())), *rest]:
                    node.body = rest
    return tree


def _sources(package: Path) -> Iterator[Path]:
    """The Python files of a package."""
    for root, folders, names in os.walk(package):
        folders[:] = [name for name in folders if name not in SKIPPED]
        yield from (Path(root, name) for name in names if name.endswith(".py"))


def installed() -> Path:
    """The folder of machine code that was compiled when the package was built or installed."""
    return ROOT / PACKAGES[0] / "machine_code"


def place() -> Path:
    """Where machine code is kept: the first of these folders that can be written to.

    The one that the user names; the user's cache; among temporary files, a folder that only this
    user can write to, since code is loaded from it. All installations of the same sources share it.
    """
    places = list(_places())
    return next((path for path in places if is_usable(path)), places[-1])


def _places() -> Iterator[Path]:
    if chosen := os.environ.get("MAVPROXY_FAULT_CACHE"):
        yield Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME")
    if home is None:
        with suppress(RuntimeError):  # a user without a name has no home either
            home = str(Path.home() / ".cache")
    if home is not None:
        yield Path(home) / "mavproxy-fault"
    # Not `gettempdir`, which fails where nothing can be written to.
    yield Path(os.environ.get("TMPDIR", "/tmp")) / f"mavproxy-fault-{user_number()}"


def user_number() -> int:
    """The user's id; 0 on Windows, which has no ids and gives every file the owner 0."""
    return os.getuid() if hasattr(os, "getuid") else 0


def is_usable(path: Path) -> bool:
    """Whether the folder is there, or could be made, as ours and writable."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = path.stat().st_uid
    except OSError:
        return False
    return os.access(path, os.W_OK | os.X_OK) and owner == user_number()


@cache
def folder() -> Path:
    """The cache folder of the present sources; old folders of other sources are removed."""
    path = place() / f"kernels-{mark()}"
    for old in path.parent.glob("kernels-*"):
        with suppress(OSError):  # another process may remove it too
            if old != path and old.stat().st_mtime < time.time() - STALE_S:
                shutil.rmtree(old, ignore_errors=True)
    return path


@cache
def installed_folder() -> Path | None:
    """The present sources' cache folder in the installation, if this processor can run its code."""
    path = installed() / f"kernels-{mark()}"
    return path if path.is_dir() and runs_baseline() else None


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold a lock among this machine's processes.

    Where there is no such lock (Windows, no folder to write to) several may do the same work.
    """
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        file = path.open("w")
    except OSError:
        yield
        return
    with file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
