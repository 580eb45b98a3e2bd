"""Checks of curves against limits, a line each in `LEVELS`."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from analysis.report.curves.fused_curves import error_ned_m
from analysis.report.curves.motor_outputs import balance_curves, motor_outputs
from analysis.report.curves.recording import (
    FlightData,
    Signal,
    Windows,
    inside_windows,
    running_mean,
)
from analysis.report.curves.vehicle_phase import (
    ARMED,
    COPTER,
    FLYERS,
    FLYING,
    ROVER,
    SUB,
    flying_windows,
)
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import (
    FAIL,
    NONE,
    PASS,
    WARN,
    CheckLimits,
    FlightCheck,
    check_level,
    restrict_to_classes,
)
from analysis.report.judging.lanes_in_use import check_in_use, estimator_windows, imu_windows

LOG = "log"  # the phase of checks that hold on the ground too
CONTROL_HOLD_S = 0.3  # chosen: out of control a vehicle oscillates, so large errors are brief
POWERED_V = 2.0  # chosen: a rail that never exceeds it is not connected
LEAST_CELL_V = 1.0  # chosen: below it a cell is not connected
MEAN_S = 2.0  # averaging time; chosen to suppress manoeuvres and vibration
FULL_OUTPUT = 0.99  # share of the range, below 1 for rounding
SIMULATED = "SIM_SPEEDUP"  # a parameter of ArduPilot's own simulator
FIX_2D = 2
# The wheels shake a rover more than any limit for motors and propellers.
SHAKEN = {*FLYERS, SUB}
# No signal of a satellite reaches a vehicle under water.
ON_LAND_OR_AIR = {*FLYERS, ROVER}

Curves = Callable[[FlightData, CheckLimits, Windows | None], list[Signal]]


class LevelCheck(NamedTuple):
    """One check: the curves of a panel, or those that `curves` gives, and their limits.

    `limits` is their name in `Thresholds`, in which {} is the autopilot; they hold for `hold_s`,
    None: as the criteria say. The check holds in one `phase`, for some `classes` of vehicle (none:
    all), and `on_bench` before arming too. `lanes` gives when each estimator or IMU was in use.
    """

    name: str
    panel: str
    limits: str
    unit: str = ""
    hold_s: float | None = None
    below: bool = False
    phase: str = ARMED
    classes: Collection[str] = ()
    curves: Curves | None = None
    lanes: Callable[[FlightData], Mapping[int, Windows]] | None = None
    on_bench: bool = False


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each quantity in its phase of the flight."""
    phases = {ARMED: armed, FLYING: flying_windows(recording), LOG: None}
    return [_judge(line, recording, th, phases[line.phase]) for line in LEVELS]


def bench_checks(recording: FlightData, th: Thresholds, bench: Windows) -> list[FlightCheck]:
    """Check the quantities of receiver and estimator before arming."""
    return [_judge(line, recording, th, bench) for line in LEVELS if line.on_bench]


def compare_motors(
    recording: FlightData, references: Sequence[FlightData], th: Thresholds
) -> FlightCheck:
    """Compare each motor's output with that in reference flights of the same vehicle.

    A damaged propeller turns faster for the same thrust. The deviation from the mean of all motors
    is compared, which load and battery hardly change, by its median over the flight.
    """
    name, (warn, fail) = "motors against the reference", th.motor_change
    limit = CheckLimits(warn, fail).text()
    here, *others = ({s.name: float(np.median(s.value)) for s in one.of("balance")}
                     for one in (recording, *references))  # fmt: skip
    there = [one for one in others if one.keys() == here.keys()]
    if not here or not there:
        return FlightCheck(name, NONE, "no outputs of the same motors in both flights", limit)
    rises = {motor: here[motor] - np.mean([one[motor] for one in there]) for motor in here}
    worst = max(rises, key=rises.__getitem__)
    text = f"{worst} at {100 * rises[worst]:+.1f} % of its range, the others at most "
    text += f"{100 * max(rise for motor, rise in rises.items() if motor != worst):+.1f} %"
    verdict = FAIL if rises[worst] > fail else WARN if rises[worst] > warn else PASS
    found = FlightCheck(name, verdict, text, limit, panel="balance", levels=(warn, fail))
    return restrict_to_classes(found, recording.vehicle, {COPTER})


