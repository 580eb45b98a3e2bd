"""RINEX files as a state machine: header records, time systems and damage where they stand."""

import pytest

from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.rinex.navigation_record import kepler_ephemeris, read_navigation_file
from mavproxy_fault.rinex.observation_text import file_epochs
from mavproxy_fault.rinex.signal_fields import number_in
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.label import latest_labels

ADDED_M, RANGE_M = 50.0, 22_000_000.125
CODES_3 = {
    "G": ("1C", "1S", "1L", "1X", "1P", "1W", "1Y", "2C", "2S", "2L", "2W", "5I", "5Q", "5X"),
    "E": ("1A", "1B", "1C", "1X", "5I", "5Q", "5X", "7I", "7Q", "8X", "6B", "6C"),
}
CODES_2 = ("C1", "P1", "C2", "P2", "C5", "C6", "C7", "C8")


def labelled(text, label):
    return f"{text:<60}{label}"


def version(number, system="M"):
    return labelled(f"{number:9.2f}{'':11}{'OBSERVATION DATA':20}{system}", "RINEX VERSION / TYPE")


def types_3(system, names):
    rows = [names[i : i + 13] for i in range(0, len(names), 13)]
    heads = [f"{system}  {len(names):3d}"] + [" " * 6] * (len(rows) - 1)
    return [
        labelled(head + "".join(f" {name}" for name in row), "SYS / # / OBS TYPES")
        for head, row in zip(heads, rows, strict=True)
    ]


def types_2(names):
    rows = [names[i : i + 9] for i in range(0, len(names), 9)]
    heads = [f"{len(names):6d}"] + [" " * 6] * (len(rows) - 1)
    return [
        labelled(head + "".join(f"{name:>6}" for name in row), "# / TYPES OF OBSERV")
        for head, row in zip(heads, rows, strict=True)
    ]


END = labelled("", "END OF HEADER")


def values(names):
    """The fields of a satellite: ranges for codes, other numbers for the rest."""
    return "".join(
        f"{RANGE_M + i if name[0] in 'CP' else 40.0 + i:14.3f} 7" for i, name in enumerate(names)
    )


def epoch_3(second, *rows, flag=0, count=None):
    return [f"> 2021 03 19 12 00 {second:10.7f}  {flag}{count or len(rows):3d}", *rows]


def epoch_2(second, rows, flag=0, names=None):
    listed = "".join(rows) if names is None else names
    lines = [f" 21  3 19 12  0 {second:10.7f}  {flag}{len(rows):3d}{listed}"]
    for row in rows.values():
        text = values(row)
        lines += [text[i : i + 80] for i in range(0, max(len(text), 1), 80)]
    return lines


def all_kinds(codes):
    return tuple(kind + code for kind in "LSDC" for code in codes)


def changes(tmp_path, lines, target, for_s=100):
    """The change of each named observation, in each epoch, and the labels."""
    path = tmp_path / "a.obs"
    path.write_text("\n".join(lines) + "\n")
    fault = {"fault": "bias", "target": f"PSEUDORANGE.{target}", "value": ADDED_M, "for_s": for_s}
    after, labels = faulted_lines(path, parse_schedule({"faults": [fault]}))
    found = []
    for epoch in file_epochs(lines):
        row = {}
        for name in epoch.rows:
            for field in epoch.fields(name):
                before = number_in(lines, field)
                row[name, field.name] = (number_in(after, field) or 0.0) - (before or 0.0)
        found.append(row)
    return found, latest_labels(labels)


def check_label(found, labels, target):
    """A label equals the difference of the two files on all codes that it names, and on no other
    observation."""
    for row in found:
        for (name, kind), change in row.items():
            wanted = ADDED_M if name == target and kind[0] in "CP" else 0.0
            assert change == pytest.approx(wanted, abs=1e-6), (name, kind)
    (label,) = labels
    assert (label.magnitude, label.frames) == (ADDED_M, len(found))


@pytest.mark.parametrize("system", CODES_3)
@pytest.mark.parametrize("number", [3.02, 3.05, 4.02])
def test_a_label_is_the_difference_of_every_signal_of_rinex_3_and_4(tmp_path, system, number):
    first, second = all_kinds(CODES_3[system]), all_kinds(CODES_3[system])[::-1]
    target = f"{system}07"
    lines = [version(number), *types_3(system, first), END]
    lines += epoch_3(0, f"{system}07" + values(first), f"{system} 8" + values(first))
    # From here on the fields have another order.
    records = types_3(system, second)
    lines += epoch_3(1, *records, flag=4)
    lines += epoch_3(1, f"{system}08" + values(second), f"{system}07" + values(second))
    found, labels = changes(tmp_path, lines, target)
    assert len(found) == 2
    check_label(found, labels, target)


