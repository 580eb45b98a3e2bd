"""Draw a counterexample of `search --violate` under an autopilot, with and without its faults.

python docs/draw_counterexample.py FOUND/counterexample-01 docs/falsification_copter.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from analysis.flying.autopilot_evidence import collect_evidence
from analysis.flying.flight_evidence import ATTITUDE, PATH, Evidence
from mavproxy_fault.documents.yaml_document import read_document


def curves_of(evidence: Evidence) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The distance from the start, the height, and the error of the autopilot's attitude."""
    north, east, up = (np.array(evidence.curves[name].value) for name in PATH)
    t_s, error = evidence.curves[PATH[0]].t_s, evidence.curves[ATTITUDE]
    return {
        "distance, m": (np.array(t_s), np.hypot(north, east)),
        "height, m": (np.array(t_s), up),
        "error of the attitude, deg": (np.array(error.t_s), np.array(error.value)),
    }


def main(folder: Path, out: Path) -> None:
    """Draw both flights."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    for side, colour in (("without", "#7a8794"), ("with", "#b03a2e")):
        evidence, _ = collect_evidence(folder / side / "run")
        for axis, (name, (t_s, values)) in zip(axes, curves_of(evidence).items(), strict=True):
            axis.plot(t_s, values, color=colour, label=f"{side} the faults")
            axis.set_ylabel(name)
    schedule = read_document(folder / "schedule.yaml").data
    for fault in schedule["faults"]:
        for axis in axes:
            axis.axvspan(fault["at_s"], fault["at_s"] + fault["for_s"], color="#e8b9b3", zorder=0)
        axes[0].set_title(f"{fault['fault']} of {fault['value']:.3g} on {fault['target']}")
    axes[0].legend()
    axes[-1].set_xlabel("seconds since take-off")
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
