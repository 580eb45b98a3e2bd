"""Child processes find the modules that their parent finds, whatever the folder holds."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import os
from concurrent.futures import ProcessPoolExecutor
from analysis.processes import spawn_context

if __name__ == "__main__":
    with ProcessPoolExecutor(1, spawn_context()) as pool:
        print(pool.submit(os.getenv, "PYTHONSAFEPATH").result())
"""


def test_a_folder_with_files_named_as_modules_does_not_stop_workers(tmp_path: Path) -> None:
    (tmp_path / "program").mkdir()
    program = tmp_path / "program" / "pool.py"
    program.write_text(PROGRAM)
    for name in ("types", "random", "analysis"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong module')\n")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    done = subprocess.run(
        [sys.executable, str(program)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "None\n"  # a program that a worker starts finds its own modules