def test_a_label_is_the_difference_of_every_signal_of_rinex_2(tmp_path):
    first = tuple(k + b for k in "LSD" for b in "125678") + CODES_2
    second = first[::-1]
    lines = [version(2.11), *types_2(first), END, *epoch_2(0, {"G07": first, "R08": first})]
    records = types_2(second)
    lines += [f"{'':28}4{len(records):3d}", *records]  # an event may have no time
    lines += epoch_2(1, {"R08": second, "  7": second})
    found, labels = changes(tmp_path, lines, "G07")
    assert len(found) == 2
    check_label(found, labels, "G07")


def test_stored_factors_are_applied(tmp_path):
    lines = [version(3.04), *types_3("G", ("C1C", "S1C"))]
    lines += [labelled("G  100  1 C1C", "SYS / SCALE FACTOR"), END]
    lines += epoch_3(0, "G07" + values(("C1C", "S1C")))
    found, labels = changes(tmp_path, lines, "G07")
    check_label(found, labels, "G07")


def test_a_satellite_without_a_range_gets_no_label(tmp_path):
    lines = [version(3.04), *types_3("G", ("L1C", "C1C")), END]
    lines += epoch_3(0, f"G07{40.0:14.3f}", "G08" + values(("L1C", "C1C")))
    found, labels = changes(tmp_path, lines, "G07")
    assert not any(found[0].values())
    assert labels == []


def test_joined_files_are_read_with_their_own_headers():
    two = [version(2.11), *types_2(("S1", "C1")), END, *epoch_2(0, {"G07": ("S1", "C1")})]
    three = [version(3.04), *types_3("G", ("C1C",)), END, *epoch_3(5, "G07" + values(("C1C",)))]
    for lines in (two + three, three + two):
        epochs = list(file_epochs(lines))
        assert len(epochs) == 2
        for epoch in epochs:
            (field,) = (f for f in epoch.fields("G07") if f.name[0] == "C")
            assert number_in(lines, field) == pytest.approx(RANGE_M, abs=1.1)


@pytest.mark.parametrize(
    ("clock", "system", "offset_s"),
    [("GPS", "M", 0), ("GAL", "M", 0), ("QZS", "M", 0), ("GLO", "M", 18), ("UTC", "M", 18),
     ("BDT", "M", 14), ("", "M", 0), ("", "R", 18), ("", "C", 14), ("", "E", 0)],
)  # fmt: skip
def test_epochs_are_in_gps_time_whatever_the_time_system(clock, system, offset_s):
    first = f"{2021:6d}{3:6d}{19:6d}{12:6d}{0:6d}{0.0:13.7f}     {clock}"
    lines = [version(3.04, system), *types_3("G", ("C1C",)), labelled(first, "TIME OF FIRST OBS")]
    (epoch,) = file_epochs([*lines, END, *epoch_3(0, "G07" + values(("C1C",)))])
    assert (epoch.week, epoch.tow_s) == (2149, 475_200 + offset_s)


def test_the_blank_letter_of_rinex_2_is_that_of_the_file():
    lines = [version(2.10, "R"), *types_2(("C1",)), END, *epoch_2(0, {"  7": ("C1",)})]
    assert [list(epoch.rows) for epoch in file_epochs(lines)] == [["R07"]]


@pytest.mark.parametrize("damage", ["names", "time", "line lost", "cycle slips"])
def test_damage_costs_its_epoch_only(damage):
    kinds = ("C1", "L1", "S1", "D1", "P1", "P2")
    rows = {"G07": kinds, "G08": kinds}
    broken = epoch_2(1, rows)
    if damage == "names":
        broken = epoch_2(1, rows, names="G07")
    elif damage == "time":
        broken = epoch_2(1, rows)
        broken[0] = broken[0].replace(" 12 ", " 72 ", 1)
    elif damage == "line lost":
        del broken[2]
    else:
        broken = epoch_2(1, rows, flag=6)
    lines = [version(2.11), *types_2(kinds), END, *epoch_2(0, rows), *broken, *epoch_2(2, rows)]
    epochs = list(file_epochs(lines))
    assert [epoch.tow_s % 60 for epoch in epochs] == [0, 2]


ORBIT = {
    "IODE": 11.0, "sqrt_a": 5153.6, "toe": 0.0, "week": 0.0, "source": 0.0, "delay": 1e-9,
    "delay_b": 2e-9,
}  # fmt: skip


