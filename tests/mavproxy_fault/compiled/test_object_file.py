import os
import subprocess
import sys
from pathlib import Path

import pytest

from mavproxy_fault.compiled import object_file
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.compiled.object_file import PACKAGE, load, make
from mavproxy_fault.numerics.code_cache import reachable_sources
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame


def test_machine_code_that_is_made_later_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make()
    there = object_file.object_path()
    path = tmp_path / "forward.o"
    monkeypatch.setattr(object_file, "object_path", lambda: path)
    assert load() is None
    path.write_bytes(there.read_bytes())
    assert load() is not None


def test_machine_code_that_was_installed_is_preferred(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_file, "place", lambda: tmp_path / "own")
    monkeypatch.setattr(object_file, "installed", lambda: tmp_path / "installed")
    path = tmp_path / "installed" / object_file.object_path().name
    assert object_file.object_path().parent == tmp_path / "own"
    path.parent.mkdir()
    path.touch()
    assert object_file.object_path() == path


def test_machine_code_of_other_sources_stays_for_a_week(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, used, old = (tmp_path / f"forward-{name}.o" for name in ("this", "used", "old"))
    make()
    code = object_file.object_path().read_bytes()
    for other in (used, old):
        other.touch()
    os.utime(old, (0, 0))
    monkeypatch.setattr(object_file, "object_path", lambda: path)
    assert load() is None  # not compiled yet: old versions go
    assert [used.exists(), old.exists()] == [True, False]
    path.write_bytes(code)
    os.utime(path, (0, 0))
    assert load() is not None
    assert path.stat().st_mtime > 0


def test_every_file_that_is_compiled_in_is_among_the_sources() -> None:
    script = (
        "import sys, mavproxy_fault.compiled.sockets\n"
        "for module in list(sys.modules.values()):\n"
        "    print(getattr(module, '__file__', None))\n"
    )
    printed = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    files = {Path(line) for line in printed.stdout.decode().splitlines()}
    ours = {file for file in files if file.is_relative_to(PACKAGE)}
    compiled_in = {file for file in ours if file.name != "__init__.py"}
    assert PACKAGE / "proxy/sender_rules.py" in compiled_in
    assert compiled_in <= reachable_sources(*object_file.ROOTS)


def test_a_rule_may_call_the_functions_of_libm() -> None:
    make()
    jitter = {"fault": "jitter", "value": 0.01, "distribution": "normal", "correlation": 0.4}
    roles = [LinkRole("a", "from-vehicle"), LinkRole("b", "to-vehicle")]
    core = Core(roles, Engine(parse_schedule({"seed": 1, "faults": [jitter]})))
    compiled = CompiledCore(core, 0, None)
    for n in range(200):
        frame = build_frame(message_layout("HEARTBEAT"), {"type": 2}, seq=n)
        compiled.received(0, frame, 4000 * n)
    compiled.count()
    assert core.states[0].frames == 200
    assert 0 < core.states[0].faulted < 200
