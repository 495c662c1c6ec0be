"""Physical dimensions of the parts' values: scene files read and write these with their units."""

from __future__ import annotations

from enum import Enum
from typing import Annotated


class Kind(Enum):
    """A physical dimension: its name, its SI unit, and an example."""

    LENGTH = ("a length", "m", "1.2 m")
    TIME = ("a time", "s", "40 ms")
    RATE = ("a rate", "1/s", "0.1 / s")
    POWER = ("a power", "W", "5 mW")
    ANGLE = ("an angle", "rad", "15 deg")
    CURVATURE = ("a curvature", "1/m", "0.2 1/m")
    IRRADIANCE = ("an irradiance", "W/m^2", "0.5 W/m^2")
    RADIANCE = ("a radiance", "W/(m^2 sr)", "2 W/(m^2 sr)")

    def __init__(self, title: str, unit: str, example: str) -> None:
        self.title, self.unit, self.example = title, unit, example


Length = Annotated[float, Kind.LENGTH]
Time = Annotated[float, Kind.TIME]
Rate = Annotated[float, Kind.RATE]
Power = Annotated[float, Kind.POWER]
Angle = Annotated[float, Kind.ANGLE]
Irradiance = Annotated[float, Kind.IRRADIANCE]
Radiance = Annotated[float, Kind.RADIANCE]
