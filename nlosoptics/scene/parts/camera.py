"""Camera: a thin lens with its stop and a pixel detector."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import Vector, in_range, vector, whole
from ...errors import SceneError
from ._quantities import Angle, Length, Rate, Time


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Thin lens with its stop at the lens, and a square-pixel detector behind it.

    Parameters
    ----------
    position : (float, float, float)
        Centre of the lens, world frame, m.
    aim : (float, float, float)
        A point on the optical axis in front of the lens, world frame, m.
    focal_length : float
        Focal length of the thin lens, m.
    stop_diameter : float
        Clear diameter of the lens, m, which is also the diameter of its entrance pupil. The
        F-number engraved on a lens is ``focal_length/stop_diameter``.
    pixel_pitch : float
        Side of a native pixel (a pixel of the sensor, before binning), m, 1e-12 to 1.
    pixels : (int, int)
        Number of native pixels (pixels of the sensor, before binning) that are read out in x and y:
        the whole sensor, or a region of interest centred on the optical axis.
    binning : int, default 8
        Number of native pixels that are summed along each side of an image pixel. With the default,
        4096 x 4096 native pixels give an image of 512 x 512 pixels; 1 keeps every native pixel.
    exposure : float
        Exposure time, s, up to 1e18.
    quantum_efficiency : float
        Electrons per photon on the detector, above 0 and up to 1.
    transmission : float
        Transmittance of the lens, above 0 and up to 1.
    full_well : float
        Full-well capacity of a native pixel, electrons.
    read_noise : float
        Read noise per native pixel and readout, electrons rms.
    dark_current : float
        Dark current: electrons per native pixel and second.
    bit_depth : int
        Bits of the analogue-to-digital converter, 1 to 32. One digital step is
        ``full_well/2^bit_depth`` electrons.
    focus_distance : float, optional
        Distance along the optical axis from the lens to the plane in focus, m. By default the lens
        is focused on the mirror image of the hidden object in the wall.
    glare_fraction : float
        Fraction, 0 to 1, of the laser spot's light entering the lens that is scattered evenly over
        the sensor (veiling glare).
    field_stop : float, optional
        Full angle, rad, of the cone of light that a round baffle in front of the lens transmits.
        Light from outside the cone, for example from the laser spot, causes neither signal nor
        glare. By default there is no baffle.

    Raises
    ------
    SceneError
        If a value is out of range, ``binning`` does not divide ``pixels``, or the camera is behind
        the wall or looks away from it.

    See Also
    --------
    Scene : Complete scene.
    TransientScan : Scan of a time-resolved camera.

    Notes
    -----
    Image axes: x along ``e1 = unit(Y x n)``, y along ``e2 = n x e1``, with n the direction from the
    lens along the optical axis and Y = (0, 1, 0) (X = (1, 0, 0) if n is parallel to Y). Image
    arrays are indexed [y, x]. The row number grows along +y of the detector, so row 0 has the
    lowest y; the column number grows along +x. The lens inverts the image, so row 0 shows the top
    of the scene. An array drawn with row 0 on top therefore appears upright.

    The computation uses the working F-number ``N = d/stop_diameter``, with d the distance from lens
    to detector. For a lens that satisfies the sine condition, as photographic lenses do, this is
    ``1/(2 sin(alpha))``, with alpha the half angle of the cone of light on the detector. N must be
    above 0.5. If the edge of the relay wall, not the lens, limits the cone of light, the F-number
    is larger; see `psf.ExitPupil.f_number`.

    Examples
    --------
    >>> from nlosoptics.scene import Camera
    >>> camera = Camera(
    ...     position=(0, 0, 1.0), aim=(0, 0, 0), focal_length=50e-3, stop_diameter=25e-3
    ... )
    >>> camera.shape, round(1e6 * camera.image_pitch)
    ((512, 512), 72)
    """

    position: Vector
    aim: Vector
    focal_length: Length
    stop_diameter: Length
    pixel_pitch: Length = 9e-6
    pixels: tuple[int, int] = (4096, 4096)
    binning: int = 8
    exposure: Time = 40e-3
    quantum_efficiency: float = 0.7
    transmission: float = 0.9
    full_well: float = 70e3
    read_noise: float = 3.6
    dark_current: Rate = 0.0
    bit_depth: int = 16
    focus_distance: Length | None = None
    glare_fraction: float = 0.0
    field_stop: Angle | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("position", "aim"):
            put(self, name, vector(f"camera.{name}", getattr(self, name)))
        limits: dict[str, dict[str, Any]] = {
            "focal_length": {"open_low": True, "unit": "m"},
            "stop_diameter": {"open_low": True, "unit": "m"},
            "pixel_pitch": {"low": 1e-12, "high": 1.0, "unit": "m"},
            # at most about the age of the universe, so that numbers of photons stay finite
            "exposure": {"high": 1e18, "open_low": True, "unit": "s"},
            "quantum_efficiency": {"high": 1.0, "open_low": True},
            "transmission": {"high": 1.0, "open_low": True},
            "full_well": {"open_low": True, "unit": "electrons"},
            "read_noise": {},
            "dark_current": {},
            "glare_fraction": {"high": 1.0},
            "focus_distance": {"open_low": True, "unit": "m"},
            "field_stop": {"high": math.pi, "open_low": True},
        }
        for name, limit in limits.items():
            value = getattr(self, name)
            if value is not None or name not in ("focus_distance", "field_stop"):
                put(self, name, in_range(f"camera.{name}", value, **{"low": 0.0} | limit))
        if not isinstance(self.pixels, (tuple, list)) or len(self.pixels) != 2:
            raise SceneError(f"camera.pixels = {self.pixels!r}; give two whole numbers, x and y")
        put(self, "pixels", tuple(whole("camera.pixels", n) for n in self.pixels))
        put(self, "binning", whole("camera.binning", self.binning))
        put(self, "bit_depth", whole("camera.bit_depth", self.bit_depth, 1, 32))
        if any(n % self.binning for n in self.pixels):
            raise SceneError(
                f"camera.binning = {self.binning} does not divide camera.pixels = {self.pixels}; "
                "use a common divisor"
            )
        if self.focus_distance is not None and self.focus_distance <= self.focal_length:
            raise SceneError(
                f"camera.focus_distance = {self.focus_distance:g} m is within the focal length "
                f"{self.focal_length:g} m, where there is no real image; use a larger distance"
            )
        if self.position[2] <= 0:
            raise SceneError(
                f"camera.position has z = {self.position[2]:g} m, behind the wall; must be above 0"
            )
        if self.aim == self.position:
            raise SceneError("camera.aim equals camera.position; aim at a point of the wall")
        if self.axis[2] >= 0:
            raise SceneError(
                f"camera.aim = {self.aim} looks away from the wall, its z must be below the "
                f"camera's {self.position[2]:g} m"
            )

    @property
    def axis(self) -> NDArray[np.float64]:
        """Unit vector from the lens toward the aim point, world frame, (3,)."""
        n = np.subtract(self.aim, self.position)
        return np.asarray(n / np.linalg.norm(n))

    @property
    def frame(self) -> NDArray[np.float64]:
        """Unit vectors e1, e2 and n of the camera's axes as rows, world frame, (3, 3)."""
        return pupil_frame(self.axis)

    @property
    def shape(self) -> tuple[int, int]:
        """Image shape (ny, nx) after binning."""
        return (self.pixels[1] // self.binning, self.pixels[0] // self.binning)

    @property
    def f_number(self) -> float:
        """F-number of the lens, ``focal_length/stop_diameter``."""
        return self.focal_length / self.stop_diameter

    @property
    def image_pitch(self) -> float:
        """Side of an image pixel after binning, m."""
        return self.pixel_pitch * self.binning

    def resized(self, size: int) -> Camera:
        """Return a copy of the camera whose binning gives ``size`` image pixels along x.

        Parameters
        ----------
        size : int
            Image pixels along x. ``pixels[0] / size`` must be a whole number that also divides
            ``pixels[1]``.

        Raises
        ------
        SceneError
            If no binning gives this size.
        """
        whole("size", size)
        if self.pixels[0] % size or self.pixels[1] % (self.pixels[0] // size):
            columns, rows = self.pixels
            common = math.gcd(columns, rows)
            fit = [columns // n for n in range(common, 0, -1) if common % n == 0]
            near = sorted(sorted(fit, key=lambda n: abs(math.log(n / size)))[:6])
            raise SceneError(
                f"size = {size} does not divide camera.pixels = {self.pixels} into squares; "
                f"sizes that do: {', '.join(map(str, near))}"
            )
        return replace(self, binning=self.pixels[0] // size)


def pupil_frame(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axes of pupil and image coordinates for a given direction of the optical axis.

    Parameters
    ----------
    axis : ndarray, (3,)
        Unit vector n along the optical axis, world frame.

    Returns
    -------
    ndarray, (3, 3)
        Rows e1 = unit(Y x n), e2 = n x e1 and n, with Y = (0, 1, 0), or (1, 0, 0) if n is
        parallel to Y.

    See Also
    --------
    Camera : Lens and detector.
    nlosoptics.psf.ExitPupil : Position and size of the exit pupil.
    """
    x, y, z = (float(part) for part in axis)
    # products are written out, because `numpy.cross` takes ten times as long
    e1 = np.array([z, 0.0, -x])
    if np.linalg.norm(e1) < 1e-12:
        e1 = np.array([0.0, -z, y])
    a, b, c = (float(part) for part in e1 / np.linalg.norm(e1))
    return np.array([(a, b, c), (y * c - z * b, z * a - x * c, x * b - y * a), (x, y, z)])
