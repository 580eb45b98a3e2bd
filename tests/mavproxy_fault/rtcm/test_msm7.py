"""Comparison of MSM7 with pyrtcm and RTKLIB's convbin, and the effect of a patch."""

import math
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyrtcm import RTCMReader

from mavproxy_fault.rtcm.msm7 import (
    MS_M,
    Msm7,
    decode_msm7,
    encode_epoch,
    encode_msm7,
    msm7_satellites,
    patch_msm7,
)
from mavproxy_fault.rtcm.transport import wrap_message

COUNT_M = MS_M * 2**-29
PHASE_COUNT_M = MS_M * 2**-31
NAN = math.nan
L1_M = 299792458.0 / 1575.42e6


def epoch(system: str = "G", tow_s: float = 475200.2, shift_m: float = 0.0) -> Msm7:
    ranges = (20_208_901.317, 22_280_835.459 + shift_m, 24_343_063.482, 25_653_954.884)
    return Msm7(
        system,
        tow_s,
        tuple(f"{system}{prn:02d}" for prn in (3, 12, 17, 30)),
        ranges,
        tuple(r + 3.25 for r in ranges),
        (-512.3456, 0.25, 799.99995, 100.5),
        (49.0625, 42.5, 38.875, 30.0),
        (0.031, 1.2, 100.0, 4.0),
    )


def test_encoding_and_decoding_round_only_to_the_fields_resolution() -> None:
    sent = epoch()
    got = decode_msm7(encode_msm7(sent))
    assert got.satellites == sent.satellites
    assert got.tow_s == sent.tow_s
    assert got.pseudorange_m == pytest.approx(sent.pseudorange_m, abs=COUNT_M / 2)
    assert got.phase_m == pytest.approx(sent.phase_m, abs=PHASE_COUNT_M / 2)
    assert got.doppler_mps == pytest.approx(sent.doppler_mps, abs=0.5e-4)
    assert got.cn0_dbhz == sent.cn0_dbhz
    assert all(0.5 * s <= g <= s for g, s in zip(got.lock_s, sent.lock_s, strict=True))


@pytest.mark.parametrize(("system", "number"), [("G", 1077), ("E", 1097)])
def test_pyrtcm_reads_the_same_values(system: str, number: int) -> None:
    sent = epoch(system)
    read = RTCMReader.parse(encode_msm7(sent))
    assert number == read.DF002
    assert (read.DF004 if system == "G" else read.DF248) == 475_200_200
    for i, name in enumerate(sent.satellites, 1):

        def field(key: str, i: int = i) -> float:
            return float(getattr(read, f"{key}_{i:02d}"))

        assert getattr(read, f"CELLPRN_{i:02d}") == name[1:].rjust(3, "0")
        assert getattr(read, f"CELLSIG_{i:02d}") == "1C"
        rough_ms = field("DF397") + field("DF398")
        assert (rough_ms + field("DF405")) * MS_M == pytest.approx(
            sent.pseudorange_m[i - 1], abs=COUNT_M
        )
        assert (rough_ms + field("DF406")) * MS_M == pytest.approx(
            sent.phase_m[i - 1], abs=PHASE_COUNT_M
        )
        assert field("DF399") + field("DF404") == pytest.approx(sent.doppler_mps[i - 1], abs=1e-4)
        assert field("DF408") == sent.cn0_dbhz[i - 1]


def test_values_not_given_are_marked_invalid() -> None:
    sent = Msm7(
        "G", 1.0, ("G01", "G02"), (2.2e7, NAN), (NAN, NAN), (NAN, NAN), (NAN, 40.0), (NAN,) * 2
    )
    got = decode_msm7(encode_msm7(sent))
    assert got.satellites == ("G01",)
    assert all(math.isnan(v[0]) for v in (got.phase_m, got.doppler_mps, got.cn0_dbhz))


def test_the_last_message_of_an_epoch_announces_no_more() -> None:
    messages = encode_epoch(
        5.0, ("E05", "G12", "E01"), (2.5e7, 2.1e7, 2.4e7), (1, 2, 3), (40, 41, 42)
    )
    read = [decode_msm7(m) for m in messages]
    assert [(r.system, r.satellites, r.more) for r in read] == [
        ("G", ("G12",), True),
        ("E", ("E01", "E05"), False),
    ]
    assert read[1].doppler_mps == (3.0, 1.0)
    assert encode_epoch(5.0, (), (), (), ()) == []


def test_another_message_is_refused() -> None:
    with pytest.raises(ValueError, match="RTCM 1074"):
        decode_msm7(wrap_message((1074 << 4).to_bytes(2, "big") + bytes(30)))
    with pytest.raises(ValueError, match="inside a field"):
        decode_msm7(wrap_message((1077 << 4).to_bytes(2, "big") + b"\xff" * 30))


def changed(change_m: float) -> tuple[Msm7, Msm7]:
    message = encode_msm7(epoch())
    return decode_msm7(message), decode_msm7(patch_msm7(message, {"G12": change_m}))


