"""Sky plot from a log: directions of the satellites, and which of them the receiver used.

It reads PX4's `satellite_info` and MAVLink's GPS_STATUS. Their definitions count the elevation from
the zenith, but PX4's u-blox driver writes the angle above the horizon, and the azimuth scaled to
255 per turn, which is assumed here.
"""

import numpy as np

from analysis.field_maps.field_map import NOTHING, Fields
from analysis.recordings.gnss.sbf_orbits import satellite_name
from analysis.report.curves.recording import FlightData, Message, Vector
from analysis.report.page.gnss_figures import Picture, draw_sky
from mavproxy_fault.documents.extras import has_extra

AZIMUTH_STEPS = 255.0
# First and last number of each system in u-blox's common numbering, its letter, and the offset.
SATELLITE_NUMBERS = (
    (1, 32, "G", 0), (33, 64, "C", 27), (65, 96, "R", 64), (120, 158, "S", 119),
    (159, 163, "C", 158), (193, 202, "J", 192), (211, 246, "E", 210),
)  # fmt: skip
SKY_MESSAGES = (("satellite_info", "svid", ""), ("GPS_STATUS", "satellite_prn", "satellite_"))


def sky_pictures(recording: FlightData) -> list[Picture]:
    """The sky plot of a log; empty without satellite messages, or matplotlib."""
    for message, numbers, prefix in SKY_MESSAGES:
        if (found := recording.messages.get(message)) is not None:
            rows = _rows(found, numbers, prefix)
            if len(rows) and has_extra("matplotlib"):
                return [_picture(rows)]
    return []


def _rows(message: Message, numbers: str, prefix: str) -> Vector:
    """Number, elevation, azimuth (deg) and use (0 or 1) of each satellite at each time (k, 4)."""
    names = (numbers, f"{prefix}elevation", f"{prefix}azimuth", f"{prefix}used")
    fields = Fields(message.columns, NOTHING)
    try:
        number, elevation, azimuth, used = (np.asarray(fields[name], float).T for name in names)
    except KeyError:  # fields of another version
        return np.empty((0, 4))
    rows = np.stack([number, elevation, azimuth * (360.0 / AZIMUTH_STEPS), used > 0.0], axis=-1)
    rows = rows.reshape(-1, 4)
    # Drop empty entries and satellites without a direction.
    return rows[(rows[:, 0] > 0) & ((rows[:, 1] > 0) | (rows[:, 2] > 0)) & (rows[:, 1] <= 90)]


def _picture(rows: Vector) -> Picture:
    numbers, place = np.unique(rows[:, 0], return_inverse=True)
    unused, places = (rows[:, 3] == 0.0).astype(float), place.astype(float)
    names = [satellite_name(int(n), SATELLITE_NUMBERS) or str(int(n)) for n in numbers]
    title = "Sky plot by the receiver; unused satellites in red"
    return title, draw_sky(rows[:, 1], rows[:, 2], unused, places, names)
