"""Field maps: the form of the tables, and what becomes of fields that a version lacks."""

import numpy as np
import pytest

from analysis.field_maps.field_map import (
    DATAFLASH,
    FLAGS,
    STATES,
    TLOG,
    TRACK,
    ULOG,
    read_map,
    rows_of,
    values_of,
)
from analysis.recordings.flight_logs.autopilot_logs import KINDS
from analysis.report.curves.panels import BY_KEY


def test_words_in_braces_stand_for_one_line_each() -> None:
    (lines,) = read_map("M first\n  accel  {x,y}  a{1..2} * 2\n").values()
    assert [(line.target, line.name, line.first) for line in lines] == [
        ("accel", "x", True), ("accel", "y", True),
    ]  # fmt: skip
    assert values_of(lines[1], {"a2": np.array([3, 4])}) == pytest.approx([6, 8])


def test_a_line_whose_field_is_missing_or_a_text_gives_nothing() -> None:
    ((line,),) = read_map("M\n  load  processor  Load * 0.1\n").values()
    assert values_of(line, {"Other": np.array([1.0])}) is None
    assert values_of(line, {"Load": np.array([b"x"])}) is None
    assert values_of(line, {"Load": np.array([np.nan])}) is None


def test_arrays_of_all_formats_have_the_element_as_the_first_axis() -> None:
    ((line,),) = read_map("M\n  MAG  all  q[1], q, 7\n").values()
    flat = {"q[0]": np.array([1.0, 2.0]), "q[1]": np.array([3.0, 4.0])}
    wide = {"q": np.array([[1.0, 3.0], [2.0, 4.0]])}
    for columns in (flat, wide):
        found = rows_of(line, columns)
        assert found is not None
        assert found.tolist() == [[3, 1, 3, 7], [4, 2, 4, 7]]


@pytest.mark.parametrize("table", [TLOG, ULOG, DATAFLASH])
def test_every_line_is_of_a_panel_or_of_another_known_kind(table) -> None:
    for line in (line for lines in table.values() for line in lines):
        kind = line.target.partition("#")[0]
        assert kind in (*BY_KEY, *FLAGS, *STATES, TRACK, *KINDS, "VISION", "TRUTH"), line


def test_a_field_that_a_damaged_format_makes_a_text_is_missing() -> None:
    (line,) = read_map("A\n  roll  a  X\n")["A"]
    columns = {"X": np.array([b"12", b"x"]), "Y": np.array([1.0, 2.0])}
    assert values_of(line, columns) is None
    (track,) = read_map("A\n  track  a  Y, X, Y\n")["A"]
    assert rows_of(track, columns) is None


def curve_of(message: str, name: str, columns: dict[str, np.ndarray]) -> list[float] | None:
    (line,) = (one for one in TLOG[message] if f"{one.target} {one.name}" == name)
    found = values_of(line, columns)
    return None if found is None else found.tolist()


def test_what_a_sensor_or_receiver_had_not_measured_yet_has_no_value() -> None:
    flags = np.array([0x3F, 0x23F, 0x3F], np.uint32)
    columns = {"fields_updated": flags, "abs_pressure": np.array([0.0, 950.0, 950.0])}
    assert curve_of("HIL_SENSOR", "baro HIL_SENSOR", columns) == pytest.approx(
        [np.nan, 950, 950], nan_ok=True
    )
    # A fix that is lost later keeps what the receiver said then.
    columns = {"fix_type": np.array([1, 3, 0]), "alt": np.array([0, 488_000, 0])}
    assert curve_of("GPS_RAW_INT", "altitude GPS", columns) == pytest.approx(
        [np.nan, 488, 0], nan_ok=True
    )


@pytest.mark.parametrize(("second", "cell"), [(65535, None), (4100, [4.2])])
def test_the_only_voltage_of_a_battery_is_that_of_no_cell(second, cell) -> None:
    columns = {"voltages": np.array([[4200, second] + [65535] * 8], np.uint16)}
    found = curve_of("BATTERY_STATUS", "battery-cells cell 1", columns)
    assert found == (None if cell is None else pytest.approx(cell))
