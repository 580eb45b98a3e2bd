"""How far a broadcast ephemeris is off at some age: against a later ephemeris of the satellite.

Run by hand: `python benchmarks/ephemeris_age.py NAVIGATION...`. The difference of range and clock
is that in the radial direction, at the time of the other ephemeris (Galileo, BeiDou: 300 s later).
"""

import sys
from collections import defaultdict
from itertools import permutations
from pathlib import Path

import numpy as np

from analysis.orbits.broadcast import CLOCK, POSITION, pack_ephemeris, satellite_states
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.samples.sample import EphemerisSample
from mavproxy_fault.rinex.gps_clock import WEEK_S

MOST_H = 5.0


def main() -> None:
    """Print the table of the given files."""
    errors_m = defaultdict(list)
    for path in map(Path, sys.argv[1:]):
        orbits = defaultdict(dict)
        for sample in read_navigation(path):
            if isinstance(sample, EphemerisSample) and sample.ephemeris.health == 0:
                orbit = sample.ephemeris
                orbits[orbit.satellite][orbit.week, orbit.toe_s] = orbit
        for name, known in orbits.items():
            late_s = 300.0 if name[0] in "EC" else 0.0
            for old, new in permutations(known.values(), 2):
                age_s = (new.week - old.week) * WEEK_S + new.toe_s - old.toe_s + late_s
                if abs(age_s) <= MOST_H * 3600.0:
                    at, ranges = (float(new.week), new.toe_s + late_s), np.array([2.2e7])
                    a, b = (
                        satellite_states(pack_ephemeris(one)[None], *at, ranges)[0]
                        for one in (old, new)
                    )
                    place = b[POSITION : POSITION + 3]
                    up = place / np.linalg.norm(place)
                    off_m = (a[POSITION : POSITION + 3] - place) @ up - (a[CLOCK] - b[CLOCK])
                    errors_m[name[0], round(age_s / 1800.0) * 0.5].append(abs(off_m))
    print("| system | age, h | pairs | sigma by the median, m | 95 %, m |\n|---|---|---|---|---|")
    for (system, age_h), row in sorted(errors_m.items()):
        sigma_m, most_m = 1.4826 * np.median(row), np.percentile(row, 95)
        print(f"| {system} | {age_h:.1f} | {len(row)} | {sigma_m:.2f} | {most_m:.2f} |")


if __name__ == "__main__":
    main()
