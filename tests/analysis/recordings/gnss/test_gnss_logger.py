"""Telephones' logs: ranges from times of transmission, by system and state."""

from pathlib import Path

import numpy as np
import pytest

from analysis.recordings.gnss.gnss_logger import read_gnss_logger
from analysis.recordings.gnss.receiver_logs import is_receiver_log
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS

COLUMNS = (
    "Raw,utcTimeMillis,TimeNanos,LeapSecond,TimeUncertaintyNanos,FullBiasNanos,BiasNanos,"
    "HardwareClockDiscontinuityCount,Svid,TimeOffsetNanos,State,ReceivedSvTimeNanos,"
    "ReceivedSvTimeUncertaintyNanos,Cn0DbHz,PseudorangeRateMetersPerSecond,CarrierFrequencyHz,"
    "ConstellationType"
)
WEEK_NS, DAY_NS = 604_800 * 10**9, 86_400 * 10**9
CLOCK_NS = 2_000_000_000
TRAVEL_NS = 75_000_000  # 22,485 km
GPS_NS = 2236 * WEEK_NS + 250_000 * 10**9 + 123_456_789  # 2022-11-15
GPS, GLONASS, QZSS, BEIDOU, GALILEO = 1, 3, 4, 5, 6
KNOWN, DAY_KNOWN, SECOND_CODE = 1 << 14 | 1, 1 << 15 | 1, 1 << 11


def line(system: int, svid: int, sent_ns: int, state: int, **changes: object) -> str:
    row: dict[str, object] = dict.fromkeys(COLUMNS.split(","), "")
    row |= {"Raw": "Raw", "TimeNanos": CLOCK_NS, "FullBiasNanos": CLOCK_NS - GPS_NS}
    row |= {"HardwareClockDiscontinuityCount": 7, "Svid": svid, "TimeOffsetNanos": 0.0}
    row |= {"State": state, "ReceivedSvTimeNanos": sent_ns, "ReceivedSvTimeUncertaintyNanos": 12}
    row |= {"Cn0DbHz": 40.5, "PseudorangeRateMetersPerSecond": -123.4, "ConstellationType": system}
    return ",".join(str(value) for value in (row | changes).values())


def write(folder: Path, *lines: str) -> Path:
    path = folder / "gnss_log.txt"
    path.write_text(f"#\n# {COLUMNS}\n#\nFix,GPS,1,2,3\n" + "".join(f"{row}\n" for row in lines))
    return path


def test_the_range_is_the_time_between_transmission_and_reception(tmp_path: Path) -> None:
    sent_ns = GPS_NS - TRAVEL_NS
    moscow_ns = (sent_ns + (3 * 3600 - 18) * 10**9) % DAY_NS
    path = write(
        tmp_path,
        line(GPS, 5, sent_ns % WEEK_NS, KNOWN),
        line(GLONASS, 9, moscow_ns, DAY_KNOWN, CarrierFrequencyHz=1602e6 - 2 * 0.5625e6),
        line(QZSS, 194, sent_ns % WEEK_NS, KNOWN),
        line(BEIDOU, 21, (sent_ns - 14 * 10**9) % WEEK_NS, KNOWN, CarrierFrequencyHz=1561.098e6),
        line(GALILEO, 11, sent_ns % WEEK_NS, KNOWN),
        line(GALILEO, 12, sent_ns % (100 * 10**6), SECOND_CODE),
    )
    assert is_receiver_log(path)
    (epoch,) = read_gnss_logger(path)
    assert epoch.satellites == ("G05", "R09", "J02", "C21", "E11", "E12")
    expected_m = TRAVEL_NS * 1e-9 * SPEED_OF_LIGHT_MPS
    assert epoch.pseudorange_m == pytest.approx(np.full(6, expected_m), abs=1e-3)
    assert epoch.doppler_mps == pytest.approx(np.full(6, -123.4), abs=1e-3)
    assert (epoch.week, epoch.tow_s) == (2236, pytest.approx(250_000.123456789, abs=1e-9))
    assert epoch.carrier_hz[1] == pytest.approx(1602e6 - 2 * 0.5625e6)


def test_what_has_no_range_is_passed_over(tmp_path: Path) -> None:
    sent_ns = (GPS_NS - TRAVEL_NS) % WEEK_NS
    good = line(GPS, 5, sent_ns, KNOWN)
    bad = [
        line(GPS, 6, sent_ns, 1),  # the time of week is not known
        line(GPS, 7, sent_ns, KNOWN, ReceivedSvTimeUncertaintyNanos=10**6),
        line(GPS, 8, sent_ns, KNOWN, CarrierFrequencyHz=1176.45e6),
        line(GLONASS, 101, sent_ns, DAY_KNOWN),  # a channel, no satellite
        line(2, 120, sent_ns, KNOWN),
        line(GPS, 9, sent_ns, KNOWN, State="x"),
        "Raw,1,2",
    ]
    (epoch,) = read_gnss_logger(write(tmp_path, good, *bad))
    assert epoch.satellites == ("G05",)


def test_the_clock_is_continuous_until_it_is_set(tmp_path: Path) -> None:
    rows = []
    for second, (drift_ns, count) in enumerate([(0, 7), (900, 7), (900, 8)]):
        sent_ns = (GPS_NS + second * 10**9 - TRAVEL_NS) % WEEK_NS
        clock_ns = CLOCK_NS + second * 10**9
        bias_ns = clock_ns - GPS_NS - second * 10**9 - drift_ns
        rows.append(
            line(
                *(GPS, 5, sent_ns, KNOWN),
                TimeNanos=clock_ns,
                FullBiasNanos=bias_ns,
                HardwareClockDiscontinuityCount=count,
            )
        )
    first, second, third = (e.pseudorange_m[0] for e in read_gnss_logger(write(tmp_path, *rows)))
    assert second == pytest.approx(first, abs=1e-3)
    assert third - first == pytest.approx(900e-9 * SPEED_OF_LIGHT_MPS, abs=1e-3)


def test_a_damaged_first_row_after_the_clock_was_set_costs_that_row_only(tmp_path: Path) -> None:
    rows = []
    for second, count in enumerate((7, 8)):
        sent_ns = (GPS_NS + second * 10**9 - TRAVEL_NS) % WEEK_NS
        set_ns = second * 10**6  # the clock, by one millisecond
        clock = {"TimeNanos": CLOCK_NS + second * 10**9 + set_ns}
        clock["FullBiasNanos"] = clock["TimeNanos"] - GPS_NS - second * 10**9
        clock["HardwareClockDiscontinuityCount"] = count
        if second:
            rows.append(line(GPS, 6, sent_ns, KNOWN, **clock | {"FullBiasNanos": "-16#"}))
        rows.append(line(GPS, 5, sent_ns, KNOWN, **clock))
    epochs = read_gnss_logger(write(tmp_path, *rows))
    assert [epoch.satellites for epoch in epochs] == [("G05",), ("G05",)]
    assert epochs[1].pseudorange_m[0] == pytest.approx(epochs[0].pseudorange_m[0], abs=1e-3)


def test_a_text_that_is_no_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="give a log of GnssLogger"):
        read_gnss_logger(write(tmp_path))
    with pytest.raises(ConfigError, match="cannot be read"):
        read_gnss_logger(tmp_path / "absent.txt")
    rinex = tmp_path / "obs.txt"
    rinex.write_text(f"{'     3.04           OBSERVATION DATA':60}RINEX VERSION / TYPE\n")
    assert not is_receiver_log(rinex)
