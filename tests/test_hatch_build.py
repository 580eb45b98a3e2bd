import importlib.util
from pathlib import Path
from typing import Any

import pytest

HOOK = Path(__file__).parents[1] / "hatch_build.py"
WARM_UP = "import pathlib, sys\npathlib.Path(sys.argv[-1], 'made.o').write_text('code')\n"
# What pip does in the environment that it builds in.
TAKEN_OFF = "import sys\nsys.path[:] = [path for path in sys.path if path not in {roots!r}]\n"


def test_a_build_beside_an_editable_installation_brings_machine_code_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("hatchling", reason="the build's own tool is not installed")
    root, overlay = tmp_path / "root", tmp_path / "overlay"
    (root / "analysis").mkdir(parents=True)
    (root / "analysis" / "__init__.py").touch()
    (root / "analysis" / "warm_up.py").write_text(WARM_UP)
    overlay.mkdir()
    (overlay / "sitecustomize.py").write_text(TAKEN_OFF.format(roots=[str(root), str(HOOK.parent)]))
    monkeypatch.setenv("PYTHONPATH", str(overlay))
    described = importlib.util.spec_from_file_location("hatch_build", HOOK)
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    hook = module.MachineCode(str(root), {}, None, None, str(tmp_path), "wheel")
    build_data: dict[str, Any] = {"force_include": {}}
    hook.initialize("standard", build_data)
    assert list(build_data["force_include"].values()) == ["mavproxy_fault/machine_code/made.o"]
    assert not build_data["pure_python"]
    hook.finalize("standard", build_data, "")
    assert (root / "analysis" / "warm_up.py").exists()


@pytest.mark.parametrize(("release", "needs"), [(False, False), (True, True)])
def test_only_a_release_needs_more_than_hatchling(
    monkeypatch: pytest.MonkeyPatch, release: bool, needs: bool
) -> None:
    build = pytest.importorskip("hatchling.build", reason="the build's own tool is not installed")
    monkeypatch.chdir(HOOK.parent)
    monkeypatch.delenv("HATCH_BUILD_HOOKS_ENABLE", raising=False)
    if release:
        monkeypatch.setenv("HATCH_BUILD_HOOKS_ENABLE", "true")
    assert bool(build.get_requires_for_build_wheel()) is needs
