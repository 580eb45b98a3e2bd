"""Comparison of ephemeris messages with pyrtcm and RTKLIB's convbin.

The two records are real ones: cssrlib-data, SEPT078M.21P, 2021-03-19, G03 and E08.
"""

import re
import shutil
import subprocess
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from pyrtcm import RTCMReader

from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris, decode_ephemeris, encode_ephemeris
from mavproxy_fault.rtcm.transport import message_number, wrap_message

G03 = Ephemeris(
    satellite="G03", week=2149, toe_s=475200.0, toc_s=475200.0,
    af0_s=-0.112356152385e-03, af1=-0.105728759081e-10, af2_per_s=0.0, iode=37, iodc=37,
    sqrt_a=0.515363021851e04, eccentricity=0.332982675172e-02, i0_rad=0.968334075252,
    omega0_rad=-0.114852075735e01, omega_rad=0.830273530968, m0_rad=0.634492237240,
    delta_n_rps=0.456911889357e-08, omega_dot_rps=-0.808605110220e-08, idot_rps=0.331442377334e-09,
    crs_m=-2.65625, crc_m=251.34375, cus_rad=0.693649053574e-05, cuc_rad=-0.396743416786e-06,
    cis_rad=0.521540641785e-07, cic_rad=-0.316649675369e-07, group_delay_s=0.186264514923e-08,
    codes=(1, 0),
)  # fmt: skip
E08 = Ephemeris(
    satellite="E08", week=2149, toe_s=470400.0, toc_s=470400.0,
    af0_s=0.603088719072e-02, af1=-0.568434188608e-11, af2_per_s=0.0, iode=16, iodc=16,
    sqrt_a=0.544061199188e04, eccentricity=0.229118275456e-03, i0_rad=0.960931523981,
    omega0_rad=-0.311318009565, omega_rad=-0.457069705211, m0_rad=0.101772513154,
    delta_n_rps=0.351907515503e-08, omega_dot_rps=-0.565666419420e-08, idot_rps=-0.134648465792e-09,
    crs_m=-38.5, crc_m=200.3125, cus_rad=0.670552253723e-05, cuc_rad=-0.172480940819e-05,
    cis_rad=-0.186264514923e-08, cic_rad=-0.745058059692e-08, group_delay_s=-0.442378222942e-08,
    group_delay_e5a_s=-0.395812094212e-08, accuracy=107,
)  # fmt: skip

# data field of the standard -> our field, with the factor from its unit to ours
PI = 3.1415926535898
PYRTCM = {
    "G": [("DF079", "idot_rps", PI), ("DF071", "iode", 1), ("DF081", "toc_s", 1),
          ("DF083", "af1", 1), ("DF084", "af0_s", 1), ("DF085", "iodc", 1), ("DF086", "crs_m", 1),
          ("DF087", "delta_n_rps", PI), ("DF088", "m0_rad", PI), ("DF089", "cuc_rad", 1),
          ("DF090", "eccentricity", 1), ("DF091", "cus_rad", 1), ("DF092", "sqrt_a", 1),
          ("DF093", "toe_s", 1), ("DF094", "cic_rad", 1), ("DF095", "omega0_rad", PI),
          ("DF096", "cis_rad", 1), ("DF097", "i0_rad", PI), ("DF098", "crc_m", 1),
          ("DF099", "omega_rad", PI), ("DF100", "omega_dot_rps", PI), ("DF101", "group_delay_s", 1),
          ("DF102", "health", 1)],
    "E": [("DF290", "iode", 1), ("DF286", "accuracy", 1), ("DF292", "idot_rps", PI),
          ("DF293", "toc_s", 1), ("DF295", "af1", 1), ("DF296", "af0_s", 1), ("DF297", "crs_m", 1),
          ("DF298", "delta_n_rps", PI), ("DF299", "m0_rad", PI), ("DF300", "cuc_rad", 1),
          ("DF301", "eccentricity", 1), ("DF302", "cus_rad", 1), ("DF303", "sqrt_a", 1),
          ("DF304", "toe_s", 1), ("DF305", "cic_rad", 1), ("DF306", "omega0_rad", PI),
          ("DF307", "cis_rad", 1), ("DF308", "i0_rad", PI), ("DF309", "crc_m", 1),
          ("DF310", "omega_rad", PI), ("DF311", "omega_dot_rps", PI),
          ("DF312", "group_delay_e5a_s", 1), ("DF313", "group_delay_s", 1)],
}  # fmt: skip


