"""`search --interactive` as a command: its address, and what it says at Ctrl-C."""

import json
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

TEST = "duration_s: 1\ninitial: {roll_deg: [-30, 30]}\n"


def fetch(host: str, what: str, token: str = "") -> dict:
    request = urllib.request.Request(
        f"{host}/api/{what}", data=b"" if token else None, headers={"X-Token": token}
    )
    with urllib.request.urlopen(request, timeout=60) as reply:
        return json.loads(reply.read())


@contextmanager
def begun(folder: Path) -> Iterator[subprocess.Popen[str]]:
    (folder / "test.yaml").write_text(TEST)
    command = [sys.executable, "-m", "mavproxy_fault.cli", "search", str(folder / "test.yaml")]
    options = ["--interactive", "--out", str(folder / "found")]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        except BaseException:
            process.kill()  # or its end would be waited for
            raise


def test_ctrl_c_ends_the_page_and_lists_the_saved_files(tmp_path: Path) -> None:
    with begun(tmp_path) as process:
        assert process.stdout is not None
        host, _, token = process.stdout.readline().removeprefix("page: ").strip().partition("/#")
        until_s = time.monotonic() + 200.0  # kernels may have to be compiled first
        while fetch(host, "state")["flying"]:
            assert time.monotonic() < until_s
        saved = fetch(host, "save", token.removeprefix("token="))["files"]
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
    assert process.returncode == 0
    assert saved == [str(tmp_path / "found" / f"test-0000.{kind}") for kind in ("csv", "yaml")]
    assert rest.splitlines() == saved


def test_ctrl_c_at_once_says_that_nothing_was_saved(tmp_path: Path) -> None:
    with begun(tmp_path) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
    assert process.returncode == 0
    assert rest == "nothing was saved\n"
    assert not (tmp_path / "found").exists()
