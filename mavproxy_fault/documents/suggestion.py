"""Suggestions for misspelt names."""

import difflib
from collections.abc import Iterable

LONGEST = 100  # characters compared: millions would take seconds
LEAST_LIKE = 0.52  # chosen: altitude suggests alt (0.55), but help not schedule (0.5)


def suggest_known(name: str, known: Iterable[str], prefix: str = "") -> str:
    """Return a sentence that suggests the known names most similar to a wrong one.

    Each gets the `prefix`, which is not compared.
    """
    names = sorted(known)
    if not names:
        return "none exist"
    name = name[:LONGEST]
    # Message names are in capitals, so a second search uses capitals.
    close = difflib.get_close_matches(name, names, 3, LEAST_LIKE) or difflib.get_close_matches(
        name.upper(), names, 3, LEAST_LIKE
    )
    if close:
        return f"did you mean {' or '.join(prefix + one for one in close)}?"
    # Forty names fill a terminal.
    listed = ", ".join(prefix + one for one in names[:40])
    return f"known: {listed}{', ...' if len(names) > 40 else ''}"
