"""Machine code that is made twice has the same bytes, whatever was compiled before it."""

import os
import subprocess
import sys
from pathlib import Path

CALLS = ("linear.square(np.eye(3))", "linear.inverse(np.eye(3))")
DRAFT = "import numpy as np; from mavproxy_fault.numerics import linear; {}; {}"


def _python(folder: Path, *words: str) -> None:
    environment = {**os.environ, "MAVPROXY_FAULT_CACHE": str(folder), "PYTHONHASHSEED": "0"}
    subprocess.run([sys.executable, *words], env=environment, check=True)


def _bytes(folder: Path) -> dict[str, bytes]:
    files = (path for kind in ("*.nbi", "*.nbc") for path in folder.rglob(kind))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_two_builds_that_came_to_functions_in_another_order_give_the_same_bytes(
    tmp_path: Path,
) -> None:
    drafts, made = [], []
    for number, calls in enumerate((CALLS, CALLS[::-1])):
        draft, folder = tmp_path / f"draft{number}", tmp_path / f"made{number}"
        _python(draft, "-c", DRAFT.format(*calls))
        _python(folder, "-m", "analysis.recompile", str(draft))
        drafts.append(_bytes(draft))
        made.append(_bytes(folder))
    assert drafts[0] != drafts[1]
    assert made[0] == made[1]
    assert {"linear.square", "linear.inverse"} <= {
        name.split("/")[-1].split("-")[0] for name in made[0]
    }
    assert not any(b"0x7f" in content for content in made[0].values())
