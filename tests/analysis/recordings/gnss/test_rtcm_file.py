"""A recording as RTCM 3 gives the epochs of its RINEX file, to the resolution of the messages."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from analysis.recordings.read_recordings import read_rinex
from analysis.samples.sample import EphemerisSample, Epoch
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rtcm.ephemeris_messages import encode_ephemeris
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import wrap_message

EPOCHS = 20


@pytest.fixture(scope="module")
def both(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[Epoch], list[EphemerisSample]]:
    """A file of RTCM 3 with the first epochs of the roof antenna, and what it was made of."""
    folder = shared_data / "gnss_static"
    block = read_rinex(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    samples = list(block.samples())
    orbits = [
        s for s in samples if isinstance(s, EphemerisSample) and s.ephemeris.satellite[0] in "GE"
    ]
    epochs = [s for s in samples if isinstance(s, Epoch)][:EPOCHS]
    messages = [
        message
        for epoch in epochs
        for message in encode_epoch(
            epoch.tow_s,
            epoch.satellites,
            epoch.pseudorange_m.tolist(),
            epoch.doppler_mps.tolist(),
            epoch.cn0_dbhz.tolist(),
        )
    ]
    # Ephemerides come late, and other messages and noise between.
    messages[9:9] = [wrap_message(b"\x3e\xd0" + bytes(17)), b"noise"]
    messages += [encode_ephemeris(sample.ephemeris) for sample in orbits]
    path = tmp_path_factory.mktemp("rtcm") / "roof.rtcm3"
    path.write_bytes(b"".join(messages))
    return path, epochs, orbits


def test_the_epochs_are_those_of_the_rinex_file(
    both: tuple[Path, list[Epoch], list[EphemerisSample]],
) -> None:
    path, epochs, orbits = both
    samples = list(read_rinex(path, []).samples())
    read = [sample for sample in samples if isinstance(sample, Epoch)]
    assert [epoch.t_us for epoch in read] == [epoch.t_us for epoch in epochs]
    for found, given in zip(read, epochs, strict=True):
        known = dict(zip(given.satellites, given.pseudorange_m.tolist(), strict=True))
        assert set(found.satellites) == {name for name in known if name[0] in "GE"}
        wanted = [known[name] for name in found.satellites]
        assert found.pseudorange_m == pytest.approx(np.array(wanted), abs=1e-3)
    sent = {(s.ephemeris.satellite, s.ephemeris.week, s.ephemeris.toe_s) for s in orbits}
    ephemerides = [s.ephemeris for s in samples if isinstance(s, EphemerisSample)]
    assert {(e.satellite, e.week, e.toe_s) for e in ephemerides} == sent


@pytest.mark.skipif(shutil.which("convbin") is None, reason="RTKLIB's convbin is not installed")
def test_rtklib_reads_the_same_file(
    both: tuple[Path, list[Epoch], list[EphemerisSample]], tmp_path: Path
) -> None:
    path, epochs, _ = both
    obs, nav = tmp_path / "roof.obs", tmp_path / "roof.nav"
    subprocess.run(
        ["convbin", "-r", "rtcm3", "-tr", "2021/03/19", "12:00:00", "-od", "-os", "-v", "3.03",
         "-o", str(obs), "-n", str(nav), str(path)],
        check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    theirs = [s for s in read_rinex(obs, nav).samples() if isinstance(s, Epoch)]
    ours = {s.t_us: s for s in read_rinex(path, []).samples() if isinstance(s, Epoch)}
    assert len(theirs) == len(ours) == len(epochs)
    for other in theirs:
        one = ours[other.t_us]
        ranges = dict(zip(other.satellites, other.pseudorange_m.tolist(), strict=True))
        wanted = [ranges[name] for name in one.satellites]
        assert one.pseudorange_m == pytest.approx(np.array(wanted), abs=2e-3)


def test_a_file_without_msm7_names_the_way_out(tmp_path: Path) -> None:
    path = tmp_path / "old.rtcm3"
    path.write_bytes(wrap_message(b"\x3e\xd0" + bytes(17)))
    with pytest.raises(ConfigError, match="convbin"):
        read_rinex(path, [])
