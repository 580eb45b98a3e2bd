"""u-blox logs: the receiver's own, and such as are made here of ephemerides that are known."""

import contextlib
import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.orbits.broadcast import pack_ephemeris, satellite_states
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.recordings.gnss.ubx_log import read_ubx
from analysis.recordings.read_recordings import read_rinex, read_rinex_samples
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample
from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris
from tests.analysis.recordings.flight_logs.ulog_encoding import FIELDS, dump_log
from tests.analysis.recordings.gnss.ubx_encoding import (
    broadcast,
    frame,
    klobuchar_page,
    rawx,
    sfrbx,
)

WEEK, TOW_S = 2149, 475_200.0
EPOCH = Epoch(
    t_us=round((WEEK * 604_800 + TOW_S) * 1e6),
    week=WEEK,
    tow_s=TOW_S,
    satellites=("G05", "E11"),
    pseudorange_m=np.array([2.1e7, 2.4e7]),
    doppler_mps=np.array([100.0, -50.0]),
    cn0_dbhz=np.array([44.0, 41.0]),
    signals=("1C", "1C"),
)


def known(path: Path) -> list[Ephemeris]:
    samples = [s.ephemeris for s in read_navigation(path) if isinstance(s, EphemerisSample)]
    return [e for e in samples if isinstance(e, Ephemeris) and e.satellite[0] in "GE"]


def places(ephemeris: Ephemeris) -> np.ndarray:
    """Where the satellite is (m) and its clock (in m), an hour before and behind its time."""
    states = [
        satellite_states(
            np.array([pack_ephemeris(ephemeris)]),
            float(ephemeris.week),
            ephemeris.toe_s + dt_s,
            np.array([2.3e7]),
        )
        for dt_s in (-3600.0, 0.0, 3600.0)
    ]
    return np.array(states)


@pytest.fixture
def cold_start(shared_data: Path) -> Path:
    folder = shared_data / "gnss_ubx"
    if not folder.is_dir():
        pytest.skip(f"no u-blox log at {folder}")
    return folder


def test_orbits_of_a_real_log_are_those_that_rtklib_finds_in_it(cold_start: Path):
    _epochs, sent = read_ubx(cold_start / "cold_start.ubx.gz")
    found = {
        (s.ephemeris.satellite, s.ephemeris.toe_s): s.ephemeris
        for s in sent
        if isinstance(s, EphemerisSample)
    }
    theirs = known(cold_start / "cold_start_rtklib.nav")
    assert len(theirs) == 9
    for wanted in theirs:
        ours = found[wanted.satellite, wanted.toe_s]
        assert isinstance(ours, Ephemeris)
        assert ours.week == wanted.week
        np.testing.assert_allclose(places(ours), places(wanted), atol=1e-3)


def test_two_issues_of_galileo_in_a_real_log_agree(cold_start: Path):
    _epochs, sent = read_ubx(cold_start / "cold_start.ubx.gz")
    by_name: dict[str, list[Ephemeris]] = {}
    for sample in sent:
        if isinstance(sample, EphemerisSample) and sample.ephemeris.satellite[0] == "E":
            assert isinstance(sample.ephemeris, Ephemeris)
            by_name.setdefault(sample.ephemeris.satellite, []).append(sample.ephemeris)
    pairs = [found for found in by_name.values() if len(found) == 2]
    assert len(pairs) == 7
    for old, new in pairs:
        when = float(new.week), new.toe_s, np.array([2.4e7])
        one, two = (satellite_states(np.array([pack_ephemeris(e)]), *when) for e in (old, new))
        np.testing.assert_allclose(one[:, :4], two[:, :4], atol=1.0)


def test_a_real_log_is_read_completely(cold_start: Path):
    samples = read_rinex_samples(cold_start / "cold_start.ubx.gz", [])
    epochs = [s for s in samples if isinstance(s, Epoch)]
    assert len(epochs) == 562
    assert {name[0] for epoch in epochs for name in epoch.satellites} == {"G", "E"}


def test_navigation_messages_are_read_back(shared_data: Path, tmp_path: Path):
    wanted = known(shared_data / "gnss_static" / "SEPT078M.21P")
    assert {e.satellite[0] for e in wanted} == {"G", "E"}
    for i, ephemeris in enumerate(wanted):
        near = replace(EPOCH, week=ephemeris.week, tow_s=ephemeris.toe_s)
        log = tmp_path / f"{i}.ubx"
        log.write_bytes(rawx(near) + broadcast(ephemeris))
        (only,) = read_ubx(log)[1]
        assert isinstance(only, EphemerisSample)
        assert isinstance(only.ephemeris, Ephemeris)
        assert only.ephemeris.health == ephemeris.health & 0x3F
        np.testing.assert_allclose(places(only.ephemeris), places(ephemeris), atol=1e-2)


