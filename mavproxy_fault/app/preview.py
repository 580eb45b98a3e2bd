"""Plots of faults: the engine applied to synthetic healthy data, drawn with matplotlib."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.rtcm.msm7 import decode_msm7, encode_epoch
from mavproxy_fault.rtcm.transport import Reassembler, tunnel_frames, tunnel_payload
from mavproxy_fault.schedule.entries import Entry, Schedule
from mavproxy_fault.wire.dialect import find_layout, message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.plant_messages import plant_change

RATE_HZ = 50
BEFORE_S = 2.0
LONGEST_S = 60.0
OPEN_S = 8.0  # plotted duration of a fault without an end
COLUMNS = 5
RANGE_M = 2.2e7
MOST_SATELLITES = 24  # drawn of each system: one message in TUNNEL holds no more
LARGE = 1e5  # above it, a curve shows the change only
# Of 1e-7 degrees on the WGS 84 ellipsoid, at the latitude of HEALTHY.
METRES = {"lat": 0.011118, "lon": 0.007549}

Row = tuple[str, float, float, float | None]  # curve, time [s], healthy, faulty (None: lost)

# Plausible healthy values: (mean, amplitude, Hz) in the field's own units.
HEALTHY: dict[str, tuple[float, float, float]] = {
    "xgyro": (0, 0.3, 0.6), "ygyro": (0, 0.2, 0.5), "zgyro": (0, 0.1, 0.3),
    "xacc": (0, 1, 0.6), "yacc": (0, 1, 0.5), "zacc": (-9.81, 1, 0.4),
    "xmag": (0.21, 0.02, 0.2), "ymag": (0.02, 0.02, 0.2), "zmag": (0.42, 0.01, 0.2),
    "abs_pressure": (955, 0.5, 0.1), "pressure_alt": (500, 4, 0.1), "diff_pressure": (2, 0.3, 0.4),
    "lat": (473977418, 100, 0.1), "lon": (85455939, 100, 0.1), "alt": (488000, 1000, 0.1),
    "vn": (300, 200, 0.1), "ve": (100, 200, 0.1), "fix_type": (3, 0, 1),
    "satellites_visible": (11, 0, 1), "eph": (90, 0, 1), "epv": (140, 0, 1),
    "fields_updated": (0x1FFF, 0, 1), "controls": (0.5, 0.3, 0.7),
    "current_distance": (800, 50, 0.3), "id": (0, 0, 1),
    "voltage_battery": (15200, 50, 0.2), "voltages": (15200, 50, 0.2),
}  # fmt: skip


class FaultCurve(NamedTuple):
    """A value over time [s], healthy and faulty; `lost` are the times of lost frames."""

    name: str
    t_s: list[float]
    healthy: list[float]
    faulty: list[float]
    lost: list[float]


def draw_preview(schedule: Schedule, path: Path) -> None:
    """Draw one plot for every entry of a schedule.

    Raises
    ------
    ConfigError
        If matplotlib is not installed, the schedule is empty, or the file cannot be written.
    """
    entries = schedule.faults
    if not entries:
        raise ConfigError(f"{path}: the schedule has no faults to draw; add some")
    # No empty columns for a short schedule.
    columns = min(COLUMNS, len(entries))
    rows = math.ceil(len(entries) / columns)
    figure = import_extra("matplotlib.figure").Figure(
        figsize=(3.4 * columns, 2.2 * rows), layout="constrained"
    )
    for i, entry in enumerate(entries):
        _axes(figure.add_subplot(rows, columns, i + 1), entry, schedule.seed)
    figure.supxlabel("time, s", fontsize=9)
    try:
        figure.savefig(path, dpi=80)
    except (OSError, ValueError) as error:  # no folder, or no format of that suffix
        why = getattr(error, "strerror", error)
        raise ConfigError(f"{path}: cannot be drawn ({why}); give a PNG, SVG or PDF") from None


def _axes(axes: Any, entry: Entry, seed: int) -> None:
    found = preview_curves(entry, seed)
    axes.set_title(entry.id, fontsize=9)
    axes.tick_params(labelsize=7)
    for curve in found[:3]:
        axes.plot(curve.t_s, curve.healthy, color="0.75", linewidth=1)
        axes.plot(curve.t_s, curve.faulty, linewidth=1, label=curve.name)
        if curve.lost:
            axes.plot(curve.lost, [0] * len(curve.lost), "rx", markersize=3, label="lost")
    axes.legend(fontsize=6, loc="best")


def preview_window(entry: Entry) -> tuple[float, float]:
    """Return the plotted interval [s]: the fault with a margin on both sides."""
    # Long faults are cut, so that their edges remain visible.
    for_s = OPEN_S if entry.for_s is None else min(entry.for_s, LONGEST_S)
    if entry.repeat is not None and entry.repeat.every_s is not None:
        # Three repetitions show an endless pattern.
        for_s += entry.repeat.every_s * ((entry.repeat.times or 3) - 1)
    # These act slowly.
    if entry.name in ("gps-spoof", "plant", "cycle") and entry.for_s is None:
        for_s = LONGEST_S
    return max(entry.at_s - BEFORE_S, 0.0), entry.at_s + for_s + BEFORE_S


def preview_curves(entry: Entry, seed: int) -> list[FaultCurve]:
    """Compute the curves of a single entry; triggers are replaced by the start time."""
    # Triggers would need telemetry, which is not simulated here.
    at_s = entry.at_s or BEFORE_S
    timed = msgspec.structs.replace(
        entry, when=None, condition=None, after=None, moment=None, at_s=at_s
    )
    begin_s, end_s = preview_window(timed)
    times_s = [begin_s + i / RATE_HZ for i in range(int((end_s - begin_s) * RATE_HZ))]
    # In its own engine, without the other entries.
    engine = Engine(Schedule(seed, (timed,)))
    engine.start_at(0)
    found: dict[str, FaultCurve] = {}
    for name, t_s, healthy, faulty in _rows(engine, entry, times_s):
        curve = found.setdefault(name, FaultCurve(name, [], [], [], []))
        if faulty is None:
            curve.lost.append(t_s)
            continue
        curve.t_s.append(t_s)
        curve.healthy.append(healthy)
        curve.faulty.append(faulty)
    # On a latitude in 1e-7 degrees a change of metres would be invisible.
    return [
        _change_only(one) if max(one.healthy, default=0) > LARGE else one for one in found.values()
    ]


def _rows(engine: Engine, entry: Entry, times_s: Sequence[float]) -> Iterator[Row]:
    """Yield what the engine makes of healthy data of the kind that the entry acts on."""
    if isinstance(entry.fault, SatelliteFault):
        # Receivers send pseudoranges at a few hertz.
        return _satellite_rows(engine, entry.fault.names, times_s[:: RATE_HZ // 2])
    elements = getattr(entry.fault, "elements", {})
    if elements:
        # The first message represents the target.
        number, first = next(iter(elements.items()))
        places = [(one.name, one.item) for one in first]
        return _field_rows(engine, message_layout(number).name, places, times_s)
    if entry.targets and entry.targets[0].startswith(("PLANT.", "PSEUDORANGE.")):
        return _plant_rows(engine, times_s)
    if entry.name == "gps-spoof":
        return _field_rows(engine, "HIL_GPS", (("lat", 0), ("vn", 0)), times_s)
    if entry.name.startswith("time-"):
        return _field_rows(engine, "HIL_SENSOR", (("time_usec", 0),), times_s)
    return _link_rows(engine, entry, times_s)


def healthy_frame(name: str, t_s: float) -> Frame:
    """Build a healthy frame of a message, sent by a simulator."""
    described = message_layout(name)
    values: dict[str, Any] = {}
    for field in described.fields.values():
        mean, size, hertz = HEALTHY.get(field.name, (1, 1, 0.2))
        value = mean + size * math.sin(2 * math.pi * hertz * t_s)
        if field.name in ("time_usec", "usec"):
            value = t_s * 1e6
        if field.name == "time_boot_ms":
            value = t_s * 1e3
        if field.type == "char":
            continue
        if field.code not in "fd":
            value = round(value)
            # Unsigned fields have no negative values.
            value = value if field.code in "bhiq" else max(value, 0)
            # The limit of a signed field of this size.
            value = min(value, 2 ** (8 * field.size - 1) - 1)
        values[field.name] = [value] * field.count if field.count else value
    return Frame(build_frame(described, values, component=51), described)


def apply_engine(engine: Engine, frame: Frame, t_s: float) -> list[Outgoing]:
    """Return the frames that the engine sends for one frame."""
    return engine.apply(frame, "to-vehicle", round(t_s * 1e6))


def _field_rows(
    engine: Engine, name: str, places: Sequence[tuple[str, int]], times_s: Sequence[float]
) -> Iterator[Row]:
    fields = message_layout(name).fields
    units = [("m", METRES.get(field, 1.0)) if fields[field].unit == "degE7" else
             (fields[field].unit, 1.0) for field, _ in places]  # fmt: skip
    for t_s in times_s:
        healthy = healthy_frame(name, t_s)
        for out in apply_engine(engine, healthy, t_s):
            # Replies to the simulator do not belong to this stream.
            if isinstance(out.frame, Frame) and not out.back:
                for place, (unit, scale) in zip(places, units, strict=True):
                    before, after = (scale * float(f.number(*place)) for f in (healthy, out.frame))
                    yield f"{name}.{place[0]}, {unit}".removesuffix(", "), t_s, before, after


def _change_only(curve: FaultCurve) -> FaultCurve:
    """Replace the values by the change that the fault makes."""
    added = [after - before for before, after in zip(curve.healthy, curve.faulty, strict=True)]
    return curve._replace(name=f"change of {curve.name}", healthy=[0.0] * len(added), faulty=added)


def _link_rows(engine: Engine, entry: Entry, times_s: Sequence[float]) -> Iterator[Row]:
    """Yield the delay [ms] of each frame, and the lost frames."""
    described = find_layout(min(entry.ids)) if entry.ids else None
    name = described.name if described is not None else "HIL_SENSOR"
    for t_s in times_s:
        outs = apply_engine(engine, healthy_frame(name, t_s), t_s)
        # Both times count from the same start.
        for out in outs:
            yield f"delay of {name}, ms", t_s, 0.0, round(out.due_us / 1e3 - t_s * 1e3, 3)
        if not outs:
            yield f"delay of {name}, ms", t_s, 0.0, None


def _plant_rows(engine: Engine, times_s: Sequence[float]) -> Iterator[Row]:
    for t_s in times_s:
        for out in apply_engine(engine, healthy_frame("HIL_SENSOR", t_s), t_s):
            change = plant_change(out.frame) if isinstance(out.frame, Frame) else None
            if change is not None:
                # NaN interrupts the line while the plant is healthy.
                value = math.nan if change.value is None else change.value
                yield change.name, t_s, math.nan, value


def _satellite_rows(
    engine: Engine, names: Sequence[str], times_s: Sequence[float]
) -> Iterator[Row]:
    """Yield the metres added to each satellite's range."""
    reassembler = Reassembler()
    for number, t_s in enumerate(times_s):
        for system in {name[0]: None for name in names}:
            ours = [name for name in names if name[0] == system][:MOST_SATELLITES]
            healthy, zeros = (RANGE_M,) * len(ours), (0.0,) * len(ours)
            (epoch,) = encode_epoch(t_s, ours, healthy, zeros, zeros)
            for raw in tunnel_frames(epoch, number):
                for out in apply_engine(engine, Frame(raw, message_layout("TUNNEL")), t_s):
                    payload = tunnel_payload(out.frame) if isinstance(out.frame, Frame) else None
                    for message in reassembler.add(payload or b""):
                        data = decode_msm7(message)
                        ranges = dict(zip(data.satellites, data.pseudorange_m, strict=True))
                        for name in ours:
                            added = ranges[name] - RANGE_M if name in ranges else None
                            yield f"{name}, m", t_s, 0.0, added
