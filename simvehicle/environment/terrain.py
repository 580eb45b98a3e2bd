"""Height of the ground: one number, or a grid in Esri's ASCII raster format (.asc).

The grid's coordinates are longitude and latitude in degrees, its values metres above mean sea
level; between the cells' centres the height is bilinear. Format: Esri, "ASCII raster file format".
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
        """Height above mean sea level [m]; beyond its edge the grid goes on level."""
        rows, columns = self.height_m.shape
        row = (math.degrees(lat_rad) - self.south_deg) / self.cell_deg
        column = (math.degrees(lon_rad) - self.west_deg) / self.cell_deg
        # A flight that leaves the grid finds the ground of its edge.
        row = min(max(row, 0.0), rows - 1.0)
        column = min(max(column, 0.0), columns - 1.0)
        i, j = min(int(row), rows - 2), min(int(column), columns - 2)
        a, b = row - i, column - j
        h = self.height_m
        south = (1.0 - b) * h[i, j] + b * h[i, j + 1]
        north = (1.0 - b) * h[i + 1, j] + b * h[i + 1, j + 1]
        return float((1.0 - a) * south + a * north)


@dataclass(frozen=True, slots=True)
class LevelGround:
    """Ground of one height above mean sea level [m]."""

    alt_m: float

    def ground(self, lat_rad: float, lon_rad: float) -> float:
        """Height above mean sea level [m]."""
        return self.alt_m


def read_terrain_grid(path: str | Path) -> TerrainGrid:
    """Read an ASCII raster.

    Raises
    ------
    ConfigError
        If the file is no such raster, or has cells without data.
    """
    try:
        lines = Path(path).read_text(encoding="ascii").splitlines()
        header: dict[str, float] = {}
        while lines and lines[0].split()[0].isidentifier():
            key, value = lines.pop(0).split()
            header[key.lower()] = float(value)
        values = np.array([float(v) for line in lines for v in line.split()])
    except (OSError, ValueError, IndexError) as error:
        raise ConfigError(f"{path}: is no ASCII raster ({error}); an .asc file is needed") from None
    missing = [key for key in _KEYS if key not in header]
    if missing:
        raise ConfigError(f"{path}: lacks {', '.join(missing)}; a header with all five is needed")
    shape = int(header["nrows"]), int(header["ncols"])
    if values.size != shape[0] * shape[1] or min(shape) < 2:
        raise ConfigError(
            f"{path}: has {values.size} values for {shape[0]} rows of {shape[1]}; "
            "at least two by two, and as many as the header says"
        )
    if np.any(values == header.get("nodata_value", -9999.0)) or not np.all(np.isfinite(values)):
        raise ConfigError(f"{path}: has cells without data; every cell needs a height")
    cell = header["cellsize"]
    return TerrainGrid(
        # The format begins in the north; rows here go to the north.
        np.flipud(values.reshape(shape)).copy(),
        # The corner of the cell is given; its height is that of the centre.
        header["yllcorner"] + 0.5 * cell,
        header["xllcorner"] + 0.5 * cell,
        cell,
    )
