"""Packages that only some commands need: the installation's extras."""

import logging
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from mavproxy_fault.documents.errors import ConfigError

LOG = logging.getLogger(__name__)
# Whose name is not that of their module.
DISTRIBUTIONS = {"foxglove": "foxglove-sdk", "rerun": "rerun-sdk"}


def import_extra(name: str) -> Any:
    """Import a module of an extra.

    Raises
    ------
    ConfigError
        If it is not installed; the text says what to install.
    """
    require_extra(name.partition(".")[0])
    return import_module(name)


def require_extra(package: str) -> None:
    """Raise a ConfigError if a package is not installed, without importing it."""
    if find_spec(package) is None:
        raise ConfigError(_missing_text(package))


@cache
def has_extra(package: str) -> bool:
    """Whether a package is installed; if not, a warning says once what to install."""
    if find_spec(package) is None:
        LOG.warning("%s", _missing_text(package))
        return False
    return True


def _missing_text(package: str) -> str:
    return f"{package} is not installed; run pip install {DISTRIBUTIONS.get(package, package)}"
