"""Suggestions for misspelt names."""

import difflib
from collections.abc import Iterable

LONGEST = 100  # characters compared: millions would take seconds
LEAST_LIKE = 0.52  # chosen: altitude suggests alt (0.55), but help not schedule (0.5)


def suggest_known(name: str, known: Iterable[str]) -> str:
    """Return a sentence that suggests the known names most similar to a wrong one."""
    names = sorted(known)
    if not names:
        return "none exist"
    name = name[:LONGEST]
    # Message names are in capitals, so a second search uses capitals.
    close = difflib.get_close_matches(name, names, 3, LEAST_LIKE) or difflib.get_close_matches(
        name.upper(), names, 3, LEAST_LIKE
    )
    if close:
        return f"did you mean {' or '.join(close)}?"
    # Forty names fill a terminal.
    return f"known: {', '.join(names[:40])}{', ...' if len(names) > 40 else ''}"
