"""Missing packages of extras: the message says what to install, and the demo needs none."""

import subprocess
import sys
from pathlib import Path

import pytest

from mavproxy_fault.documents import extras
from mavproxy_fault.documents.errors import ConfigError

BLOCK = """
import sys
from importlib.abc import MetaPathFinder

class Missing(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {missing}:
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Missing())
import mavproxy_fault.cli
sys.exit(mavproxy_fault.cli.main(sys.argv[1:]))
"""
EXTRAS = {
    "ahrs", "allpairspy", "foxglove", "hatanaka", "matplotlib", "mcap", "pyarrow", "scipy"
}  # fmt: skip
SCENARIO = "duration_s: 3\nsensors: {imu: {preset: consumer-mems, rate_hz: 250}}\n"


def test_the_error_says_what_pip_can_install(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"is not installed; run pip install no_such_package$"):
        extras.import_extra("no_such_package.part")
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    assert not extras.has_extra("no_such_package")
    with pytest.raises(ConfigError, match=r"foxglove is not .* pip install foxglove-sdk$"):
        extras.require_extra("foxglove")


def test_an_installed_package_is_imported() -> None:
    assert extras.import_extra("json.decoder").JSONDecoder
    assert extras.has_extra("json")


def test_a_run_and_its_report_need_no_extra(tmp_path: Path) -> None:
    scenario = tmp_path / "short.yaml"
    scenario.write_text(SCENARIO)
    command = ["run", str(scenario), "--zenoh", "off", "--out", str(tmp_path / "out")]
    script = BLOCK.format(missing=EXTRAS)
    done = subprocess.run([sys.executable, "-c", script, *command], capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    assert (tmp_path / "out" / "report.html").is_file()
