"""Observations are found and changed in RINEX 2 and 3, and nothing else changes."""

import numpy as np
import pytest

from mavproxy_fault.rinex.observation_text import file_epochs
from mavproxy_fault.rinex.range_epoch import RangeEpoch
from mavproxy_fault.rinex.signal_change import signal_changes
from mavproxy_fault.rinex.signal_fields import write_change

SECOND_US = 1_000_000
NOON_US = (2149 * 604_800 + 475_200) * SECOND_US  # 2021-03-19 12:00


def labelled(text, label):
    return f"{text:<60}{label}"


def fields(*values):
    """Format observations of 16 characters; None is blank."""
    return "".join(" " * 16 if v is None else f"{v:14.3f}  " for v in values)


THREE = [
    labelled("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE"),
    labelled("G    3 C1C L1C C2W", "SYS / # / OBS TYPES"),
    labelled("E    2 L1C C1C", "SYS / # / OBS TYPES"),
    labelled("", "END OF HEADER"),
    "> 2021 03 19 12 00  0.0000000  0  3",
    "G12" + fields(20_000_000.5, 1.0, 20_000_001.5),
    "E05" + fields(2.0, 24_000_000.0),
    "G 7" + fields(21_000_000.0, 3.0, None),
    "> 2021 03 19 12 00  1.0000000  4  1",
    "a comment of a satellite's kind",
    "> 2021 03 19 12 00  2.0000000  0  1",
    "G12" + fields(20_000_002.5, 1.0, 20_000_003.5),
]
TWO = [
    labelled("     2.11           OBSERVATION DATA    M", "RINEX VERSION / TYPE"),
    labelled("     6    C1    L1    D1    S1    L2    P2", "# / TYPES OF OBSERV"),
    labelled("", "END OF HEADER"),
    " 21  3 19 12  0  0.0000000  0  2 12R 3",
    fields(20_000_000.5, 1.0, 2.0, 3.0, 4.0),
    fields(20_000_001.5),
    fields(19_000_000.0, 1.0, 2.0, 3.0, 4.0),
    fields(None),
]


def written(lines, epoch, faulted):
    """Write the changes of an epoch to its lines, in place."""
    for name, change in signal_changes(faulted, epoch.t_us, None):
        write_change(lines, epoch.fields(name), name, change, np.random.default_rng(1))


@pytest.mark.parametrize(("lines", "rows_of_g12"), [(THREE, [5]), (TWO, [4, 5])])
def test_every_code_is_changed_and_nothing_else(lines, rows_of_g12):
    name, changed = "G12", list(lines)
    first = next(file_epochs(changed))
    assert first.t_us == NOON_US
    written(changed, first, RangeEpoch(tuple(first.rows), {name: 50.25}))
    rows = [i for i, line in enumerate(lines) if line.rstrip() != changed[i].rstrip()]
    assert rows == rows_of_g12
    found = "".join(changed[i] for i in rows)
    assert "20000050.750" in found
    assert "20000051.750" in found


def test_names_with_blanks_and_event_records_are_read():
    found = list(file_epochs(THREE))
    assert [list(epoch.rows) for epoch in found] == [["G12", "E05", "G07"], ["G12"]]
    assert [epoch.t_us - NOON_US for epoch in found] == [0, 2 * SECOND_US]
    assert list(next(file_epochs(TWO)).rows) == ["G12", "R03"]


def test_a_lost_satellite_has_no_observation_and_a_blank_one_stays_blank():
    lines = list(THREE)
    first = next(file_epochs(lines))
    written(lines, first, RangeEpoch(tuple(first.rows), {"G07": 9.0}, frozenset({"G12"})))
    assert lines[5] == "G12"
    assert float(lines[7][3:17]) == 21_000_009.0
    assert lines[7][35:].strip() == ""


def test_faults_add_up():
    epoch = RangeEpoch(("G12",)).changed({"G12": 3.0}, ()).changed({"G12": 4.0}, ["E05"])
    assert epoch == RangeEpoch(("G12",), {"G12": 7.0}, frozenset({"E05"}))
