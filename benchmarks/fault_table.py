"""Memory and time of a fault driven by a ten-hour series at 250 Hz (nine million rows of CSV).

Run by hand: python benchmarks/fault_table.py [HOURS]
"""

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mavproxy_fault.fault_parts.profile import Profile
from mavproxy_fault.fault_parts.series import SeriesTable

RATE_HZ = 250


def write(path: Path, rows: int) -> None:
    """A series of steps of 4 ms with a slow sine."""
    with path.open("w") as file:
        file.write("t_s,value\n")
        for i in range(rows):
            file.write(f"{i / RATE_HZ:.3f},{i % 1000 / 1000:.3f}\n")


def peak_mb() -> float:
    """The largest resident set so far, in megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Evaluate the series at every one of its samples."""
    hours = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    rows = int(hours * 3600 * RATE_HZ)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "series.csv"
        write(path, rows)
        size_mb = path.stat().st_size / 1e6
        before_mb = peak_mb()
        profile = Profile(table=SeriesTable(str(path)))
        state = profile.new_state(np.random.default_rng(0))
        start_s = time.perf_counter()
        wrong = sum(
            profile.value(i / RATE_HZ, state) != round(i % 1000 / 1000, 3) for i in range(rows)
        )
        wall_s = time.perf_counter() - start_s
    print("| hours | rows | file MB | peak MB before | peak MB | us per sample | wrong |")
    print("|---|---|---|---|---|---|---|")
    print(
        f"| {hours:g} | {rows} | {size_mb:.0f} | {before_mb:.0f} | {peak_mb():.0f} "
        f"| {wall_s / rows * 1e6:.1f} | {wrong} |"
    )


if __name__ == "__main__":
    main()
