import contextlib
import io
import os
import pty
import shlex
import sys

from simvehicle.app.sim_progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_file_gets_a_line_every_ten_seconds() -> None:
    out = io.StringIO()
    progress = Progress(0.0, out)
    for second in range(25):
        progress.step(second * 2_000_000, float(second), ", not in lockstep")
    assert out.getvalue().splitlines() == [
        "    20.0 s simulated, 2.0 times real time, not in lockstep",
        "    40.0 s simulated, 2.0 times real time, not in lockstep",
    ]


def test_on_a_terminal_the_progress_line_is_overwritten_and_messages_follow_it() -> None:
    out = Terminal()
    progress = Progress(0.0, out)
    progress.step(1_000_000, 1.0)
    progress.step(2_000_000, 2.0)
    progress.say("stopped")
    text = out.getvalue()
    assert text.count("\n") == 2
    assert text.count("\r") == 2
    assert text.endswith("2.0 s simulated, 1.0 times real time\nstopped\n")


def test_in_the_background_the_line_is_not_written_over_what_the_user_types() -> None:
    # A shell that starts the program behind itself, on a terminal of its own.
    program = "import sys; from simvehicle.app.sim_progress import Progress\n"
    program += "out = Progress(0.0); out.step(1, 1.0); out.say('stopped')"
    shell = f"set -m; {sys.executable} -c {shlex.quote(program)} & wait"
    pid, terminal = pty.fork()
    if pid == 0:
        os.execvp("bash", ["bash", "-c", shell])
    text = b""
    with contextlib.suppress(OSError):  # the terminal's end
        while part := os.read(terminal, 1000):
            text += part
    os.waitpid(pid, 0)
    assert b"stopped" in text
    assert b"simulated" not in text


def test_the_summary_reports_the_average_speed_of_the_flight() -> None:
    out = io.StringIO()
    Progress(10.0, out).end(60_000_000, 14.0)
    assert out.getvalue() == "60.0 s simulated in 4.0 s, 15.0 times real time\n"
