"""Raw ranges in dataflash logs, against the same ranges in a real receiver's own log."""

import contextlib
from pathlib import Path
from struct import pack, pack_into, unpack_from

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.recordings.gnss.dataflash_ranges import read_dataflash_ranges
from analysis.recordings.gnss.rinex_observations import read_observations
from analysis.recordings.gnss.ubx_log import read_ubx
from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from tests.analysis.recordings.flight_logs.dataflash_encoding import raw_log
from tests.analysis.recordings.gnss.ubx_encoding import rawx

UBX = Path(__file__).parents[3] / "data" / "gnss_qzss" / "f9p.ubx"
ANTENNA = "-3962108.6836,3381309.5672,3668678.6720"  # of the data's README
RAWX = b"\xb5b\x02\x15"


def payloads() -> list[bytes]:
    """The RAWX messages of an F9P in Japan: L1 and L2 of each satellite."""
    data, found = UBX.read_bytes(), []
    at = data.find(RAWX)
    while at >= 0:
        (length,) = unpack_from("<H", data, at + 4)
        found.append(data[at + 6 : at + 6 + length])
        at = data.find(RAWX, at + length)
    return found


def written(path: Path, log: bytes) -> Path:
    """A log in a file."""
    path.write_bytes(log)
    return path


def test_ranges_are_those_of_the_receiver_s_own_log_though_no_signal_is_named(tmp_path: Path):
    sent = payloads()
    found = read_dataflash_ranges(written(tmp_path / "flight.bin", raw_log(sent)))
    expected = read_ubx(UBX)[0]
    assert len(found) == len(expected) == len(sent)
    # Both frequencies of a satellite are in the log.
    assert len(sent[0]) > 16 + 32 * 1.2 * len(found[0].satellites)
    for one, same in zip(found, expected, strict=True):
        assert one.t_us == same.t_us
        assert one.satellites == same.satellites
        assert one.signals == same.signals
        for name in ("pseudorange_m", "doppler_mps", "cn0_dbhz", "carrier_hz"):
            assert getattr(one, name).tolist() == getattr(same, name).tolist()


def test_a_log_gives_positions_with_a_navigation_file_beside_it(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    data, sent = shared_data / "gnss_static", []
    for epoch in read_observations(data / "SEPT078M.21O")[:20]:
        known = [i for i, name in enumerate(epoch.satellites) if name[0] in "GEJ"]
        payload = bytearray(rawx(epoch.select(known))[6:-2])
        for at in range(16, len(payload), 32):  # a phase near the range, as u-blox begins it
            (range_m,) = unpack_from("<d", payload, at)
            pack_into("<d", payload, at + 8, range_m * L1_HZ / SPEED_OF_LIGHT_MPS)
        sent.append(bytes(payload))
    path = written(tmp_path / "flight.BIN", raw_log(sent))
    given = ["monitor", "--zenoh", "off", "--rinex", str(path)]
    assert main([*given, str(data / "SEPT078M.21P"), f"--truth={ANTENNA}"]) == 0
    assert "epochs          20, untestable 0, alarms 0" in capsys.readouterr().out
    assert main(given) == 2
    assert "flight.BIN: no readable ephemeris; give a navigation file" in (capsys.readouterr().err)


def test_of_two_receivers_in_a_log_the_first_is_read(tmp_path: Path):
    first = payloads()
    later = [pack("<d", unpack_from("<d", each)[0] + 3e-4) + each[8:] for each in first]
    both = [each for pair in zip(first, later, strict=True) for each in pair]
    found = read_dataflash_ranges(written(tmp_path / "two.bin", raw_log(both)))
    assert [epoch.t_us for epoch in found] == [epoch.t_us for epoch in read_ubx(UBX)[0]]


def test_a_range_without_a_phase_is_skipped(tmp_path: Path):
    message = bytearray(payloads()[0])
    whole = read_dataflash_ranges(written(tmp_path / "a.bin", raw_log([bytes(message)])))[0]
    phase = 16 + 32 + 8  # of the second range, G03's
    message[phase : phase + 8] = bytes(8)
    fewer = read_dataflash_ranges(written(tmp_path / "b.bin", raw_log([bytes(message)])))[0]
    assert set(whole.satellites) - set(fewer.satellites) == {"G03"}


def test_a_log_without_raw_ranges_says_how_to_get_them(tmp_path: Path, capsys):
    # A head without the ranges that it announces: GRXS was never written.
    head = bytearray(payloads()[0][:16])
    head[11] = 0
    path = written(tmp_path / "flight.bin", raw_log([bytes(head)]))
    assert main(["monitor", "--rinex", str(path), "--zenoh", "off"]) == 2
    assert "has no GRXS with prMes, cpMes" in capsys.readouterr().err


@given(data=st.data())
@settings(deadline=None)
def test_a_corrupted_log_raises_only_config_errors(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
):
    whole = bytearray(raw_log(payloads()[:2]))
    # Most corruption is put into the definitions of the messages.
    places = st.one_of(st.integers(0, 3 * 89), st.integers(0, len(whole) - 1))
    for at in data.draw(st.lists(places, max_size=8)):
        whole[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([len(whole), len(whole) // 2, 300]))
    path = written(tmp_path_factory.mktemp("bin") / "flight.bin", bytes(whole[:cut]))
    with contextlib.suppress(ConfigError):
        assert len(read_dataflash_ranges(path)) <= 2
