"""Colours of curves: the same quantity has the same colour on every plot, map and figure.

A colour is a number: `--s0`, `--s1`, ... in `page.css`, and `PALETTE` here for figures.
"""

from collections.abc import Sequence

PALETTE = (
    "#1f6fd0", "#d9541e", "#23883b", "#8a4fc7", "#b58900", "#0f8f9c", "#c2267e", "#6a737d",
    "#7a5230", "#4f7d00", "#3949ab", "#ad1457",
)  # fmt: skip
KNOWN = {
    "estimate": 0, "ATTITUDE": 0, "ATTITUDE_QUATERNION": 0, "actual": 0, "autopilot": 0,
    "desired": 1, "truth": 2, "fused": 3, "GPS": 4, "HIL_GPS": 4, "x": 0, "y": 1, "z": 2,
    "roll": 0, "pitch": 1, "yaw": 2, "north": 0, "east": 1, "down": 2, "air": 5,
}  # fmt: skip
GATES = ("gate", "threshold")  # names of limits that change with time: grey and dashed
GATE_COLOUR = 7


def series_colours(names: Sequence[str]) -> list[int]:
    """A colour for each curve of one plot: its fixed one, else the next free one."""
    own = {name: KNOWN[name] for name in names if name in KNOWN}
    # The grey of the gates is reserved: a grey curve would look like a limit.
    free = [i for i in range(len(PALETTE)) if i not in own.values() and i != GATE_COLOUR]
    found = []
    for name in names:
        if name.startswith(GATES):
            found.append(GATE_COLOUR)
        elif name in own and own[name] not in found:
            found.append(own[name])
        else:
            found.append(free[0] if free else len(found) % len(PALETTE))
            # With more curves than colours the colours repeat.
            free = [*free[1:], *free[:1]]
    return found
