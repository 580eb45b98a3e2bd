"""Septentrio logs: a real one against RTKLIB, a library and the receiver, and some made here."""

import contextlib
import gzip
import math
from binascii import crc_hqx
from dataclasses import replace
from pathlib import Path
from struct import pack, unpack_from

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.orbits.broadcast import pack_ephemeris
from analysis.recordings.gnss.receiver_logs import is_receiver_log
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.recordings.gnss.rinex_observations import read_observations
from analysis.recordings.gnss.sbf_log import read_sbf
from analysis.recordings.gnss.sbf_orbits import GPS_NAV, QZS_NAV, satellite_name
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import EphemerisSample, Epoch
from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

TESTS = Path(__file__).parents[3]
LOG = TESTS / "data/septentrio/log.sbf"
RTKLIB = TESTS / "authorities/rtklib_sbf"
MEAS_EPOCH, PVT_GEODETIC = 4027, 4007
WEEK, TOW_MS = 2360, 212_541_000


def block(number: int, payload: bytes) -> bytes:
    body = pack("<HH", number, 8 + len(payload)) + payload
    return b"$@" + pack("<H", crc_hqx(body, 0)) + body


def first(
    satellite: int, signal: int, range_m: float, doppler_hz: float = 0.0, others: bytes = b""
) -> bytes:
    """A first signal of 40 dBHz with its further ones."""
    steps = round(range_m * 1000)
    low, information = (signal, 0) if signal < 31 else (31, signal - 32 << 3)
    head = pack("<BBBBI", 1, low, satellite, steps >> 32, steps & 0xFFFFFFFF)
    doppler = -(2**31) if math.isnan(doppler_hz) else round(doppler_hz * 10_000)
    return head + pack("<iHbBHBB", doppler, 0, 0, 120, 9, information, len(others) // 12) + others


def further(signal: int, steps: int, rate_steps: int, antenna: int = 0) -> bytes:
    """A further signal by its differences in mm and tenths of mHz."""
    high = steps >> 16 & 7 | (rate_steps >> 16 & 31) << 3
    return pack(
        "<BBBBbBHHH", antenna << 5 | signal, 9, 100, high, 0, 0, steps & 65535, 0,
        rate_steps & 65535,
    )  # fmt: skip


def meas_epoch(*signals: bytes, tow_ms: int = TOW_MS, flags: int = 0) -> bytes:
    head = pack("<IHBBBBBB", tow_ms, WEEK, len(signals), 20, 12, flags, 0, 0)
    return block(MEAS_EPOCH, head + b"".join(signals))


def read_bytes(folder: Path, data: bytes) -> list[Epoch]:
    log = folder / "a.sbf"
    log.write_bytes(data)
    return read_sbf(log)[0]


def test_ranges_of_a_real_log_are_those_that_rtklib_finds_in_it():
    epochs = {epoch.tow_s: epoch for epoch in read_sbf(LOG)[0]}
    assert len(epochs) == 12
    for theirs in read_observations(RTKLIB / "ranges.obs"):
        ours = epochs[theirs.tow_s]
        # RTKLIB 2.4.3 knows neither new BeiDou satellites nor all of Galileo's.
        place = {name: i for i, name in enumerate(ours.satellites)}
        rows = [place[name] for name in theirs.satellites]
        assert len(rows) == len(theirs.satellites) > 30
        np.testing.assert_allclose(ours.pseudorange_m[rows], theirs.pseudorange_m, atol=6e-4)
        np.testing.assert_allclose(ours.doppler_mps[rows], theirs.doppler_mps, atol=2e-4)


def test_orbits_of_a_real_log_are_those_that_rtklib_finds_in_it():
    found = {
        s.ephemeris.satellite: s.ephemeris
        for s in read_sbf(LOG)[1]
        if isinstance(s, EphemerisSample)
    }
    theirs = {
        s.ephemeris.satellite: s.ephemeris
        for s in read_navigation(RTKLIB / "orbits.nav")
        # It does not read BeiDou's.
        if isinstance(s, EphemerisSample) and s.ephemeris.satellite[0] in "GER"
    }
    assert len(theirs) > 40
    assert set(theirs) <= set(found)
    for name, wanted in theirs.items():
        ours = found[name]
        assert (ours.health == 0) == (wanted.health == 0), name
        if (
            isinstance(ours, Ephemeris) and name[0] == "E"
        ):  # RTKLIB 2.4.3 marks I/NAV as F/NAV, whose delay is E5a's
            ours = replace(ours, group_delay_s=ours.group_delay_e5a_s)
        packed = pack_ephemeris(ours), pack_ephemeris(wanted)
        rounded = 1e-7 if name[0] == "R" else 1e-11  # RINEX has 1e-12 of a km/s
        np.testing.assert_allclose(*packed, rtol=rounded, atol=1e-16, err_msg=name)


@pytest.mark.parametrize(("systems", "satellites"), [("GE", 16), ("GEC", 25)])
def test_a_real_log_gives_the_position_of_its_receiver(systems: str, satellites: int):
    data, at, positions = LOG.read_bytes(), 0, []
    while at < len(data):
        number, length = unpack_from("<HH", data, at + 4)
        if number & 0x1FFF == PVT_GEODETIC:
            positions.append(unpack_from("<ddd", data, at + 16))
        at += length
    lat, lon, height = positions[-1]
    decisions = [
        d for d in run_detector(Detector(DetectorConfig(systems=systems)), read_rinex_samples(LOG,
        [])) if isinstance(d, Decision)
    ]  # fmt: skip
    assert len(decisions) == 12
    assert not any(d.alarm for d in decisions)
    last = decisions[-1]
    assert len(last.satellites) == satellites
    assert last.position_ecef_m is not None
    off = ned_axes(lat, lon) @ (
        np.array(last.position_ecef_m) - np.asarray(ecef_from_geodetic(lat, lon, height))
    )
    # The receiver has SBAS's corrections, of the ionosphere too: 1.0 and 1.4 m by its own account.
    assert math.hypot(off[0], off[1]) < 2.0
    assert abs(off[2]) < 4.0


def test_a_library_reads_the_same_from_a_real_log():
    pysbf2 = pytest.importorskip("pysbf2")
    read, sent = read_sbf(LOG)
    epochs = {round(epoch.tow_s * 1000): epoch for epoch in read}
    delays = {
        s.ephemeris.satellite: s.ephemeris.group_delay_s
        for s in sent
        if isinstance(s, EphemerisSample) and isinstance(s.ephemeris, Ephemeris)
    }
    compared = 0
    with LOG.open("rb") as stream:
        for _raw, message in pysbf2.SBFReader(stream):
            if message is not None and message.identity == "GALNav":
                assert delays[satellite_name(message.SVID)] == message.BGD_L1E5b
            if message is None or message.identity != "MeasEpoch":
                continue
            ours = epochs[message.TOW]
            ranges = dict(zip(ours.satellites, ours.pseudorange_m.tolist(), strict=True))
            for i in range(1, message.N1 + 1):
                of = {k: getattr(message, f"{k}_{i:02d}") for k in ("SVID", "CodeMSB", "CodeLSB")}
                name = satellite_name(of["SVID"])
                if getattr(message, f"SigIdxLo_{i:02d}") not in (0, 8, 17, 28) or name is None:
                    continue
                assert ranges[name] == pytest.approx(of["CodeMSB"] + of["CodeLSB"], abs=1e-3)
                compared += 1
    assert compared > 300


def test_a_further_signal_is_read_by_its_difference(tmp_path: Path):
    galileo = first(71, 21, 24e6, 1000.0, others=further(17, -8_500, 12_345))
    (epoch,) = read_bytes(tmp_path, meas_epoch(galileo))
    assert (epoch.satellites, epoch.signals) == (("E01",), ("1C",))
    assert epoch.pseudorange_m[0] == pytest.approx(24e6 - 8.5, abs=1e-6)
    doppler_hz = 1000.0 * 1575.42 / 1207.14 + 1.2345
    assert epoch.doppler_mps[0] == pytest.approx(-doppler_hz * 299792458.0 / 1575.42e6)
    assert epoch.cn0_dbhz[0] == 35.0


def test_unknown_values_stay_unknown(tmp_path: Path):
    none = first(1, 0, 0.0, others=further(0, 5, 5))
    no_rate = first(2, 0, 21e6, math.nan)
    no_difference = first(71, 21, 24e6, others=further(17, -4 << 16, -16 << 16))
    other_antenna = first(72, 21, 24e6, others=further(17, 5, 5, antenna=1))
    unknown = first(255, 0, 21e6)
    (epoch,) = read_bytes(
        tmp_path, meas_epoch(none, no_rate, no_difference, other_antenna, unknown)
    )
    assert epoch.satellites == ("G02",)
    assert np.isnan(epoch.doppler_mps[0])


def test_qzss_on_either_code_is_read_and_glonass_has_its_channel(tmp_path: Path):
    glonass = bytearray(first(47, 8, 21e6))
    glonass[18] = 8 - 7 << 3
    signals = first(182, 6, 38e6), first(184, 38, 38e6), bytes(glonass)
    (epoch,) = read_bytes(tmp_path, meas_epoch(*signals))
    assert list(zip(epoch.satellites, epoch.signals, strict=True)) == [
        ("J02", "1C"), ("J04", "1E"), ("R10", "1C"),
    ]  # fmt: skip
    assert epoch.carrier_hz is not None
    assert epoch.carrier_hz[2] == 1602e6 - 7 * 0.5625e6


def test_qzss_ephemerides_are_read_like_those_of_gps(tmp_path: Path):
    data = LOG.read_bytes()
    at = next(
        i for i in range(len(data)) if data[i : i + 2] == b"$@" and number_at(data, i) == GPS_NAV
    )
    payload = bytearray(data[at + 8 : at + int.from_bytes(data[at + 6 : at + 8], "little")])
    gps = f"G{payload[6]:02d}"
    payload[6], payload[12] = 184, 0b010000  # J04, and C/A is what it does not send
    log = tmp_path / "a.sbf"
    log.write_bytes(meas_epoch(first(184, 38, 38e6)) + block(QZS_NAV, bytes(payload)))
    (sample,) = read_sbf(log)[1]
    assert isinstance(sample, EphemerisSample)
    known = {s.ephemeris.satellite: s for s in read_sbf(LOG)[1] if isinstance(s, EphemerisSample)}
    assert isinstance(known[gps].ephemeris, Ephemeris)
    assert sample.ephemeris == replace(known[gps].ephemeris, satellite="J04")


def number_at(data: bytes, at: int) -> int:
    """The number of a block."""
    return int.from_bytes(data[at + 4 : at + 6], "little") & 0x1FFF


def test_an_epoch_may_come_in_several_blocks(tmp_path: Path):
    one, two = meas_epoch(first(1, 0, 21e6)), meas_epoch(first(2, 0, 22e6))
    later = meas_epoch(first(1, 0, 21e6), tow_ms=TOW_MS + 1000)
    assert [e.satellites for e in read_bytes(tmp_path, one + two + later)] == [
        ("G01", "G02"), ("G01",),
    ]  # fmt: skip


def test_scrambled_ranges_are_ignored(tmp_path: Path):
    whole = meas_epoch(first(1, 0, 21e6))
    assert len(read_bytes(tmp_path, whole + meas_epoch(first(2, 0, 22e6), flags=0x80))) == 1


def test_a_corrupted_length_hides_no_other_block(tmp_path: Path):
    whole = meas_epoch(first(1, 0, 21e6))
    damaged = whole[:6] + b"\xfc\x7f" + whole[8:]
    assert len(read_bytes(tmp_path, damaged + whole + whole[:-4])) == 1


@given(data=st.data())
@settings(deadline=None)
def test_corruption_anywhere_raises_only_config_errors(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
):
    log = tmp_path_factory.mktemp("sbf") / "a.sbf"
    blocks = bytearray(LOG.read_bytes()[:6000])
    for at in data.draw(st.lists(st.integers(0, len(blocks) - 1), max_size=8)):
        blocks[at] = data.draw(st.integers(0, 255))
    # Behind a checksum that is right, too: a payload of any bytes.
    wrong = block(data.draw(st.sampled_from([4027, 5891, 5893, 4002, 4095])), blocks[:200])
    log.write_bytes(blocks[: data.draw(st.integers(0, len(blocks)))] + wrong)
    with contextlib.suppress(ConfigError):
        read_sbf(log)


@pytest.mark.parametrize(
    "name", ["a.sbf", "SEPT078M.21_", "a.SBF.gz", "SEPT078M.21_.gz", "a.ubx", "a.ulg"]
)
def test_a_receiver_s_log_is_known_by_its_name(name: str):
    assert is_receiver_log(Path(name))


@pytest.mark.parametrize("name", ["SEPT078M.21O", "a.obs", "a.21_x", "sbf"])
def test_a_rinex_file_is_no_receiver_s_log(name: str):
    assert not is_receiver_log(Path(name))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.sbf", b"no blocks here", "has no complete MeasEpoch"),
        ("a.sbf.gz", gzip.compress(LOG.read_bytes())[:-9], "not a Septentrio log"),
        ("b.sbf", meas_epoch(first(1, 0, 21e6)), "no readable ephemeris"),
        ("c.sbf", meas_epoch(tow_ms=2**32 - 1), "no epoch has a readable pseudorange"),
    ],
    ids=["no blocks", "cut", "no orbits", "no time"],
)
def test_unusable_input_ends_in_a_one_line_error(
    name: str, content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    log = tmp_path / name
    log.write_bytes(content)
    assert main(["monitor", "--rinex", str(log), "--zenoh", "off"]) == 2
    assert words in capsys.readouterr().err
