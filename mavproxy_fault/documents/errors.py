"""The error for mistakes of the user."""

from collections.abc import Iterator
from contextlib import contextmanager


class ConfigError(ValueError):
    """The user's file or command line is wrong; shown without a traceback, exit code 2.

    The text follows the form `<where>: <what it says> <is wrong how>; <what is allowed>`.
    """


@contextmanager
def users_path(where: object, cure: str) -> Iterator[None]:
    """Report what the operating system refuses on a path that the user gave as a ConfigError.

    Raises
    ------
    ConfigError
        Naming where the path was given, what is wrong, and what to do.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{where}: {error.strerror}; {cure}") from None
