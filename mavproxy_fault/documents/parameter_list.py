"""Parameter files of the user, which override the parameters that a run sets."""

import math
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError, users_path

QGC_COLUMNS = 5  # QGroundControl's: vehicle, component, name, value, type


def read_parameters(file: str | None) -> dict[str, float]:
    """Read names and values from a file of Mission Planner, MAVProxy or QGroundControl.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a line is not a parameter.
    """
    if file is None:
        return {}
    with users_path(f"--parameters: {file} cannot be read", "give a parameter file"):
        lines = Path(file).read_text(encoding="utf-8-sig").splitlines()
    values: dict[str, float] = {}
    for number, line in enumerate(lines, 1):
        columns = line.partition("#")[0].replace(",", " ").split()
        if not columns:
            continue
        name, text = columns[2:4] if len(columns) == QGC_COLUMNS else (*columns, "")[:2]
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if len(columns) not in (2, QGC_COLUMNS) or not math.isfinite(value):
            raise ConfigError(f"{file}:{number}: {line.strip()!r} is not NAME VALUE")
        values[name] = value
    return values


def format_parameters(parameters: dict[str, float]) -> str:
    """Format parameters as lines of NAME VALUE, as ArduPilot reads them."""
    return "".join(f"{name} {value:.9g}\n" for name, value in parameters.items())