def test_an_ephemeris_of_next_week_gets_that_week(shared_data: Path, tmp_path: Path):
    first = known(shared_data / "gnss_static" / "SEPT078M.21P")[0]
    late = replace(EPOCH, week=first.week, tow_s=604_799.0)
    log = tmp_path / "late.ubx"
    log.write_bytes(rawx(late) + broadcast(replace(first, toe_s=0.0, toc_s=0.0)))
    (only,) = read_ubx(log)[1]
    assert isinstance(only, EphemerisSample)
    assert only.ephemeris.week == first.week + 1


def test_issues_are_not_mixed(shared_data: Path, tmp_path: Path):
    for ephemeris in known(shared_data / "gnss_static" / "SEPT078M.21P")[:1]:
        one, two = broadcast(ephemeris), broadcast(replace(ephemeris, iode=ephemeris.iode ^ 1))
        log = tmp_path / "mixed.ubx"
        log.write_bytes(rawx(EPOCH) + one[: len(one) // 3] + two[len(two) // 3 :])
        assert read_ubx(log)[1] == []


def test_ranges_and_ionosphere_are_read_back(tmp_path: Path):
    alpha, beta = (2.0**-28, 2.0**-26, -(2.0**-24), 0.0), (2.0**17, -(2.0**14), 2.0**16, 0.0)
    log = tmp_path / "a.ubx"
    nmea = b"$GNGGA,120000.00,,,,,0,00,99.99,,,,,,*7D\r\n"
    log.write_bytes(nmea + rawx(EPOCH) + sfrbx("G05", klobuchar_page(alpha, beta)) + nmea)
    (epoch,), sent = read_ubx(log)
    assert sent == [IonosphereSample(0, alpha, beta)]
    assert (epoch.t_us, epoch.week, epoch.tow_s) == (EPOCH.t_us, WEEK, TOW_S)
    assert (epoch.satellites, epoch.signals) == (EPOCH.satellites, EPOCH.signals)
    np.testing.assert_array_equal(epoch.pseudorange_m, EPOCH.pseudorange_m)
    np.testing.assert_allclose(epoch.doppler_mps, EPOCH.doppler_mps, rtol=1e-6)
    np.testing.assert_array_equal(epoch.cn0_dbhz, EPOCH.cn0_dbhz)


def test_a_library_reads_the_same_from_a_real_log(cold_start: Path):
    pyubx2 = pytest.importorskip("pyubx2")
    data = gzip.decompress((cold_start / "cold_start.ubx.gz").read_bytes())[:600_000]
    epochs = {e.tow_s: e for e in read_ubx(cold_start / "cold_start.ubx.gz")[0]}
    compared = 0
    for start in (i for i in range(len(data)) if data.startswith(b"\xb5b\x02\x15", i)):
        end = start + 8 + int.from_bytes(data[start + 4 : start + 6], "little")
        message = pyubx2.UBXReader.parse(data[start:end]) if end <= len(data) else None
        if message is None or message.rcvTow not in epochs:
            continue
        epoch = epochs[message.rcvTow]
        ranges = [getattr(message, f"prMes_{k + 1:02d}") for k in range(message.numMeas)]
        assert set(epoch.pseudorange_m.tolist()) <= set(ranges)
        compared += 1
    assert compared > 50


def test_a_corrupted_length_hides_no_other_frame(tmp_path: Path):
    whole = rawx(EPOCH)
    damaged = whole[:4] + b"\xff\x7f" + whole[6:]
    log = tmp_path / "a.ubx"
    log.write_bytes(damaged + rawx(EPOCH) + whole[:-1] + b"\x00")
    assert len(read_ubx(log)[0]) == 1


@given(data=st.data())
@settings(deadline=None)
def test_corruption_anywhere_raises_only_config_errors(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
):
    log = tmp_path_factory.mktemp("ubx") / "a.ubx"
    whole = bytearray(3 * (rawx(EPOCH) + sfrbx("E11", list(range(8))) + frame(0x13, b"\x00\x05")))
    for at in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=8)):
        whole[at] = data.draw(st.integers(0, 255))
    log.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
    with contextlib.suppress(ConfigError):
        epochs, _sent = read_ubx(log)
        assert len(epochs) <= 3