@pytest.mark.parametrize("sent", [G03, E08], ids=lambda e: e.satellite)
def test_an_ephemeris_survives_encoding_and_decoding(sent: Ephemeris) -> None:
    got = asdict(decode_ephemeris(encode_ephemeris(sent)))
    numbers = asdict(sent)
    assert got.pop("satellite") == numbers.pop("satellite")
    for name, value in numbers.items():
        assert got[name] == pytest.approx(value, rel=3e-11, abs=0), name  # 12 digits in the file


@pytest.mark.parametrize("sent", [G03, E08], ids=lambda e: e.satellite)
def test_a_decoded_ephemeris_encodes_to_the_same_bytes(sent: Ephemeris) -> None:
    message = encode_ephemeris(sent)
    assert encode_ephemeris(decode_ephemeris(message)) == message


@pytest.mark.parametrize("sent", [G03, E08], ids=lambda e: e.satellite)
def test_pyrtcm_reads_the_same_fields(sent: Ephemeris) -> None:
    read = RTCMReader.parse(encode_ephemeris(sent))
    for key, name, factor in PYRTCM[sent.satellite[0]]:
        value = getattr(sent, name)
        assert getattr(read, key) * factor == pytest.approx(value, rel=1e-6, abs=1e-20), name
    week = read.DF076 + 2048 if sent.satellite[0] == "G" else read.DF289 + 1024
    assert week == sent.week


def test_an_angle_beyond_half_a_turn_wraps() -> None:
    turned = decode_ephemeris(encode_ephemeris(replace(G03, omega0_rad=G03.omega0_rad - PI)))
    assert turned.omega0_rad == pytest.approx(G03.omega0_rad + PI, abs=1e-9)


def test_health_flags_and_the_long_fit_are_encoded() -> None:
    assert decode_ephemeris(encode_ephemeris(replace(E08, health=0b010110))).health == 0b010110
    sick = decode_ephemeris(encode_ephemeris(replace(G03, health=63, long_fit=True)))
    assert (sick.health, sick.long_fit, sick.fit_half_s) == (63, True, 10_800.0)


def test_the_gps_week_counts_from_the_given_rollover() -> None:
    assert decode_ephemeris(encode_ephemeris(G03), rollover_week=1024).week == 2149 - 1024


def test_values_out_of_range_and_other_messages_are_refused() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        encode_ephemeris(replace(G03, af0_s=1.0))
    with pytest.raises(KeyError):
        encode_ephemeris(replace(G03, satellite="R03"))
    with pytest.raises(ValueError, match="RTCM 1020"):
        decode_ephemeris(wrap_message((1020 << 4).to_bytes(2, "big") + bytes(60)))
    with pytest.raises(ValueError, match="inside a field"):
        decode_ephemeris(wrap_message((1019 << 4).to_bytes(2, "big") + bytes(20)))


def test_the_messages_have_the_numbers_and_lengths_of_the_standard() -> None:
    for ephemeris, number, bits in ((G03, 1019, 488), (E08, 1046, 504)):
        message = encode_ephemeris(ephemeris)
        assert message_number(message) == number
        assert len(message) == 6 + bits // 8


@pytest.mark.skipif(shutil.which("convbin") is None, reason="RTKLIB's convbin is not installed")
def test_convbin_reproduces_the_navigation_record(tmp_path: Path) -> None:
    (tmp_path / "raw.rtcm3").write_bytes(encode_ephemeris(G03) + encode_ephemeris(E08))
    subprocess.run(
        ["convbin", "-r", "rtcm3", "-tr", "2021/03/19", "12:00:00", "-v", "3.03",
         "-n", str(tmp_path / "out.nav"), "raw.rtcm3"],
        check=True, capture_output=True, timeout=60, cwd=tmp_path,
    )  # fmt: skip
    body = re.split(r"END OF HEADER *\n", (tmp_path / "out.nav").read_text())[1]
    records = {r[:3]: r for r in re.split(r"\n(?=[GE])", body)}
    for sent in (G03, E08):
        record = records[sent.satellite]
        numbers = [float(x.replace("D", "E")) for x in re.findall(r"-?\d*\.\d+[DE][+-]\d+", record)]
        expected = [
            sent.af0_s, sent.af1, sent.af2_per_s,
            sent.iode, sent.crs_m, sent.delta_n_rps, sent.m0_rad,
            sent.cuc_rad, sent.eccentricity, sent.cus_rad, sent.sqrt_a,
            sent.toe_s, sent.cic_rad, sent.omega0_rad, sent.cis_rad,
            sent.i0_rad, sent.crc_m, sent.omega_rad, sent.omega_dot_rps,
            sent.idot_rps,
        ]  # fmt: skip
        assert numbers[:20] == pytest.approx(expected, rel=1e-10)
