"""The quickstarts and the README, executed as printed, each in a folder and network of its own.

A block of `bash` is run, a block with the title of a file is written, a block of `text` is output
that the commands before it print, a block of `console` is typed into MAVProxy. A block of `bash`
with a title is run only if what its title says is there.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import venv
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("quickstart_*.md"))
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]*)")?\n(.*?)^```$', re.S | re.M)
# Where the pages expect the programs that need to be built, and who says where they are.
PROGRAMS = {
    "needs PX4": ("MAVPROXY_FAULT_PX4", "build/px4_sitl_default/bin/px4"),
    "needs ArduPilot": ("MAVPROXY_FAULT_ARDUPILOT", "build/sitl/bin/arducopter"),
}
NOT_RUN = ("shows a page until Ctrl-C",)  # tests/analysis/web open it in a browser
LOOPBACK = "import socket,fcntl,struct;s=socket.socket();" + (
    "fcntl.ioctl(s,0x8914,struct.pack('16sh14x',b'lo',0x1))"  # SIOCSIFFLAGS, IFF_UP
)
DRIVER = """
import re, subprocess, sys, threading, time
from pathlib import Path
command, typed, lines = sys.argv[1].split(), sys.argv[2:], []
process = subprocess.Popen([*command, "--no-state"], stdin=-1, stdout=-1, stderr=-2, text=True)
def read():
    for line in process.stdout:
        lines.append(line)
        print(line, end="", flush=True)
threading.Thread(target=read, daemon=True).start()
def wait_for(pattern, begin):
    for _ in range(1200):
        if any(re.search(pattern, line) for line in lines[begin:]):
            return
        time.sleep(0.1)
    sys.exit(f"MAVProxy did not print {pattern}")
wait_for("Received .* parameters", 0)
for line in typed:
    begin = len(lines)
    process.stdin.write(line + "\\n")
    process.stdin.flush()
    wait_for("ACCEPTED", begin)
    time.sleep(2)  # until a HEARTBEAT shows the new state
"""


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    title: str
    text: str


def blocks_of(page: Path) -> list[Block]:
    return [Block(*found) for found in BLOCK.findall(page.read_text(encoding="utf-8"))]


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment for packages of the pages, with our installation below it."""
    folder = tmp_path_factory.mktemp("environment")
    # To install another pip takes seconds.
    venv.create(folder, with_pip=find_spec("pip") is None)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "below.pth").write_text("\n".join(p for p in sys.path if p.endswith("site-packages")))
    here = folder / "bin"
    modules = {"mavproxy-fault": "mavproxy_fault.cli", "pytest": "pytest", "pip": "pip"}
    for name, module in modules.items():
        (here / name).unlink(missing_ok=True)
        (here / name).write_text(f'#!/bin/sh\nexec {here}/python -P -m {module} "$@"\n')
        (here / name).chmod(0o755)
    (here / "mavproxy.py").symlink_to(Path(sys.executable).with_name("mavproxy.py"))
    # The package that the tests are of, where its installation is editable.
    with (site / "below.pth").open("a") as file:
        file.write(f"\n{ROOT}\n")
    return here


@pytest.fixture
def network() -> list[str]:
    """Words that give a command a network of its own: the pages use the default ports."""
    words = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]
    if shutil.which("unshare") is None or subprocess.run([*words, "true"], check=False).returncode:
        pytest.skip("unshare cannot make a network; the default ports may be in use")
    return words


def is_there(title: str) -> bool:
    return title in PROGRAMS and shutil.which(os.environ.get(PROGRAMS[title][0], "")) is not None


def script_of(block: Block) -> str:
    """The shell commands of a block."""
    if block.language == "bash":
        return block.text
    command, *typed = block.text.splitlines()
    assert command.startswith("$ mavproxy.py")
    words = [command.removeprefix("$ "), *(line.removeprefix("MAV> ") for line in typed)]
    return f"{sys.executable} driver.py " + " ".join(f'"{word}"' for word in words)


@pytest.mark.timeout(1800)  # ten minutes of a reader, with every wait of his
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_quickstart_works_as_printed(
    page: Path, tmp_path: Path, programs: Path, network: list[str]
) -> None:
    (tmp_path / "driver.py").write_text(DRIVER)
    missing, lines, expected = [], [f'{sys.executable} -c "{LOOPBACK}"'], {}
    for number, block in enumerate(blocks_of(page)):
        if block.language in ("yaml", "python"):
            path = tmp_path / block.title
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text)
        elif block.language == "text":
            expected[number] = block.text.splitlines()
        elif block.title and not is_there(block.title):
            missing.append(block.title)
            assert block.title in (*PROGRAMS, *NOT_RUN)
        else:
            if block.title:
                name, place = PROGRAMS[block.title]
                (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
                (tmp_path / place).symlink_to(shutil.which(os.environ[name]))
            (tmp_path / f"block{number}.sh").write_text(script_of(block))
            lines.append(f"bash -e block{number}.sh >>printed 2>&1 </dev/null")
        if number in expected:
            lines.append(f"cp printed printed{number}")
    (tmp_path / "page.sh").write_text("\n".join(lines))
    variables = {
        "PATH": f"{programs}:{os.environ['PATH']}", "PIP_NO_BUILD_ISOLATION": "0",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PYTHONPATH": "", "MPLBACKEND": "agg",
    }  # fmt: skip
    process = subprocess.Popen(
        [*network, "bash", "-e", "page.sh"],
        cwd=tmp_path, env={**os.environ, **variables}, start_new_session=True,
    )  # fmt: skip
    try:
        code = process.wait(1700)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert code == 0, (tmp_path / "printed").read_text()[-3000:]
    for number, wanted in expected.items():
        printed = (tmp_path / f"printed{number}").read_text()
        # The spaces between columns depend on the longest word.
        words = [line.split() for line in printed.splitlines()]
        assert [line for line in wanted if line.split() not in words] == []
    if set(missing) & PROGRAMS.keys():
        pytest.skip(f"{', '.join(sorted(set(missing)))}; everything else of the page was run")


def test_the_test_of_the_readme_passes(tmp_path: Path) -> None:
    (block,) = [one for one in blocks_of(ROOT / "README.md") if one.language == "python"]
    (tmp_path / block.title).write_text(block.text)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "."]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "1 passed" in done.stdout, done.stdout
