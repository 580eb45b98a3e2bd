"""The folders of compiled functions' machine code, one for each state of a module's sources.

numba checks only a function's own file for changes, but our functions are inlined into each other
and contain constants of other files: after an update numba would use outdated code. So the folder
is named after a digest of the module and of all that it imports from this project. An edited file
thus recompiles only what depends on it. Nothing here imports numba.
"""

import hashlib
import os
import re
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from mavproxy_fault.numerics.baseline import runs_baseline

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

ROOT = Path(__file__).parents[2]
PACKAGES = ("mavproxy_fault", "simvehicle", "analysis")
IMPORTED = re.compile(
    rf"^(?:from|import) ((?:{'|'.join(PACKAGES)})[\w.]*)(?: import (\([^)]*|.*))?", re.MULTILINE
)
# A docstring, a comment or nothing, on lines of its own. A docstring begins with a capital or a
# name in backquotes, which never follow the end of a string.
SILENT = re.compile(rb'^[ \t]*(?:#.*|"""(?=[A-Z`])(?s:.*?)""")?\n', re.MULTILINE)
DAY_S = 86_400.0
PROGRESS = "progress"  # the file that is touched when a function begins to be compiled
IDLE_S = 60.0  # longer than any function takes to compile
STALE_S = 7 * DAY_S  # unused for a week: an update's, or an edit's


@cache
def source_digest(*paths: Path) -> str:
    """Return the digest of the code in some files, and in all files of ours that they need."""
    return code_digest([one.read_bytes() for one in sorted(reachable_sources(*paths))])


def reachable_sources(*paths: Path) -> set[Path]:
    """Return files and all files of ours that they import, directly or not."""
    found, waiting = set(), set(paths)
    while waiting:
        found.add(one := waiting.pop())
        waiting |= _imports(one) - found
    return found


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Files of ours that a file imports."""
    found = set()
    for module, names in IMPORTED.findall(path.read_text()):
        place = ROOT / module.replace(".", "/")
        inside = [place / name for name in ("__init__", *re.findall(r"\w+", names))]
        found |= {one.with_suffix(".py") for one in (place, *inside)}
    return frozenset(one for one in found if one.is_file())


def code_digest(sources: Sequence[bytes]) -> str:
    """Return a digest of sources that lines of comments and docstrings do not change."""
    return hashlib.sha256(b"".join(SILENT.sub(b"", one) for one in sources)).hexdigest()[:16]


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
    yield from user_folders("XDG_CACHE_HOME", ".cache")


def user_folders(variable: str, below_home: str) -> Iterator[Path]:
    """Yield our folders of this user: below that of the variable or of the home, and among
    temporary files, where home is missing or read-only."""
    home = os.environ.get(variable)
    if home is None:
        with suppress(RuntimeError):  # a user without a name has no home either
            home = str(Path.home() / below_home)
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


def kernels() -> Path:
    """The folder of all modules' folders."""
    return place() / "kernels"


def compiled_last_s() -> float:
    """Unix time at which a function last began to be compiled with this cache, or the one 2 s
    before it; 0 if unknown."""
    with suppress(OSError):
        return (kernels() / PROGRESS).stat().st_mtime
    return 0.0


@cache
def module_folders(module: str, source: Path) -> list[tuple[Path, bool]]:
    """The folder of a module's functions, and that of the installation (True), if this processor
    can run its code."""
    name = f"{module}-{source_digest(source)}"
    own, ready = kernels() / name, installed() / "kernels" / name
    note_use(own, f"{module}-*")
    return [(own, False), *([(ready, True)] if ready.is_dir() and runs_baseline() else [])]


def note_use(found: Path, others: str) -> None:
    """Note that a file or folder is in use; once a day, remove the others of a pattern beside it
    that have not been for a week. Several versions of the sources may share the place."""
    now_s = time.time()
    with suppress(OSError):  # it is not there yet, or not ours
        noted_s = found.stat().st_mtime
        os.utime(found)
        if now_s - noted_s < DAY_S:
            return
    for old in found.parent.glob(others):
        with suppress(OSError):  # another process may remove it too
            if old != found and old.stat().st_mtime < now_s - STALE_S:
                shutil.rmtree(old) if old.is_dir() else old.unlink()


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold a lock among this machine's processes.

    Where there is no such lock (Windows, no folder to write to) several may do the same work.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError:
        yield
        return
    with file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
