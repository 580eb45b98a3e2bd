"""Machine code that is made twice has the same bytes, wherever, whatever was compiled before it."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
# `locate_state` reshapes an array: numba keeps the path of its own source of that.
CALLS = (
    "linear.invert_positive_definite(np.eye(3))",
    "locate_state(*map(np.zeros, (13, 3, 13, 19)))",
)
DRAFT = """
import numpy as np
from mavproxy_fault.numerics import linear
from simvehicle.environment.geolocation import locate_state
{}
{}
"""


def _python(sources: Path, folder: Path, *words: str) -> None:
    environment = {
        **os.environ, "MAVPROXY_FAULT_CACHE": str(folder), "PYTHONHASHSEED": "0",
        "PYTHONPATH": str(sources),
    }  # fmt: skip
    subprocess.run([sys.executable, *words], env=environment, cwd=folder.parent, check=True)


def _bytes(folder: Path) -> dict[str, bytes]:
    files = (path for kind in ("*.nbi", "*.nbc") for path in folder.rglob(kind))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_two_builds_in_other_places_that_came_to_functions_in_another_order_give_the_same_bytes(
    tmp_path: Path,
) -> None:
    drafts, made = [], []
    for number, calls in enumerate((CALLS, CALLS[::-1])):
        draft, folder = tmp_path / f"draft{number}", tmp_path / f"made{number}"
        sources = tmp_path / f"sources{number}"
        sources.symlink_to(ROOT)
        _python(sources, draft, "-c", DRAFT.format(*calls))
        _python(sources, folder, "-m", "analysis.recompile", str(draft))
        drafts.append(_bytes(draft))
        made.append(_bytes(folder))
    assert drafts[0] != drafts[1]
    assert made[0] == made[1]
    assert {"linear.invert_positive_definite", "geolocation.locate_state"} <= {
        name.split("/")[-1].split("-")[0] for name in made[0]
    }
    places = [str(place).encode() for place in (sys.prefix, ROOT, tmp_path)]
    assert not any(word in text for text in made[0].values() for word in (b"0x7f", *places))
