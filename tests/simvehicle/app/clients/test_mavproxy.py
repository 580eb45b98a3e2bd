"""MAVProxy connects to the simulated vehicle, as a process of its own."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

WARNING = re.compile(
    r"warn|error|fail|time.?out|timed out|no link|link \d+ down|unknown|bad |wrapped|lost|denied",
    re.IGNORECASE,
)
COMMANDS = ("arm throttle", "disarm", "arm throttle force", "disarm force", "arm throttle")


def test_it_connects_without_a_warning_reads_all_parameters_arms_and_disarms(
    flown: Any, tmp_path: Path
) -> None:
    script = Path(sys.executable).with_name("mavproxy.py")
    if not script.exists():
        pytest.skip("MAVProxy is not installed beside this Python; pip install MAVProxy")
    lines: list[str] = []
    waiting = iter(COMMANDS)
    with subprocess.Popen(
        [str(script), f"--master=udpin:127.0.0.1:{flown.port}", "--no-state"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line.rstrip())
            if "COMPONENT_ARM_DISARM" in line or ("Received" in line and "parameters" in line):
                if (command := next(waiting, None)) is None:
                    break
                process.stdin.write(f"{command}\n")
                process.stdin.flush()
        process.kill()
        process.communicate()
    assert any("Detected vehicle 1:1" in line for line in lines), lines
    assert any(re.fullmatch(r".*Received 13 parameters.*", line) for line in lines), lines
    answers = [line for line in lines if "COMPONENT_ARM_DISARM" in line]
    assert len(answers) == len(COMMANDS)
    assert all(line.endswith("COMPONENT_ARM_DISARM: ACCEPTED") for line in answers)
    assert [line for line in lines if WARNING.search(line)] == []
