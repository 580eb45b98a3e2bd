"""Machine code into the wheel: what `mavproxy-fault warm-up` makes, for any common processor.

The wheel is then one for this system and this version of Python. Where the code cannot be made, and
with HATCH_BUILD_NO_HOOKS=1, it is one for all, and machine code is made when it is first needed.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

INSIDE = "mavproxy_fault/machine_code"
KINDS = (".o", ".nbi", ".nbc")  # not the locks


class MachineCode(BuildHookInterface[Any]):
    """Compiles before a wheel is put together; editable installs compile at first use."""

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
        # The build's own packages may be on the path already. Without a fixed seed, sets in what is
        # pickled would stand in another order each time.
        path = os.pathsep.join([str(sources), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "0"}
        warm_up = [sys.executable, "-m", "analysis.warm_up", "--portable", str(made)]
        if subprocess.run(warm_up, env=environment, cwd=self._folder).returncode != 0:
            self.app.display_warning("no machine code: it will be made when it is first needed")
            return
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
