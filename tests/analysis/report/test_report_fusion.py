"""The fused solution in a report: errors in its own band, with and without isolation."""

import numpy as np

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.curves.fused_curves import error_ned_m
from analysis.report.curves.recording import FlightData, GroundTrack, join_recordings
from analysis.report.page.fused_table import fused_table
from analysis.report.recordings.from_results import recording_of_results
from analysis.results import FusedState
from mavproxy_fault.numerics.earth import ecef_from_geodetic

LAT_DEG, LON_DEG, ALT_M = 47.0, 8.0, 500.0
METRE_DEG = 1.0 / 111_195.0  # of latitude, on the sphere that reports measure on


def state(second, up_m, name="fused", **changes):
    """A fused state above the reference point."""
    at = ecef_from_geodetic(np.radians(LAT_DEG), np.radians(LON_DEG), ALT_M + up_m)
    return FusedState(
        t_us=second * 1_000_000,
        position_ecef_m=tuple(at),
        velocity_ned_mps=(0.0, 0.0, 0.0),
        q_nb=(1.0, 0.0, 0.0, 0.0),
        position_sigma_m=(1.0, 1.0, 2.0),
        velocity_sigma_mps=(0.1, 0.1, 0.1),
        attitude_sigma_deg=(1.0, 1.0, 1.0),
        name=name,
        **changes,
    )


def truth():
    """A vehicle at rest."""
    t_s = np.arange(10.0)
    columns = (np.full(10, value) for value in (LAT_DEG, LON_DEG, ALT_M))
    return GroundTrack("truth", t_s, *columns)


def recorded(states):
    """A report's recording of fused states with the truth."""
    flight = FlightData("flight", tracks=[truth()])
    return add_derived_curves(join_recordings(flight, recording_of_results([], states, 0)))


def curves(recording, panel):
    """Values of a panel's curves by name."""
    return {signal.name: signal.value for signal in recording.of(panel)}


def test_errors_of_each_axis_are_drawn_with_three_sigma_bounds():
    found = curves(recorded([state(k, 3.0) for k in range(8)]), "fused-down")
    assert np.allclose(found["fused"], -3.0, atol=1e-3)
    assert set(found["+3 sigma"]) == {6.0}
    assert set(found["-3 sigma"]) == {-6.0}


def test_both_fused_solutions_are_on_the_map_and_in_the_plots():
    name = "fused without isolation"
    states = [s for k in range(8) for s in (state(k, 1.0), state(k, 9.0, name))]
    recording = recorded(states)
    assert {track.name for track in recording.tracks} == {"truth", "fused", name}
    assert np.allclose(curves(recording, "fused-down")[name], -9.0, atol=1e-3)
    table = fused_table(recording)
    assert [(row[0], row[2]) for row in table.rows] == [("fused", "1.00"), (name, "9.00")]
    assert table.rows[0][4:] == ("100.0 %", "0.25")  # (1 m / 2 m) squared


def test_weights_are_curves_and_reasons_of_the_fused_solution_are_events():
    states = [state(0, 0.0, reason="the graph started"), state(1, 0.0, weights={"G01": 0.5})]
    recording = recording_of_results([], states, 0)
    assert curves(recording, "fused-weight")["G01"].tolist() == [0.5]
    assert [event.text for event in recording.events] == ["fused: the graph started"]


def test_without_the_truth_there_is_no_error_and_no_table():
    recording = add_derived_curves(recording_of_results([], [state(k, 0.0) for k in range(4)], 0))
    assert not recording.of("fused-north")
    assert fused_table(recording) is None


def test_errors_are_in_metres_north_and_east():
    moved = truth()
    off = GroundTrack(
        "fused",
        moved.t_s,
        moved.lat_deg + 2.0 * METRE_DEG,
        moved.lon_deg + 3.0 * METRE_DEG / np.cos(np.radians(LAT_DEG)),
        moved.alt_m,
    )
    _, error = error_ned_m(off, moved)
    assert np.allclose(error, [2.0, 3.0, 0.0], atol=0.01)
