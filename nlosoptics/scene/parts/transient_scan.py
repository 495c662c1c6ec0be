"""Settings of a time-resolved capture: wall points, time bins and reconstruction volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..._checks import in_range, one_of, positive, real, whole
from ...errors import SceneError
from ._quantities import Length

SCANS = ("single", "confocal", "exhaustive")


@dataclass(frozen=True, kw_only=True)
class TransientScan:
    """Time-resolved capture on the plane wall z = 0, and the volume to reconstruct from it.

    A time-resolved detector records histograms of arrival times at points of a square grid on the
    wall. Times are given as optical path lengths in m (time multiplied by the speed of light). They
    exclude the paths from the laser to the wall and from the wall to the detector.

    ``wl_mean``, ``near``, ``far`` and ``step`` do not affect the capture. They are stored in its
    file as defaults of the command ``nlosoptics image``, which otherwise requires them as options.

    Parameters
    ----------
    side : float
        Side of the scanned square, centred on the wall, m.
    count : int
        Number of scan points along each side of the square. The points are the centres of
        count x count equal cells.
    scan : {"single", "confocal", "exhaustive"}
        Which points the laser illuminates while the detector scans the grid. "single":
        ``laser.aim`` only. "confocal": the point that the detector looks at. "exhaustive": every
        grid point in turn, for each point of the detector.
    delta_t : float
        Width of a time bin as optical path length, m.
    n_bins : int
        Number of time bins.
    t_start : float
        Start of the first time bin as optical path length, m.
    max_bounces : int
        Largest number of reflections of a path, 3 to 5, including the two at the wall.
    wl_mean : float, optional
        Central wavelength of the virtual pulse, m. This is the pulse with which the phasor-field
        reconstruction filters the capture in time. A smaller value resolves finer detail; it should
        be at least 4 ``delta_t``.
    near : float, optional
        Distance of the first reconstructed plane from the wall, m. Give ``near``, ``far`` and
        ``step``, or none of them.
    far : float, optional
        Distance of the last reconstructed plane from the wall, m; at least ``near``.
    step : float, optional
        Distance between neighbouring reconstructed planes, m.

    Raises
    ------
    SceneError
        If a value is out of range, or only some of ``near``, ``far`` and ``step`` are given.

    See Also
    --------
    nlosoptics.transient.render_scene : Capture of a scene file.
    Camera : Lens and detector.
    """

    side: Length
    count: int
    delta_t: Length
    n_bins: int
    scan: Annotated[str, SCANS] = "single"
    t_start: Length = 0.0
    max_bounces: int = 3
    wl_mean: Length | None = None
    near: Length | None = None
    far: Length | None = None
    step: Length | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("side", "delta_t"):
            put(self, name, positive(f"transient.{name}", getattr(self, name), unit="m"))
        put(self, "count", whole("transient.count", self.count))
        put(self, "n_bins", whole("transient.n_bins", self.n_bins))
        one_of("transient.scan", self.scan, SCANS)
        put(self, "t_start", real("transient.t_start", self.t_start))
        put(self, "max_bounces", whole("transient.max_bounces", self.max_bounces, 3, 5))
        volume = ("near", "far", "step")
        for name in ("wl_mean", *volume):
            if getattr(self, name) is not None:
                value = positive(f"transient.{name}", getattr(self, name), unit="m")
                put(self, name, value)
        given = [name for name in volume if getattr(self, name) is not None]
        if 0 < len(given) < 3:
            missing = next(name for name in volume if name not in given)
            raise SceneError(
                f"transient.{missing} is missing although transient.{given[0]} is given; give "
                "near, far and step, or none of them"
            )
        if self.near is not None and self.far is not None:
            in_range("transient.far", self.far, self.near, unit="m", remedy="not before near")
