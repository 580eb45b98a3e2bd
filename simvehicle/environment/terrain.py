"""Height of the ground as a grid in Esri's ASCII raster format (.asc).

The grid's coordinates are longitude and latitude in degrees, its values metres above mean sea
level, interpolated bilinearly between cell centres. Format: Esri, "ASCII raster file format".
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError

_KEYS = ("ncols", "nrows", "xllcorner", "yllcorner", "cellsize")


@dataclass(frozen=True, slots=True)
class TerrainGrid:
    """Heights (rows from south to north, columns from west to east) [m] at cell centres [deg]."""

    height_m: NDArray[np.float64]
    south_deg: float
    west_deg: float
    cell_deg: float

    def ground(self, lat_rad: float, lon_rad: float) -> float:
        """Height above mean sea level [m]; beyond the grid, the height of its edge."""
        rows, columns = self.height_m.shape
        row = (math.degrees(lat_rad) - self.south_deg) / self.cell_deg
        column = (math.degrees(lon_rad) - self.west_deg) / self.cell_deg
        # Clamp to the grid.
        row = min(max(row, 0.0), rows - 1.0)
        column = min(max(column, 0.0), columns - 1.0)
        i, j = min(int(row), rows - 2), min(int(column), columns - 2)
        a, b = row - i, column - j
        h = self.height_m
        south = (1.0 - b) * h[i, j] + b * h[i, j + 1]
        north = (1.0 - b) * h[i + 1, j] + b * h[i + 1, j + 1]
        return float((1.0 - a) * south + a * north)


def read_terrain_grid(path: str | Path) -> TerrainGrid:
    """Read an ASCII raster.

    Raises
    ------
    ConfigError
        If the file is not an ASCII raster, or has cells without data.
    """
    try:
        lines = Path(path).read_text(encoding="ascii").splitlines()
        header: dict[str, float] = {}
        while lines and lines[0].split()[0].isidentifier():
            key, value = lines.pop(0).split()
            header[key.lower()] = float(value)
        values = np.array([float(v) for line in lines for v in line.split()])
    except (OSError, ValueError, IndexError) as error:
        raise ConfigError(f"{path}: not an ASCII raster ({error}); use an .asc file") from None
    missing = [key for key in _KEYS if key not in header]
    if missing:
        raise ConfigError(f"{path}: the header lacks {', '.join(missing)}; add them")
    shape = int(header["nrows"]), int(header["ncols"])
    if values.size != shape[0] * shape[1] or min(shape) < 2:
        raise ConfigError(
            f"{path}: has {values.size} values for {shape[0]} rows of {shape[1]}; "
            "provide as many as the header says, at least 2 x 2"
        )
    if np.any(values == header.get("nodata_value", -9999.0)) or not np.all(np.isfinite(values)):
        raise ConfigError(f"{path}: has cells without data; fill in a height for each")
    cell = header["cellsize"]
    return TerrainGrid(
        # The file starts in the north; rows here run northward.
        np.flipud(values.reshape(shape)).copy(),
        # The header has the corner of a cell; heights are at the centres.
        header["yllcorner"] + 0.5 * cell,
        header["xllcorner"] + 0.5 * cell,
        cell,
    )
