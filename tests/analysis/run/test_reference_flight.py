"""`run --against-clean`: the effects of faults, compared with the reference flight."""

import argparse
import json
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from analysis.report.curves.fault_effects import deviation_curves, measure_effects
from analysis.report.curves.recording import Signal
from analysis.run.reference_flight import ReferenceRun, run_reference_flight
from analysis.run.run_command import main
from analysis.run.run_setup import read_setup
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.label import Label

SHORT = Path(__file__).with_name("short.yaml")
SCHEDULE = """
faults:
  - {id: gust, fault: plant, target: PLANT.wind_e_mps, value: 8, at_s: 3, for_s: 2}
"""


def test_the_reference_flight_shows_the_effect_of_a_gust(tmp_path: Path) -> None:
    schedule = tmp_path / "gust.yaml"
    schedule.write_text(SCHEDULE)
    out = tmp_path / "out"
    args = argparse.Namespace(
        set=[], require=[],
        scenario=str(SHORT), schedule=str(schedule), seed=None, speed="max", out=str(out),
        gcs="off", ui=False, estimators=None, zenoh="off", zenoh_config="", against_clean=True,
        report=True,
    )  # fmt: skip
    main(args)
    summary = json.loads((out / "summary.json").read_text())
    (row,) = summary["effects"]
    assert row["id"] == "gust"
    assert row["position_m"]["truth"]["most"] > 1.0
    assert row["speed_mps"]["truth"]["most"] > 0.5
    assert row["position_m"]["estimate"]["most"] > 1.0
    assert set(row["attitude_deg"]) == {"truth", "error of the estimate"}
    assert (out / "clean" / "sent.tlog").stat().st_size > 100_000
    assert "Effects of the faults" in (out / "report.html").read_text()


def test_flights_of_an_autopilot_are_compared_by_the_time_since_take_off(tmp_path: Path) -> None:
    layout = message_layout("HIL_STATE_QUATERNION")
    for name, since_us in (("flight", 2_000_000), ("reference", 1_500_000)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "results.jsonl").write_text("")
        with (tmp_path / name / "received.tlog").open("wb") as log:
            for n in range(100):
                # North at about a metre per step of 0.1 s
                values = {"time_usec": since_us + 100_000 * n, "lat": 90 * n, "vx": 1000}
                log.write((since_us + 100_000 * n).to_bytes(8, "big"))
                log.write(build_frame(layout, values, system=1, component=51))
    folders = tmp_path / "flight", tmp_path / "reference"
    position, speed, _ = deviation_curves(*folders, 2_000_000, later_us=500_000)
    assert (len(position.t_s), position.value.max(), speed.value.max()) == (100, 0.0, 0.0)
    assert deviation_curves(*folders, 2_000_000)[0].value.min() > 4.9


def test_the_reference_flight_ends_where_the_run_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # it runs in this process
    run_reference_flight(read_setup(str(SHORT)), tmp_path, SimpleNamespace(value=0))
    assert (tmp_path / "sent.tlog").stat().st_size < 10_000


@pytest.mark.parametrize(("exitcode", "succeeded"), [(0, True), (1, False), (-9, False)])
def test_a_failed_reference_flight_is_reported_and_only_omits_the_effects(
    exitcode: int, succeeded: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    process: Any = SimpleNamespace(exitcode=exitcode, join=lambda: None)
    reference = ReferenceRun(process, SimpleNamespace(value=1 << 62))
    assert reference.wait_until(5_000_000) is succeeded
    assert reference.until_us.value == 5_000_000
    assert bool(capsys.readouterr().err) is not succeeded


def label(id: str, start_s: float, end_s: float, t0_us: int = 0) -> Label:
    stamps = {"t0_us": t0_us, "start_us": round(start_s * 1e6), "end_us": round(end_s * 1e6)}
    return Label(id=id, fault="bias", **stamps)


def test_an_effect_counts_until_the_next_fault_or_the_end_of_its_aftermath() -> None:
    t_s = np.arange(0.0, 60.0, 0.1)
    curve = Signal("twin-position", "truth", t_s, t_s)
    # The second is of a schedule loaded during the flight, with its own zero.
    labels = [label("a", 10, 20), label("b", 25, 30, t0_us=22_000_000)]
    rows = measure_effects([curve], labels, t0_us=0)
    extents = [row["position_m"]["truth"] for row in rows]
    assert extents[0]["most"] == pytest.approx(25.0, abs=0.11)
    assert extents[1] == {
        "most": pytest.approx(40.0, abs=0.11),
        "lasting": pytest.approx(39.5, abs=0.11),
    }
