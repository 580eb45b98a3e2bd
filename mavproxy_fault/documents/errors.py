"""The error for mistakes of the user."""

from collections.abc import Iterator
from contextlib import contextmanager


class ConfigError(ValueError):
    """The user's file or command line is wrong; shown without a traceback, exit code 2.

    The text follows the form `<where>: <what it says> <is wrong how>; <what is allowed>`.
    """


@contextmanager
def users_path(where: object, cure: str) -> Iterator[None]:
    """Report a path that the user gave and the system refuses, or no UTF-8 in it, as ConfigError.

    Raises
    ------
    ConfigError
        Naming where the path was given, what is wrong, and what to do.
    """
    try:
        yield
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", "not UTF-8")
        raise ConfigError(f"{where}: {why}; {cure}") from None
