"""The error for mistakes of the user."""


class ConfigError(ValueError):
    """The user's file or command line is wrong; shown without a traceback, exit code 2.

    The text follows the form `<where>: <what it says> <is wrong how>; <what is allowed>`.
    """