@given(st.floats(-900.0, 900.0))
def test_a_patch_changes_one_pseudorange_and_nothing_else(change_m: float) -> None:
    before, after = changed(change_m)
    assert after.pseudorange_m[1] - before.pseudorange_m[1] == pytest.approx(change_m, abs=COUNT_M)
    for name in ("phase_m", "doppler_mps", "cn0_dbhz", "lock_s", "satellites", "tow_s"):
        assert getattr(after, name) == getattr(before, name)
    for i in (0, 2, 3):
        assert after.pseudorange_m[i] == before.pseudorange_m[i]


@pytest.mark.parametrize("change_m", [-50_000.0, -5000.0, 5000.0, 1e6])
def test_a_change_too_large_for_the_phase_field_marks_the_phase_invalid(change_m: float) -> None:
    before, after = changed(change_m)
    assert after.pseudorange_m[1] - before.pseudorange_m[1] == pytest.approx(change_m, abs=COUNT_M)
    assert math.isnan(after.phase_m[1])
    assert after.phase_m[0] == before.phase_m[0]


def test_a_negative_range_is_invalid() -> None:
    _, after = changed(-3e7)
    assert after.satellites == ("G03", "G17", "G30")


def test_a_patch_without_changes_gives_the_same_bytes() -> None:
    message = encode_msm7(epoch())
    assert patch_msm7(message, {"G12": 0.0, "G05": 7.0, "E03": 3.0}, lost=["E12"]) is message


def test_a_lost_satellite_does_not_change_the_others() -> None:
    message = encode_msm7(epoch())
    after = decode_msm7(patch_msm7(message, {}, lost=("G12", "G30")))
    assert after.satellites == ("G03", "G17")
    assert after.pseudorange_m == decode_msm7(message).pseudorange_m[::2]
    assert msm7_satellites(message) == ("G03", "G12", "G17", "G30")


def test_all_satellites_lost_leaves_an_empty_epoch() -> None:
    message = encode_msm7(epoch())
    empty = patch_msm7(message, {}, lost=msm7_satellites(message))
    assert decode_msm7(empty).satellites == ()
    assert RTCMReader.parse(empty).NSat == 0


@pytest.mark.skipif(shutil.which("convbin") is None, reason="RTKLIB's convbin is not installed")
def test_convbin_makes_the_same_rinex(tmp_path: Path) -> None:
    epochs = [
        (epoch("G", 475200.0 + i, 60.0 * i), epoch("E", 475200.0 + i, 60.0 * i)) for i in range(4)
    ]
    raw = tmp_path / "raw.rtcm3"
    raw.write_bytes(
        b"".join(
            encode_epoch(
                g.tow_s,
                g.satellites + e.satellites,
                g.pseudorange_m + e.pseudorange_m,
                g.doppler_mps + e.doppler_mps,
                g.cn0_dbhz + e.cn0_dbhz,
            )[k]
            for g, e in epochs
            for k in (0, 1)
        )
    )
    subprocess.run(
        ["convbin", "-r", "rtcm3", "-tr", "2021/03/19", "12:00:00", "-od", "-os", "-v", "3.03",
         "-o", str(tmp_path / "out.obs"), str(raw)],
        check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    rows = rinex_rows(tmp_path / "out.obs")
    assert len(rows) == 4
    for (g, e), found in zip(epochs, rows, strict=True):
        sent = dict(zip(g.satellites + e.satellites, zip(
            g.pseudorange_m + e.pseudorange_m, g.doppler_mps * 2, g.cn0_dbhz * 2, strict=True,
        ), strict=True))  # fmt: skip
        assert found.keys() == sent.keys()
        for name, (range_m, rate, cn0) in sent.items():
            assert found[name]["C1C"] == pytest.approx(range_m, abs=0.002)  # RINEX: millimetres
            assert found[name]["D1C"] == pytest.approx(-rate / L1_M, abs=0.002)
            assert found[name]["S1C"] == pytest.approx(cn0, abs=0.13)  # RTKLIB rounds to quarters


def rinex_rows(path: Path) -> list[dict[str, dict[str, float]]]:
    """Satellite -> observable -> value for each epoch of a RINEX 3 file."""
    kinds: dict[str, list[str]] = {}
    epochs: list[dict[str, dict[str, float]]] = []
    head, body = re.split(r"END OF HEADER *\n", path.read_text())
    for line in head.splitlines():
        if line[60:].startswith("SYS / # / OBS TYPES"):
            kinds[line[0]] = line[6:60].split()
    for line in body.splitlines():
        if line[0] == ">":
            epochs.append({})
            continue
        texts = [line[3 + 16 * i : 17 + 16 * i].strip() for i in range(len(kinds[line[0]]))]
        epochs[-1][line[:3]] = {
            kind: float(text) for kind, text in zip(kinds[line[0]], texts, strict=True) if text
        }
    return epochs
