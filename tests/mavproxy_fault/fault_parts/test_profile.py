import csv
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.profile import (
    Draw,
    LinearSegment,
    LiveInput,
    Profile,
    SineProfile,
    hold_live_value,
)
from mavproxy_fault.fault_parts.series import SeriesTable
from mavproxy_fault.schedule.entries import read_schedule

RNG = np.random.default_rng(0)


def linear(*rows: tuple[float, float, float, float], **keys: object) -> Profile:
    """Build a profile of segments (at, for, start, rate)."""
    segments = tuple(LinearSegment(at_s=a, for_s=f, start=s, rate=r) for a, f, s, r in rows)
    return Profile(segments=segments, **keys)  # type: ignore[arg-type]


def test_param_gen_is_reproduced_bit_for_bit(shared_data: Path) -> None:
    folder = shared_data / "param_gen"
    compared = 0
    for case in json.loads((folder / "cases.json").read_text()):
        if case["case"] == "persistent_second_run":
            continue  # a clock left over from an earlier run: a bug of the original
        rows = list(zip(case["Ti"], case["dt"], case["x_init"], case["v"], strict=True))
        if case["outcome"] == "error":
            with pytest.raises(ValueError, match="dt error"):
                linear(*rows, compat="param_gen", time_sim_s=case["time_sim"])
            continue
        profile = linear(
            *rows, compat="param_gen", time_sim_s=case["time_sim"], otherwise=case["x"]
        )
        state = profile.new_state(RNG)
        with (folder / f"{case['case']}.csv").open() as file:
            for row in csv.DictReader(file):
                assert profile.value(float(row["runtime"]), state) == float(row["y"]), case["case"]
                compared += 1
    assert compared > 10_000


def test_segments_touch_without_a_gap_by_default_and_the_later_one_holds_at_the_joint() -> None:
    profile = linear((0.2, 0.1, 1, 0), (0.3, 0.1, 2, 0))
    state = profile.new_state(RNG)
    values = [profile.value(t, state) for t in (0.1999, 0.2, 0.25, 0.3, 0.4, 0.4001)]
    assert values == [None, 1, 1, 2, 2, None]


def test_an_overlap_below_a_microsecond_is_accepted() -> None:
    linear((0.2, 0.1 + 4e-7, 1, 0), (0.3, 0.1, 2, 0))
    with pytest.raises(ValueError, match="must not overlap"):
        linear((0.2, 0.1 + 4e-6, 1, 0), (0.3, 0.1, 2, 0))


def test_random_numbers_are_new_at_each_start_and_reproducible() -> None:
    profile = Profile(segments=(LinearSegment(0, 1, Draw(uniform=(2, 3)), Draw(normal=(0, 1))),))
    rng = np.random.default_rng(5)
    first, second, again = (
        profile.value(0.0, profile.new_state(one)) for one in (rng, rng, np.random.default_rng(5))
    )
    assert first != second
    assert first == again
    assert first is not None
    assert 2 <= first <= 3


def test_a_sine_has_its_amplitude_frequency_and_offset() -> None:
    profile = Profile(sine=SineProfile(amplitude=2, frequency_hz=5, offset=1))
    assert profile.value(0.0, profile.new_state(RNG)) == 1
    assert profile.value(0.05, profile.new_state(RNG)) == pytest.approx(3)


def test_a_live_value_is_stale_after_its_timeout() -> None:
    profile = Profile(live=LiveInput(timeout_s=0.5))
    assert profile.value(1.5, hold_live_value(None, 0, 1_000_000, 7.0)) == 7
    assert profile.value(1.51, hold_live_value(None, 0, 1_000_000, 7.0)) is None


def table(path: Path, rows: list[tuple[float, float]], **keys: object) -> Profile:
    path.write_text("t_s,value\n" + "".join(f"{t!r},{v!r}\n" for t, v in rows))
    return Profile(table=SeriesTable(str(path), **keys))  # type: ignore[arg-type]


def test_a_series_holds_each_value_or_interpolates(tmp_path: Path) -> None:
    rows = [(0.0, 1.0), (1.0, 3.0), (2.0, 2.0)]
    times = [-0.1, 0.0, 0.5, 1.0, 1.75, 2.0, 2.1]
    held, straight = (
        table(tmp_path / "a.csv", rows, interpolate=kind) for kind in ("hold", "linear")
    )
    state = held.new_state(RNG)
    assert [held.value(t, state) for t in times] == [None, 1, 1, 3, 3, 2, None]
    state = straight.new_state(RNG)
    assert [straight.value(t, state) for t in times] == [None, 1, 2, 3, 2.25, 2, None]


def test_a_parquet_series_equals_its_csv(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [(i * 0.1, math.sin(i)) for i in range(100)]
    written = table(tmp_path / "a.csv", rows)
    columns = {"value": [v for _, v in rows], "t_s": [t for t, _ in rows]}
    parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
    packed = Profile(table=SeriesTable(str(tmp_path / "a.parquet")))
    states = written.new_state(RNG), packed.new_state(RNG)
    for i in range(120):
        assert written.value(i * 0.09, states[0]) == packed.value(i * 0.09, states[1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,x\n0,1\n", "has no column value; known: t_s, x"),
        ("t_s,value\n0,1\n1,one\n", "a.csv:3: could not convert"),
        ("t_s,value\n1,1\n0,1\n", "times do not increase"),
        (None, "cannot be read"),
    ],
)
def test_an_invalid_series_is_refused_when_the_schedule_is_read(
    tmp_path: Path, text: str | None, said: str
) -> None:
    if text is not None:
        (tmp_path / "a.csv").write_text(text)
    (tmp_path / "night.yaml").write_text(
        "faults:\n"
        "  - fault: bias\n"
        "    target: HIL_SENSOR.xgyro\n"
        "    profile:\n"
        "      table: {file: a.csv}\n"
    )
    with pytest.raises(ConfigError) as caught:
        read_schedule(tmp_path / "night.yaml")
    assert "night.yaml:5: faults[0].profile.table.file = a.csv" in str(caught.value)
    assert said in str(caught.value)


def test_a_series_is_read_again_when_its_file_has_changed(tmp_path: Path) -> None:
    profile = table(tmp_path / "a.csv", [(0.0, 1.0)])
    assert profile.value(0.0, profile.new_state(RNG)) == 1
    table(tmp_path / "a.csv", [(0.0, 2.0)])
    os.utime(tmp_path / "a.csv", ns=(0, 1))
    assert profile.value(0.0, profile.new_state(RNG)) == 2
