"""What a misspelt name may have meant."""

import difflib
from collections.abc import Iterable

LONGEST = 100  # characters that are looked at: to compare millions takes seconds


def suggest_known(name: str, known: Iterable[str]) -> str:
    """A sentence about the known names nearest to a wrong one."""
    names = sorted(known)
    if not names:
        return "there is none"
    name = name[:LONGEST]
    # Names of messages are in capitals: a second look with the wrong name in capitals.
    close = difflib.get_close_matches(name, names, 3, 0.5) or difflib.get_close_matches(
        name.upper(), names, 3, 0.5
    )
    if close:
        return f"did you mean {' or '.join(close)}?"
    # Forty names fill a terminal; more would hide the sentence.
    return f"known: {', '.join(names[:40])}{', ...' if len(names) > 40 else ''}"