def _judge(
    line: LevelCheck, recording: FlightData, th: Thresholds, windows: Windows | None
) -> FlightCheck:
    warn, fail = getattr(th, line.limits.format(recording.autopilot or "ardupilot"))
    hold_s = th.hold_s if line.hold_s is None else line.hold_s
    limits = CheckLimits(warn, fail, line.unit, line.below, hold_s)
    signals = line.curves(recording, limits, windows) if line.curves else recording.of(line.panel)
    if line.lanes is None:
        found = check_level(line.name, signals, limits, windows)
    else:
        found = check_in_use(line.name, signals, limits, windows, line.lanes(recording))
    if line.panel == "gps-fix" and signals and windows != [] and not _has_fix(recording):
        # It may be unused.
        evidence = "the receiver sends messages but has no fix in the entire log"
        found = FlightCheck(line.name, WARN, evidence, limits.text(), panel=line.panel)
    return restrict_to_classes(found, recording.vehicle, line.classes)


def _named(panel: str, names: str | tuple[str, ...]) -> Curves:
    """The curves of a panel with names that begin so."""
    return lambda recording, *_: [s for s in recording.of(panel) if s.name.startswith(names)]


def _averaged(panel: str) -> Curves:
    return lambda recording, *_: [_absolute(running_mean(s, MEAN_S)) for s in recording.of(panel)]


def _absolute(signal: Signal) -> Signal:
    return signal._replace(value=np.abs(signal.value))


def _clipped(recording: FlightData, _: CheckLimits, windows: Windows | None) -> list[Signal]:
    """Count of clipped samples while armed; since the log's start where arming is not logged."""
    grown = []
    for signal in recording.of("clipping"):
        # Increments only: the counter may start at any value and restart at zero.
        steps = np.maximum(np.diff(signal.value, prepend=signal.value[:1]), 0)
        steps = np.where(inside_windows(signal.t_s, windows), steps, 0)
        grown.append(signal._replace(value=np.cumsum(steps)))
    return grown


def _field_changes(recording: FlightData, *_: object) -> list[Signal]:
    """Deviation of each compass's field strength from its median, percent."""
    # Relative to its own median, as the field strength depends on the location.
    middles = [(s, np.nanmedian(s.value)) for s in recording.of("mag") if len(s.value)]
    return [
        signal._replace(value=100 * np.abs(signal.value / middle - 1))
        for signal, middle in middles
        if middle > 0
    ]


def _powered(recording: FlightData, limits: CheckLimits, _: object) -> list[Signal]:
    """The voltages of connected rails; servos may always have less than the board."""
    # A rail that is not connected reads some hundredths of a volt.
    return [
        s
        for s in recording.of("board-voltage")
        if s.value.max(initial=0) > POWERED_V
        and (s.name != "servo rail" or np.nanquantile(s.value, 0.9) > limits.warn)
    ]


def _positions(recording: FlightData, *_: object) -> list[Signal]:
    return [s for s in recording.of("position-error") if s.name in ("estimate", "fused")]


def _height_errors(recording: FlightData, *_: object) -> list[Signal]:
    tracks = {track.name: track for track in recording.tracks}
    names = [name for name in ("estimate", "fused") if {name, "truth"} <= tracks.keys()]
    errors = [(name, *error_ned_m(tracks[name], tracks["truth"])) for name in names]
    return [Signal("altitude", name, t_s, np.abs(error[:, 2])) for name, t_s, error in errors]


def _angle_errors(recording: FlightData, *_: object) -> list[Signal]:
    return [
        _absolute(signal._replace(name=axis))
        for axis in ("roll", "pitch", "yaw")
        for signal in recording.of(f"error-{axis}")
        if signal.name == "autopilot"
    ]


def _satellites(recording: FlightData, *_: object) -> list[Signal]:
    return recording.of("gps-satellites") if _has_fix(recording) else []


def _has_fix(recording: FlightData) -> bool:
    return any(signal.value.max(initial=0) >= FIX_2D for signal in recording.of("gps-fix"))


def _balance(recording: FlightData, *_: object) -> list[Signal]:
    return [_absolute(signal) for signal in balance_curves(recording)]


def _time_at_limit(recording: FlightData, *_: object) -> list[Signal]:
    """The time that each motor has been at full output."""
    found = []
    for signal in motor_outputs(recording):
        full = signal.value >= FULL_OUTPUT
        # Time of the last sample below full output.
        begin = np.maximum.accumulate(np.where(full, signal.t_s[0], signal.t_s))
        found.append(signal._replace(value=np.where(full, signal.t_s - begin, 0.0)))
    return found


