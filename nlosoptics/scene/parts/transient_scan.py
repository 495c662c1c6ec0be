"""How a scene's light is taken over time: wall points, bins, and where to look for the picture."""

from __future__ import annotations

from dataclasses import dataclass

from ..._checks import in_range, one_of, positive, real, whole
from ...errors import SceneError

SCANS = ("single", "confocal", "exhaustive")
#: Keys of the volume, which come together.
VOLUME = ("near", "far", "step")


@dataclass(frozen=True, kw_only=True)
class TransientScan:
    """Time-resolved capture off the wall z = 0, and the volume for a picture of it.

    Times are lengths of optical path without the legs from the laser and to the camera.

    Parameters
    ----------
    side : float
        Of the square scanned, about the wall's centre, m.
    count : int
        Points along each side, at the middles of cells.
    scan : {"single", "confocal", "exhaustive"}
        Where the laser points: at laser.aim; at each sensor point; at every point for each.
    delta_t : float
        Width of a bin, m of optical path.
    n_bins : int
        Bins of time.
    t_start : float
        Where bin 0 begins, m of optical path.
    max_bounces : int
        Most reflections of a path, the wall's two included.
    wl_mean : float, optional
        Virtual wavelength of the picture, m.
    near, far, step : float, optional
        First and last plane of the picture and their distance, m from the wall.
    """

    side: float
    count: int
    delta_t: float
    n_bins: int
    scan: str = "single"
    t_start: float = 0.0
    max_bounces: int = 3
    wl_mean: float | None = None
    near: float | None = None
    far: float | None = None
    step: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("side", "delta_t"):
            put(self, name, positive(f"transient.{name}", getattr(self, name), unit="m"))
        put(self, "count", whole("transient.count", self.count))
        put(self, "n_bins", whole("transient.n_bins", self.n_bins))
        one_of("transient.scan", self.scan, SCANS)
        put(self, "t_start", real("transient.t_start", self.t_start))
        put(self, "max_bounces", whole("transient.max_bounces", self.max_bounces, 3, 5))
        for name in ("wl_mean", *VOLUME):
            if getattr(self, name) is not None:
                value = positive(f"transient.{name}", getattr(self, name), unit="m")
                put(self, name, value)
        given = [name for name in VOLUME if getattr(self, name) is not None]
        if 0 < len(given) < 3:
            missing = next(name for name in VOLUME if name not in given)
            raise SceneError(
                f"transient.{missing} is missing beside transient.{given[0]}; give near, far and "
                "step, or none of them"
            )
        if self.near is not None and self.far is not None:
            in_range("transient.far", self.far, self.near, unit="m", remedy="not before near")