def record(satellite, toc, last="", **given):
    v = ORBIT | given
    rows = [
        [v["IODE"], 0.0, 0.0, 0.0], [0.0, 1e-3, 0.0, v["sqrt_a"]], [v["toe"], 0.0, 0.0, 0.0],
        [0.9, 0.0, 0.0, 0.0], [0.0, v["source"], v["week"], 0.0],
        [2.0, 0.0, v["delay"], v["delay_b"]],
    ]  # fmt: skip
    lines = [f"{satellite} {toc}" + f"{1e-4:19.12E}{0.0:19.12E}{0.0:19.12E}"]
    lines += [" " * 4 + "".join(f"{x:19.12E}" for x in row) for row in rows]
    return [*lines, " " * 4 + f"{v['toe']:19.12E}{4.0:19.12E}" + last]


def read_one(tmp_path, *lines):
    path = tmp_path / "a.nav"
    head = labelled(f"{3.04:9.2f}{'':11}{'N: GNSS NAV DATA':20}M", "RINEX VERSION / TYPE")
    path.write_text("\n".join([head, END, *lines]) + "\n")
    return read_navigation_file(path)[0]


@pytest.mark.parametrize("week", [0, 1023, 101, 2149, 2150, 2151, 9999])
def test_the_week_is_that_of_the_clock_not_of_transmission(tmp_path, week):
    # Saturday evening, with the time of ephemeris at the start of the next week.
    (read,) = read_one(tmp_path, *record("G07", "2021 03 20 23 59 44", toe=0.0, week=float(week)))
    ephemeris = kepler_ephemeris(read)
    assert (ephemeris.week, ephemeris.toe_s, ephemeris.toc_s) == (2150, 0.0, 604_784.0)


def test_beidou_times_are_converted_over_the_weeks_end(tmp_path):
    (read,) = read_one(tmp_path, *record("C21", "2021 03 20 23 59 50", toe=604_790.0, week=792.0))
    ephemeris = kepler_ephemeris(read)
    assert (ephemeris.week, ephemeris.toe_s, ephemeris.toc_s) == (2150, 4.0, 4.0)


@pytest.mark.parametrize(
    ("source", "is_fnav"),
    [(513, False), (516, False), (517, False), (258, True), (1, False), (2, True), (3, False),
     (4, False), (7, False), (0, False), (256, True), (512, False)],
)  # fmt: skip
def test_galileo_group_delay_follows_the_bits_of_the_data_source(tmp_path, source, is_fnav):
    (read,) = read_one(tmp_path, *record("E07", "2021 03 19 12 00 00", source=float(source)))
    assert read.is_fnav == is_fnav
    assert kepler_ephemeris(read).group_delay_s == (1e-9 if is_fnav else 2e-9)


@pytest.mark.parametrize(
    "last", [" 0.499063314674-269 0.664593648549-315", " ************** nan", ""]
)
def test_spare_fields_are_not_read(tmp_path, last):
    (read,) = read_one(tmp_path, *record("G07", "2021 03 19 12 00 00", last=last, toe=475_200.0))
    assert kepler_ephemeris(read).toe_s == 475_200.0


def test_a_damaged_record_costs_itself_only(tmp_path):
    whole = record("G07", "2021 03 19 12 00 00")
    broken = record("G08", "2021 03 19 12 00 00")
    for damaged in (
        [*broken[:3], broken[3].replace("E", "Q"), *broken[4:]],
        broken[:4],
        [broken[0].replace(" 12 ", " 1x "), *broken[1:]],
    ):
        records = read_one(tmp_path, *damaged, *whole, *damaged)
        assert [read.satellite for read in records] == ["G07"]


def test_glonass_of_rinex_2_is_read(tmp_path):
    path = tmp_path / "a.21g"
    head = labelled(f"{2.10:9.2f}{'':11}{'GLONASS NAV DATA':20}", "RINEX VERSION / TYPE")
    rows = [[1.0e4, 1.0, 0.0, 0.0], [2.0e4, 2.0, 0.0, 5.0], [1.5e4, 3.0, 0.0, 0.0]]
    lines = [" 7 21  3 19 11 45  0.0" + f"{1e-5:19.12E}{0.0:19.12E}{0.0:19.12E}"]
    lines += [" " * 3 + "".join(f"{x:19.12E}" for x in row) for row in rows]
    path.write_text("\n".join([head, END, *lines]) + "\n")
    (read,) = read_navigation_file(path)[0]
    assert (read.satellite, read.toc) == ("R07", (2149, 474_300 + 18))
    assert read.numbers[:12] == [x for row in rows for x in row]
