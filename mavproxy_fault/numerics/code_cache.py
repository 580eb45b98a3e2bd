"""Where the machine code of compiled functions is kept: a folder for each state of the sources.

numba by itself looks only at a function's own file, but ours are inlined into each other and hold
constants of other files: after an update it would go on with what it had. So the folder's name
comes from all files that have to do with compiled code. Nothing here imports numba.
"""

import hashlib
import os
import re
import shutil
import time
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("mavproxy_fault", "simvehicle", "analysis")
COMPILED = re.compile(rb"^(?:from|import) .*\b(?:numba|compiled)\b", re.MULTILINE)
IMPORTED = re.compile(rb"^(?:from|import) ((?:%s)\.[\w.]+)" % "|".join(PACKAGES).encode(), re.M)
STALE_S = 86_400.0  # a process that still runs with yesterday's sources may yet compile


@cache
def mark() -> str:
    """A digest of all files that are compiled, and of the files that those import."""
    files = {path: path.read_bytes() for name in PACKAGES for path in (ROOT / name).rglob("*.py")}
    likely = {path for path, text in files.items() if b"numba" in text or b"compiled" in text}
    wanted = {path for path in likely if COMPILED.search(files[path])}  # four times as slow
    for path in list(wanted):
        for name in IMPORTED.findall(files[path]):
            wanted.add(ROOT / f"{name.decode().replace('.', '/')}.py")
    digest = hashlib.sha256()
    for path in sorted(wanted & files.keys()):
        digest.update(files[path])
    return digest.hexdigest()[:16]


def place() -> Path:
    """Where machine code is kept: beside the sources, or in the user's cache if not writable."""
    beside = ROOT / PACKAGES[0] / "__pycache__"
    if os.access(beside if beside.exists() else beside.parent, os.W_OK):
        return beside
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "mavproxy-fault"


@cache
def folder() -> Path:
    """The folder for the sources as they are now; those of other days go."""
    path = place() / f"kernels-{mark()}"
    for old in path.parent.glob("kernels-*"):
        if old != path and old.stat().st_mtime < time.time() - STALE_S:
            shutil.rmtree(old, ignore_errors=True)
    path.mkdir(parents=True, exist_ok=True)
    return path
