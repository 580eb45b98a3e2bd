"""Wheels of a release, with the kernels inside: `python hatch_build.py [PYTHON ...]`.

A plain build compiles nothing; kernels are compiled at first use. This command builds one wheel for
each interpreter (default: the one that runs it) into `dist/`, with what `mavproxy-fault warm-up`
makes for any common processor, and prints the commands of the release notes. Such a wheel is for
one system and one version of Python.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # run as a command, which needs only pip
    BuildHookInterface = object  # type: ignore[assignment,misc]

ROOT = Path(__file__).parent
INSIDE = "mavproxy_fault/machine_code"
KINDS = (".o", ".nbi", ".nbc")  # not the locks


class MachineCode(BuildHookInterface):  # type: ignore[type-arg,misc]
    """Compiles before a wheel is assembled, where HATCH_BUILD_HOOKS_ENABLE requests it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the machine code to the wheel's files."""
        if version == "editable":
            return
        self._folder = Path(tempfile.mkdtemp(prefix="mavproxy-fault-build-"))
        # By another name: pip takes every folder off its build's path that the surrounding
        # environment has on its own, and an editable installation of these sources has this one.
        sources, made = self._folder / "sources", self._folder / "made"
        sources.symlink_to(self.root)
        made.mkdir()
        # The build's own packages may be on the path already.
        path = os.pathsep.join([str(sources), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {**os.environ, "PYTHONPATH": path}
        warm_up = [sys.executable, "-m", "analysis.warm_up", "--portable", str(made)]
        subprocess.run(warm_up, env=environment, cwd=self._folder, check=True)
        for file in sorted(made.rglob("*")):
            if file.suffix in KINDS:
                place = file.relative_to(made).as_posix()
                build_data["force_include"][str(file)] = f"{INSIDE}/{place}"
        build_data["pure_python"] = False
        build_data["infer_tag"] = True

    def finalize(self, version: str, build_data: dict[str, Any], artifact: str) -> None:
        """Remove what is in the wheel now."""
        if version != "editable":
            shutil.rmtree(self._folder)


def main(pythons: list[str]) -> None:
    """Build a wheel by each interpreter, and print how users install it."""
    environment = {**os.environ, "HATCH_BUILD_HOOKS_ENABLE": "true"}
    out = ROOT / "dist"
    for python in pythons or [sys.executable]:
        wheel = ["-m", "pip", "wheel", "--verbose", "--no-deps", "--wheel-dir", str(out), str(ROOT)]
        subprocess.run([python, *wheel], env=environment, check=True)
    for path in sorted(out.glob("*.whl")):
        print(f"pip install {path.name}\nuvx --from ./{path.name} mavproxy-fault run")


if __name__ == "__main__":
    main(sys.argv[1:])