def _cells(recording: FlightData, *_: object) -> list[Signal]:
    cells = recording.of("battery-cells")
    return [s for s in cells if np.nanmax(s.value, initial=0.0) > LEAST_CELL_V]


def _loops(recording: FlightData, *_: object) -> list[Signal]:
    # The loop times of a simulated autopilot depend on its simulator.
    return [] if SIMULATED in recording.parameters else recording.of("scheduler")


LEVELS = (
    LevelCheck("vibration", "vibration", "vibration_{}_mps2", "m/s²", classes=SHAKEN,
               lanes=imu_windows),
    LevelCheck("accelerometer clipping", "clipping", "clipping_count", hold_s=0.0, classes=SHAKEN,
               curves=_clipped, lanes=imu_windows),
    # On the ground a controller winds up against what holds the vehicle.
    LevelCheck("attitude control", "control-error", "attitude_control_deg", "deg", CONTROL_HOLD_S,
               phase=FLYING, classes=FLYERS, curves=_named("control-error", "tilt")),
    LevelCheck("compass field strength", "mag", "compass_change_percent", "% off its median",
               curves=_field_changes),
    LevelCheck("battery remaining", "battery-remaining", "battery_remaining_percent", "%",
               below=True),
    LevelCheck("board voltage", "board-voltage", "board_voltage_v", "V", 0.0, below=True,
               curves=_powered),
    LevelCheck("GPS fix", "gps-fix", "gps_fix_type", below=True, classes=ON_LAND_OR_AIR,
               on_bench=True),
    LevelCheck("GPS satellites", "gps-satellites", "gps_satellites", below=True,
               classes=ON_LAND_OR_AIR, curves=_satellites, on_bench=True),
    # The vertical one is larger by nature, and no autopilot limits it.
    LevelCheck("GPS dilution of precision", "gps-dilution", "gps_dilution",
               classes=ON_LAND_OR_AIR, curves=_named("gps-dilution", ("hdop", "eph")),
               on_bench=True),
    LevelCheck("GPS jumps", "gps-jump", "gps_step_m", "m", 0.0, classes=ON_LAND_OR_AIR,
               on_bench=True),
    LevelCheck("GPS jamming indicator", "gps-noise", "gps_jamming", phase=LOG,
               classes=ON_LAND_OR_AIR, curves=_named("gps-noise", "jamming indicator"),
               on_bench=True),
    LevelCheck("innovation test ratios", "ratio", "innovation_ratio", lanes=estimator_windows,
               on_bench=True),
    LevelCheck("EKF variances", "variance", "ekf_variance", lanes=estimator_windows,
               on_bench=True),
    LevelCheck("estimate steps", "estimate-jump", "estimate_step_m", "m", 0.0,
               classes=ON_LAND_OR_AIR, on_bench=True),
    LevelCheck("position against the truth", "position-error", "position_error_m", "m",
               curves=_positions, on_bench=True),
    LevelCheck("height against the truth", "altitude", "height_error_m", "m",
               curves=_height_errors, on_bench=True),
    LevelCheck("attitude against the truth", "error-roll", "attitude_error_deg", "deg",
               curves=_angle_errors, on_bench=True),
    # Lifting motors of equal share: neither a plane's, a helicopter's nor a submarine's.
    LevelCheck("motor balance", "balance", "motor_balance", phase=FLYING, classes={COPTER},
               curves=_balance),
    LevelCheck("motors at their limit", "actuators", "motor_limit_s", "s", 0.0, phase=FLYING,
               classes={COPTER}, curves=_time_at_limit),
    LevelCheck("gyroscopes agree", "gyro-disagreement", "gyro_apart_rps", "rad/s",
               curves=_averaged("gyro-disagreement")),
    LevelCheck("accelerometers agree", "accel-disagreement", "accel_apart_mps2", "m/s²",
               curves=_averaged("accel-disagreement")),
    LevelCheck("estimators agree", "divergence", "estimators_apart_deg", "deg"),
    LevelCheck("cell voltage", "battery-cells", "cell_v", "V", below=True, curves=_cells),
    LevelCheck("scheduler", "scheduler", "long_loops_percent", "%", 0.0, curves=_loops),
)  # fmt: skip