def test_a_receiver_without_time_has_no_epochs(tmp_path: Path):
    log = tmp_path / "a.ubx"
    log.write_bytes(rawx(replace(EPOCH, week=0, tow_s=18.0)))
    with pytest.raises(ConfigError, match="no epoch has a readable pseudorange"):
        read_rinex(log, [])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.ubx", b"no frames here", "has no complete UBX-RXM-RAWX"),
        ("a.ubx.gz", gzip.compress(rawx(EPOCH))[:-9], "not a u-blox log"),
        ("b.ubx", rawx(EPOCH), "no readable ephemeris"),
    ],
    ids=["no frames", "cut", "no orbits"],
)
def test_unusable_input_ends_in_a_one_line_error(
    name: str, content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    log = tmp_path / name
    log.write_bytes(content)
    assert main(["monitor", "--rinex", str(log), "--zenoh", "off"]) == 2
    assert words in capsys.readouterr().err


def test_faults_are_put_into_rinex_files_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    log, schedule = tmp_path / "a.ubx", tmp_path / "faults.yaml"
    log.write_bytes(rawx(EPOCH))
    schedule.write_text("faults: []\n")
    command = ["monitor", "--rinex", str(log), "--zenoh", "off"]
    assert main([*command, "--schedule", str(schedule)]) == 2
    assert "is a receiver log" in capsys.readouterr().err


def test_a_gps_dump_in_a_px4_log_is_read_like_a_ubx_log(tmp_path: Path) -> None:
    sent = b"".join(rawx(replace(EPOCH, tow_s=TOW_S + i)) for i in range(5))
    path, straight = tmp_path / "flight.ulg", tmp_path / "same.ubx"
    straight.write_bytes(sent)
    # Between them what PX4 sent to the receiver, and what a second receiver sent.
    path.write_bytes(dump_log(sent, between=[(0, 0x80, sent[:70]), (1, 0, sent[:79])]))
    found, expected = read_ubx(path)[0], read_ubx(straight)[0]
    assert [epoch.tow_s for epoch in found] == [TOW_S + i for i in range(5)]
    for one, same in zip(found, expected, strict=True):
        assert one.satellites == same.satellites
        assert one.pseudorange_m.tolist() == same.pseudorange_m.tolist()


def test_a_px4_log_without_a_dump_says_how_to_get_one(tmp_path: Path, capsys) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(dump_log(b"", topic="other"))
    assert main(["monitor", "--rinex", str(path), "--zenoh", "off"]) == 2
    assert "has no gps_dump; set GPS_DUMP_COMM to 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "missing"),
    [
        (FIELDS.replace(" len", " long"), "len"),
        (FIELDS.replace("[79] data", "[79] date"), r"data\[0\]"),
        (FIELDS.replace("[79] data", "[40] data;uint8_t[39] rest"), r"data\[40\]"),
        (FIELDS.replace("uint8_t len;uint8_t[79]", "uint64_t len;uint8_t[72]"), "len"),
    ],
    ids=["no length", "no bytes", "too few bytes", "a length of eight bytes"],
)
def test_a_dump_with_other_fields_ends_in_a_one_line_error(
    wrong: str, missing: str, tmp_path: Path
) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(dump_log(rawx(EPOCH), fields=wrong))
    with pytest.raises(ConfigError, match=f"flight.ulg: gps_dump has no bytes {missing}: "):
        read_ubx(path)


def test_an_early_px4_log_without_receiver_numbers_has_one_receiver(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(dump_log(rawx(EPOCH), fields=FIELDS.replace("instance", "unnamed")))
    assert [epoch.tow_s for epoch in read_ubx(path)[0]] == [TOW_S]


@given(data=st.data())
@settings(deadline=None)
def test_a_corrupted_px4_log_raises_only_config_errors(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("ulg") / "flight.ulg"
    whole = bytearray(dump_log(3 * rawx(EPOCH)))
    # Most corruption is put into the definitions of the messages.
    head = whole.index(b"A", whole.index(FIELDS.encode()) + len(FIELDS))
    places = st.one_of(st.integers(0, head), st.integers(0, len(whole) - 1))
    for at in data.draw(st.lists(places, max_size=8)):
        whole[at] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.sampled_from([len(whole), len(whole) // 2, head]))])
    with contextlib.suppress(ConfigError):
        assert len(read_ubx(path)[0]) <= 3
