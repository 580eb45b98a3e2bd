"""Comparison of MSM7 with pyrtcm and RTKLIB's convbin, and the effect of a patch."""

import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyrtcm import RTCMReader

from mavproxy_fault.rtcm.msm7 import MS_M, decode_msm7, encode_epoch, msm7_satellites, patch_msm7
from mavproxy_fault.rtcm.transport import unwrap_message, wrap_message

COUNT_M = MS_M * 2**-29
PHASE_COUNT_M = MS_M * 2**-31
NAN = math.nan
L1_M = 299792458.0 / 1575.42e6
PRNS = (3, 12, 17, 30)
RANGES = (20_208_901.317, 22_280_835.459, 24_343_063.482, 25_653_954.884)
RATES = (-512.3456, 0.25, 799.99995, 100.5)
STRENGTHS = (49.0625, 42.5, 38.875, 30.0)


def names(system: str) -> tuple[str, ...]:
    return tuple(f"{system}{prn:02d}" for prn in PRNS)


def one_message(system: str = "G", ranges: tuple[float, ...] = RANGES) -> bytes:
    (message,) = encode_epoch(475200.2, names(system), ranges, RATES, STRENGTHS)
    return message


@st.composite
def messages(draw: Any) -> bytes:
    """Generate any satellites with any signals and random fields, phases among them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    number = draw(st.sampled_from((1077, 1097)))
    satellites = sum(1 << (64 - n) for n in draw(st.sets(st.integers(1, 36), max_size=12)))
    # Signals that pyrtcm knows.
    signals = sum(1 << (32 - n) for n in draw(st.sets(st.sampled_from((2, 3, 4)), max_size=3)))
    count, cells = satellites.bit_count(), satellites.bit_count() * signals.bit_count()
    mask = int.from_bytes(rng.bytes(8), "big") & ((1 << cells) - 1)
    parts = [
        (number, 12), (0, 12), (draw(st.integers(0, 604_799_999)), 30), (draw(st.booleans()), 1),
        (0, 18), (satellites, 64), (signals, 32), (mask, cells),
    ]  # fmt: skip
    width = 36 * count + 80 * mask.bit_count()
    noise = int.from_bytes(rng.bytes((width + 7) // 8), "big") & ((1 << width) - 1)
    bits = ""
    for value, length in (*parts, (noise, width)):
        bits += f"{int(value):0{length}b}" if length else ""
    bits += "0" * (-len(bits) % 8)
    return wrap_message(int(bits, 2).to_bytes(len(bits) // 8, "big"))


def cells_of(message: bytes) -> dict[tuple[str, str], dict[str, float]]:
    """Satellite and signal to the fields in pyrtcm's reading; a rough range without a value is
    NaN."""
    read = RTCMReader.parse(message)
    found = {}
    for i in range(1, read.NCell + 1):
        key = getattr(read, f"CELLPRN_{i:02d}"), getattr(read, f"CELLSIG_{i:02d}")
        prns = [getattr(read, f"PRN_{k:02d}") for k in range(1, read.NSat + 1)]
        own = prns.index(key[0]) + 1
        ms, rough = getattr(read, f"DF397_{own:02d}"), getattr(read, f"DF398_{own:02d}")
        found[key] = {
            "rough_ms": NAN if ms == 255 else ms + rough,
            "rate": getattr(read, f"DF399_{own:02d}"),
            **{kind: getattr(read, f"{kind}_{i:02d}") for kind in CELL_FIELDS},
        }
    return found


CELL_FIELDS = ("DF404", "DF405", "DF406", "DF407", "DF408", "DF420")


def test_encoding_and_decoding_round_only_to_the_fields_resolution() -> None:
    got = decode_msm7(one_message())
    assert got.satellites == names("G")
    assert got.tow_s == 475200.2
    assert got.pseudorange_m == pytest.approx(RANGES, abs=COUNT_M / 2)
    assert got.doppler_mps == pytest.approx(RATES, abs=0.5e-4)
    assert got.cn0_dbhz == STRENGTHS


@pytest.mark.parametrize(("system", "number"), [("G", 1077), ("E", 1097)])
def test_pyrtcm_reads_the_same_values(system: str, number: int) -> None:
    message = one_message(system)
    read = RTCMReader.parse(message)
    assert number == read.DF002
    assert (read.DF004 if system == "G" else read.DF248) == 475_200_200
    found = cells_of(message)
    assert [*found] == [(f"{prn:03d}", "1C") for prn in PRNS]
    for i, cell in enumerate(found.values()):
        assert (cell["rough_ms"] + cell["DF405"]) * MS_M == pytest.approx(RANGES[i], abs=COUNT_M)
        assert cell["rate"] + cell["DF404"] == pytest.approx(RATES[i], abs=1e-4)
        assert cell["DF408"] == STRENGTHS[i]


def test_values_not_given_are_marked_invalid() -> None:
    (message,) = encode_epoch(1.0, ("G01", "G02"), (2.2e7, NAN), (NAN, NAN), (NAN, 40.0))
    got = decode_msm7(message)
    assert got.satellites == ("G01",)
    assert math.isnan(got.doppler_mps[0])
    assert math.isnan(got.cn0_dbhz[0])


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


@given(messages(), st.data())
def test_a_truncated_message_is_refused(message: bytes, data: Any) -> None:
    body = unwrap_message(message)
    short = wrap_message(body[: data.draw(st.integers(2, len(body) - 1))])
    with pytest.raises(ValueError, match="inside a field"):
        decode_msm7(short)


@given(messages())
def test_the_first_signal_with_a_range_is_read(message: bytes) -> None:
    wanted = {}
    for (prn, _), cell in cells_of(message).items():
        range_ms = cell["rough_ms"] + cell["DF405"]
        if not math.isnan(range_ms) and cell["DF405"] != -(2**-10):
            wanted.setdefault(prn, (range_ms * MS_M, cell["DF408"]))
    got = decode_msm7(message)
    assert [f"{int(name[1:]):03d}" for name in got.satellites] == [*wanted]
    assert got.pseudorange_m == pytest.approx([r for r, _ in wanted.values()], abs=COUNT_M)
    assert [0.0 if math.isnan(c) else c for c in got.cn0_dbhz] == [c for _, c in wanted.values()]


@given(messages(), st.floats(-900.0, 900.0), st.integers(0, 11))
def test_a_patch_changes_the_ranges_of_one_satellite_and_nothing_else(
    message: bytes, change_m: float, which: int
) -> None:
    present = msm7_satellites(message)
    if not present:
        return
    name = present[which % len(present)]
    before, after = cells_of(message), cells_of(patch_msm7(message, {name: change_m}))
    assert after.keys() == before.keys()
    for key, cell in before.items():
        if int(key[0]) != int(name[1:]) or math.isnan(cell["rough_ms"]):
            assert after[key] == cell or math.isnan(cell["rough_ms"])
            continue
        for field in ("rate", "DF404", "DF407", "DF408", "DF420"):
            assert after[key][field] == cell[field]
        # Where both are valid: the range changed, the phase did not.
        if cell["DF405"] != -(2**-10) != after[key]["DF405"]:
            moved_ms = sum(after[key][k] - cell[k] for k in ("rough_ms", "DF405"))
            assert moved_ms * MS_M == pytest.approx(change_m, abs=COUNT_M)
        if cell["DF406"] != -(2**-8) != after[key]["DF406"]:
            moved_ms = sum(after[key][k] - cell[k] for k in ("rough_ms", "DF406"))
            assert moved_ms * MS_M == pytest.approx(0.0, abs=PHASE_COUNT_M)


@pytest.mark.parametrize("change_m", [-50_000.0, -5000.0, -900.0, 0.5, 5000.0, 1e6])
def test_a_change_of_any_size_is_exact(change_m: float) -> None:
    message = one_message()
    before, after = decode_msm7(message), decode_msm7(patch_msm7(message, {"G12": change_m}))
    assert after.pseudorange_m[1] - before.pseudorange_m[1] == pytest.approx(change_m, abs=COUNT_M)
    assert after.pseudorange_m[::2] == before.pseudorange_m[::2]


def test_a_negative_range_is_invalid() -> None:
    after = decode_msm7(patch_msm7(one_message(), {"G12": -3e7}))
    assert after.satellites == ("G03", "G17", "G30")


def test_a_patch_without_changes_gives_the_same_bytes() -> None:
    message = one_message()
    assert patch_msm7(message, {"G12": 0.0, "G05": 7.0, "E03": 3.0}, lost=["E12"]) is message


def test_a_lost_satellite_does_not_change_the_others() -> None:
    message = one_message()
    after = decode_msm7(patch_msm7(message, {}, lost=("G12", "G30")))
    assert after.satellites == ("G03", "G17")
    assert after.pseudorange_m == decode_msm7(message).pseudorange_m[::2]
    assert msm7_satellites(message) == ("G03", "G12", "G17", "G30")


def test_all_satellites_lost_leaves_an_empty_epoch() -> None:
    message = one_message()
    empty = patch_msm7(message, {}, lost=msm7_satellites(message))
    assert decode_msm7(empty).satellites == ()
    assert RTCMReader.parse(empty).NSat == 0


@pytest.mark.skipif(shutil.which("convbin") is None, reason="RTKLIB's convbin is not installed")
def test_convbin_makes_the_same_rinex(tmp_path: Path) -> None:
    both = names("G") + names("E")
    epochs = [(475200.0 + i, 2 * (RANGES[0], RANGES[1] + 60.0 * i, *RANGES[2:])) for i in range(4)]
    raw = tmp_path / "raw.rtcm3"
    raw.write_bytes(
        b"".join(
            message
            for tow_s, ranges in epochs
            for message in encode_epoch(tow_s, both, ranges, 2 * RATES, 2 * STRENGTHS)
        )
    )
    subprocess.run(
        ["convbin", "-r", "rtcm3", "-tr", "2021/03/19", "12:00:00", "-od", "-os", "-v", "3.03",
         "-o", str(tmp_path / "out.obs"), str(raw)],
        check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    rows = rinex_rows(tmp_path / "out.obs")
    assert len(rows) == 4
    for (_, ranges), found in zip(epochs, rows, strict=True):
        values = zip(ranges, 2 * RATES, 2 * STRENGTHS, strict=True)
        sent = dict(zip(both, values, strict=True))
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
