"""Test of the wheel as users get it: built, installed offline, run by an unprivileged user.

    python tests/hardening/wheel.py [--wheel FILE] [--folder DIR] [--python PATH]

Builds a wheel, downloads its dependencies, and installs
everything in an empty environment without a network. Then another user, who has no write access and
no HOME (or HOME `/`), runs the demo twice and starts proxies. Prints each value beside its limit;
exit code 1 if one is exceeded. Needs root, `setpriv`, `unshare` and a C compiler (for the load on
the proxy).
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
UNPRIVILEGED = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
ALONE = ["unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
SCHEDULE = ROOT / "examples" / "gyro_bias.yaml"
MISSED: list[str] = []


def note(what: str, value: float, limit: float, unit: str) -> None:
    """Print a value beside its limit."""
    print(f"| {what} | {value:.3g} {unit} | {limit:g} {unit} |", flush=True)
    if value > limit:
        MISSED.append(what)


def processor_s(*command: str | Path, environment: dict[str, str] | None = None) -> float:
    """Run a command that must succeed; return the processor seconds of it and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(one) for one in command], env=environment, capture_output=True, text=True, cwd="/"
    )
    if done.returncode != 0:
        sys.exit(f"{command}: {done.returncode}\n{done.stdout[-1500:]}{done.stderr[-1500:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def build(folder: Path) -> Path:
    """A wheel of this source tree."""
    spent_s = processor_s(
        sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", ROOT, "--wheel-dir", folder,
        environment={**os.environ, "HATCH_BUILD_HOOKS_ENABLE": "true"},
    )  # fmt: skip
    (wheel,) = folder.glob("*.whl")
    print(f"built {wheel.name}, {wheel.stat().st_size / 1e6:.1f} MB, {spent_s:.0f} s", flush=True)
    return wheel


def install(wheel: Path, folder: Path, python: str) -> Path:
    """Install in an empty environment without a network; where its commands are."""
    venv, house = folder / "venv", folder / "house"
    processor_s(python, "-m", "venv", venv)
    pip = venv / "bin" / "pip"
    processor_s(pip, "download", "--quiet", "--dest", house, wheel)
    needed = [path for path in house.iterdir() if path.name != wheel.name]
    offline = [*ALONE, pip, "install", "--quiet", "--no-index", "--find-links", house]
    spent_s = processor_s(*offline, *needed)
    note("pip install of what it needs", spent_s, 60, "s of processor")
    note("pip install of the wheel", processor_s(*offline, wheel), 40, "s of processor")
    return venv / "bin"


def demo(commands: Path, folder: Path) -> None:
    """The demo twice as a user who may write nothing but one folder, then with HOME=/."""
    spent_s = []
    for number, home in enumerate((None, None, "/")):
        out = folder / f"out{number}"
        out.mkdir()
        out.chmod(0o777)
        environment = {"PATH": "/usr/bin:/bin"} | ({"HOME": home} if home else {})
        run = [commands / "mavproxy-fault", "run", "--zenoh", "off", "--out", out / "run"]
        spent_s.append(processor_s(*ALONE, *UNPRIVILEGED, *run, environment=environment))
    print(f"demo runs: {', '.join(f'{one:.1f}' for one in spent_s)} s of processor", flush=True)
    note("first run over the second", spent_s[0] / spent_s[1], 1.3, "times")


def proxies(commands: Path, folder: Path) -> None:
    """Measure the start-up time of a proxy, and its speed in the first second."""
    load = folder / "load"
    processor_s("cc", "-O2", "-o", load, ROOT / "benchmarks" / "load.c", "-lm")
    ready_s, slower = [], []
    for number in range(9):
        master, out = 41_000 + 2 * number, 41_001 + 2 * number
        begun_s = time.monotonic()
        with subprocess.Popen(
            [*UNPRIVILEGED, commands / "mavproxy-fault", "proxy", "--zenoh", "off",
             "--master", f"udpin:127.0.0.1:{master}", "--to", f"udpout:127.0.0.1:{out}",
             "--schedule", SCHEDULE],
            stdout=subprocess.PIPE, env={"PATH": "/usr/bin:/bin"}, cwd="/",
        ) as proxy:  # fmt: skip
            assert proxy.stdout is not None
            proxy.stdout.readline()
            ready_s.append(time.monotonic() - begun_s)
            rates = []
            for _ in range(4):  # a third of a second each
                values = subprocess.run(
                    [load, str(master), str(out), "window", "64", "100000"],
                    capture_output=True, text=True, check=True,
                ).stdout.split()  # fmt: skip
                rates.append(float(values[1]) / float(values[3]))
            slower.append(statistics.median(rates[1:]) / rates[0])
            proxy.terminate()
    note("proxy with a schedule is ready", statistics.median(ready_s), 0.25, "s")
    note("full speed over that at once", statistics.median(slower), 1.1, "times")


def main() -> int:
    """Build, install, try."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", type=Path, help="one that is built already")
    parser.add_argument("--folder", type=Path, help="where all this is done (default: a new one)")
    parser.add_argument(
        "--python", default=sys.executable, help="one that every user may run (default: this one)"
    )
    args = parser.parse_args()
    if subprocess.run(
        [*UNPRIVILEGED, args.python, "-c", ""], capture_output=True, cwd="/"
    ).returncode:
        parser.error(f"--python {args.python}: another user cannot run it; give /usr/bin/python3")
    folder = args.folder or Path(tempfile.mkdtemp(prefix="mavproxy-fault-wheel-"))
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o755)
    wheel = args.wheel or build(folder)
    print(f"as user 65534, {os.uname().machine}, {os.cpu_count()} cores\n| what | found | limit |")
    print("|---|---|---|")
    commands = install(wheel.resolve(), folder, args.python)
    demo(commands, folder)
    proxies(commands, folder)
    print("missed: " + (", ".join(MISSED) or "nothing"))
    return bool(MISSED)


if __name__ == "__main__":
    sys.exit(main())
