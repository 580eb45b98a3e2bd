"""Draw docs/gnss_presets.png: what the presets of spoofers and jammers make of the demo's receiver.

    python docs/draw_spoofs.py

Each is flown with the same seed as a flight without a fault, and what is drawn is the difference:
of the receiver's position, and of every satellite's pseudorange, Doppler rate and C/N0. A satellite
that was lost has no line.
"""

from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from matplotlib.figure import Figure

from analysis.run.proxied_flight import ProxiedFlight
from analysis.samples.decoder import Decoder
from analysis.samples.sample import Epoch, GpsFix
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.parser import Parser
from simvehicle.scenario.scenario_file import read_scenario

PICTURE = Path(__file__).parent / "gnss_presets.png"
PRESETS = (
    "gnss-carry-off",
    "gnss-carry-off-gps",
    "gnss-spoof-jump",
    "gnss-meaconing",
    "gnss-time-spoof",
    "gps-jamming",
    "gnss-jamming-growing",
    "gps-spoof",
)
AT_S, FLOWN_S = 10.0, 60.0
COLUMNS = ("position, m", "pseudoranges, m", "Doppler rates, m/s", "C/N0, dB")
COLOURS = {"G": "tab:blue", "E": "tab:orange"}


class Heard(NamedTuple):
    """Of a flight: the fixes and the epochs, by their stamps."""

    fixes: dict[int, GpsFix]
    epochs: dict[int, Epoch]


def flown(preset: str) -> Heard:
    """What the receiver of the demo says in a flight with a preset, or without one."""
    scenario = read_scenario(None)
    imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=50.0)
    sensors = msgspec.structs.replace(scenario.sensors, imu=imu)
    scenario = msgspec.structs.replace(scenario, sensors=sensors, duration_s=FLOWN_S)
    entry = {"preset": preset, "id": "it", "at_s": AT_S}
    schedule = parse_schedule({"seed": 1, "faults": [entry]}) if preset else Schedule()
    flight, parser, decoder = ProxiedFlight(scenario, schedule), Parser(), Decoder()
    heard = Heard({}, {})
    while not flight.over:
        frames = parser.push(flight.advance([]).monitor, datagram=False)
        for sample in decoder.decode(frames).samples():
            if isinstance(sample, GpsFix) and sample.source == "HIL_GPS":
                heard.fixes[sample.t_us] = sample
            elif isinstance(sample, Epoch):
                heard.epochs[sample.t_us] = sample
    flight.finish()
    return heard


def moved_ned_m(fix: GpsFix, clean: GpsFix) -> np.ndarray:
    """Where one fix lies (3,) from another."""
    lat, lon = np.radians(clean.lat_deg), np.radians(clean.lon_deg)
    there = ecef_from_geodetic(np.radians(fix.lat_deg), np.radians(fix.lon_deg), fix.alt_m)
    here = ecef_from_geodetic(lat, lon, clean.alt_m)
    return np.asarray(ned_axes(float(lat), float(lon)) @ np.subtract(there, here))


def change(epoch: Epoch, clean: Epoch, name: str) -> np.ndarray:
    """Of a satellite: pseudorange, Doppler rate and C/N0 (3,) less those without the fault."""
    rows = []
    for one in (epoch, clean):
        if name not in one.satellites:
            return np.full(3, np.nan)
        i = one.satellites.index(name)
        rows.append([one.pseudorange_m[i], one.doppler_mps[i], one.cn0_dbhz[i]])
    return np.subtract(*rows)


def main() -> None:
    """Fly and draw."""
    clean = flown("")
    names = sorted({name for epoch in clean.epochs.values() for name in epoch.satellites})
    figure = Figure(figsize=(13.0, 2.0 * len(PRESETS)), layout="constrained")
    axes = figure.subplots(len(PRESETS), len(COLUMNS), sharex=True, squeeze=False)
    for row, preset in zip(axes, PRESETS, strict=True):
        heard = flown(preset)
        both = sorted(t_us for t_us in heard.fixes if t_us in clean.fixes)
        fixed = [t_us for t_us in both if heard.fixes[t_us].fix_type >= 3]
        moved = np.array([moved_ned_m(heard.fixes[t], clean.fixes[t]) for t in fixed])
        for axis, name in enumerate(("north", "east", "down")):
            row[0].plot(np.array(fixed) * 1e-6, moved[:, axis], ".", markersize=2, label=name)
        row[0].legend(fontsize=6, loc="upper left")
        stamps = sorted(set(heard.epochs) & set(clean.epochs))
        for name in names:
            lines = [change(heard.epochs[t], clean.epochs[t], name) for t in stamps]
            for cell, values in zip(row[1:], np.transpose(lines), strict=True):
                cell.plot(np.array(stamps) * 1e-6, values, color=COLOURS[name[0]], linewidth=0.6)
        row[0].set_ylabel(preset, fontsize=8)
    for cell, title in zip(axes[0], COLUMNS, strict=True):
        cell.set_title(f"change of {title}", fontsize=9)
    for cell in axes.flat:
        cell.tick_params(labelsize=7)
        cell.grid(alpha=0.3)
    for cell in axes[-1]:
        cell.set_xlabel("time, s", fontsize=8)
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    main()
