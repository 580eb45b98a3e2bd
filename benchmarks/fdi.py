"""What the detector is worth: the tables of benchmarks/fdi.md, measured.

    python benchmarks/fdi.py [SECTION ...] [--data DIR]

Sections: alarms power isolation ramps whole static walk speed (default: all). The Monte Carlo
sections draw innovations with their exact covariance and put them to the same bank, thresholds and
windows that the live path uses. `whole`, `static` and `walk` need the folder of real logs and, for
the peer, RTKLIB's rnx2rtkp.
"""

import argparse
import os
from pathlib import Path

import fdi_speed
import fdi_static
import fdi_theory
import fdi_walk

DRAWN = {
    "alarms": fdi_theory.alarms,
    "power": fdi_theory.power,
    "isolation": fdi_theory.isolation,
    "ramps": fdi_theory.ramps,
}
ON_DATA = {
    "whole": fdi_static.whole,
    "static": fdi_static.static,
    "walk": fdi_walk.walk,
    "speed": fdi_speed.speed,
}


def main() -> None:
    """Print the sections asked for."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser = argparse.ArgumentParser(description=__doc__)
    sections = [*DRAWN, *ON_DATA]
    parser.add_argument("section", nargs="*", choices=[*sections, []], default=[])
    parser.add_argument("--data", type=Path, default=os.environ.get("MAVPROXY_FAULT_DATA", beside))
    args = parser.parse_args()
    for section in args.section or sections:
        if section in DRAWN:
            DRAWN[section]()
        else:
            ON_DATA[section](Path(args.data))


if __name__ == "__main__":
    main()
