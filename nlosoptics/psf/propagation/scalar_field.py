"""Sampled complex fields on planes, before and after propagation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..._checks import positive, real
from ..._nouns import Noun
from ...errors import SceneError
from ..window.window import Window, shape_of

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class ScalarField(Noun):
    """Complex scalar field of a light wave, sampled on a plane of constant z.

    Parameters
    ----------
    samples : array_like, (ny, nx)
        Complex amplitudes; they are stored as read-only complex128. Row 0 is at the lowest y, and
        sample [ny//2, nx//2] is at x = y = 0. A wave that travels along +z has the phase exp(+ikz)
        (time dependence exp(-i omega t)).
    pitch : float
        Distance between samples along x and y, m.
    wavelength : float
        Wavelength in the medium, m.
    z : float
        Position of the plane along the z axis, m.
    periodic : bool
        Whether the samples are one period of a periodic field, such as a grating. Otherwise the
        field outside the samples is zero.

    Raises
    ------
    SceneError
        If the samples are not a finite two-dimensional array, or another value is out of range.

    See Also
    --------
    propagate : Free-space propagation to a parallel plane.
    PropagatedField : Propagated field with its error bounds.

    Examples
    --------
    Field behind a slit of 0.1 x 0.8 mm, 256 x 256 samples:

    >>> import numpy as np
    >>> from nlosoptics import psf
    >>> def slit(x, y):
    ...     return (np.abs(x) < 50e-6) * (np.abs(y) < 0.4e-3)
    >>> field = psf.ScalarField.from_function(slit, pitch=5e-6, shape=256, wavelength=500e-9)
    >>> field.shape, f"{field.power:.3g}"
    ((256, 256), '7.55e-08')
    """

    samples: ComplexArray
    pitch: float
    wavelength: float
    z: float = 0.0
    periodic: bool = False

    def __post_init__(self) -> None:
        try:
            samples = np.array(self.samples, dtype=np.complex128, order="C")
        except (TypeError, ValueError):
            raise SceneError("samples are no complex numbers; give an array (ny, nx)") from None
        if samples.ndim != 2 or samples.size == 0:
            raise SceneError(f"samples have the shape {samples.shape}; give an array (ny, nx)")
        bad = np.argwhere(~np.isfinite(samples))
        if bad.size:
            raise SceneError(
                f"samples are not finite at {len(bad)} points, the first is "
                f"[{bad[0, 0]}, {bad[0, 1]}]; replace them by finite values"
            )
        samples.setflags(write=False)
        object.__setattr__(self, "samples", samples)
        object.__setattr__(self, "pitch", positive("pitch", self.pitch, unit="m"))
        object.__setattr__(self, "wavelength", positive("wavelength", self.wavelength, unit="m"))
        object.__setattr__(self, "z", real("z", self.z))

    @classmethod
    def from_function(
        cls,
        function: Callable[[Array, Array], Any],
        *,
        pitch: float,
        shape: int | tuple[int, int],
        wavelength: float,
        z: float = 0.0,
        periodic: bool = False,
    ) -> Self:
        """Make a field by sampling a function of x and y.

        Parameters
        ----------
        function : callable
            Function of coordinate arrays x (1, nx) and y (ny, 1), m, that returns complex
            amplitudes; their shape broadcasts to (ny, nx).
        pitch : float
            Distance between samples along x and y, m.
        shape : int or (int, int)
            Number of samples (ny, nx); one number means a square.
        wavelength : float
            Wavelength in the medium, m.
        z : float
            Position of the plane along the z axis, m.
        periodic : bool
            Whether the samples are one period of a periodic field. Otherwise the field outside the
            samples is zero.

        Returns
        -------
        ScalarField
            Samples (ny, nx) of the function; row 0 is at the lowest y.
        """
        ny, nx = shape_of(shape)
        window = Window.centred(positive("pitch", pitch, unit="m"), (ny, nx))
        samples = np.broadcast_to(function(window.x[None, :], window.y[:, None]), (ny, nx))
        return cls(samples=samples, pitch=pitch, wavelength=wavelength, z=z, periodic=periodic)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of samples (ny, nx)."""
        ny, nx = self.samples.shape
        return ny, nx

    @property
    def x(self) -> Array:
        """Coordinate x of each column, (nx,), m."""
        return Window.centred(self.pitch, self.shape).x

    @property
    def y(self) -> Array:
        """Coordinate y of each row, (ny,), m."""
        return Window.centred(self.pitch, self.shape).y

    @property
    def intensity(self) -> Array:
        """Squared modulus of the samples, (ny, nx)."""
        return np.asarray(self.samples.real**2 + self.samples.imag**2)

    @property
    def power(self) -> float:
        """Integral of the intensity over the plane, unit of the intensity times m^2."""
        return float(self.intensity.sum()) * self.pitch**2

    @property
    def sampling_error(self) -> float:
        """Estimated error of representing a continuous wave by these samples, relative rms.

        The error has two causes: spatial frequencies above 1/(2 pitch) (aliasing), and, unless the
        field is periodic, light outside the sampled area. The energy of each is estimated as ten
        times the energy in the outer tenth of the frequency band or of the sampled area. The
        estimate is too large rather than too small, if the energy density falls at least as fast as
        1/f^2 toward high frequencies f, and as 1/r^2 toward large distances r. The power spectrum
        of a sharp edge falls as 1/f^2, which is just fast enough. Aliased energy counts twice,
        because it also appears at wrong frequencies.
        """
        lost = 20 * _outer(np.abs(np.fft.fftshift(np.fft.fft2(self.samples))) ** 2)
        if not self.periodic:
            lost += 10 * _outer(self.intensity)
        return float(np.sqrt(lost))


def _outer(energy: Array) -> float:
    """Return the fraction of the energy that lies in the outer tenth along either axis."""
    ny, nx = energy.shape
    y, x = (np.abs(np.arange(n) - n // 2) > 0.45 * n for n in (ny, nx))
    total = float(energy.sum())
    return float(energy[y[:, None] | x].sum()) / total if total else 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class PropagatedField(ScalarField):
    """Scalar field after propagation to another plane, with estimates of its errors.

    Errors are the rms error of the complex field, divided by the rms of the field, over the output
    samples. They are upper bounds.

    Parameters
    ----------
    samples : ndarray, (ny, nx)
        Complex amplitudes after propagation, read-only; sample [ny//2, nx//2] is at x = y = 0.
    pitch : float
        Distance between samples along x and y, m.
    wavelength : float
        Wavelength in the medium, m.
    z : float
        Position of the output plane along the z axis, m.
    periodic : bool
        Whether the samples are one period of a periodic field.
    method : str
        Method that computed the field; `propagate` lists them.
    error_estimate : float
        Numerical error of the propagation. The reference is the formula of the method, evaluated
        exactly for the band-limited wave through the input samples. The approximation in the
        formula itself is not included (see ``model_error``). The error of the input samples
        themselves is their `ScalarField.sampling_error`.
    model_error : float
        Error of the Fresnel approximation; 0 for the angular spectrum.
    reason : str
        One line that says why this method was used, and why others were not.

    See Also
    --------
    propagate : Free-space propagation to a parallel plane.
    ScalarField : Sampled complex field on a plane.
    """

    method: str
    error_estimate: float
    model_error: float
    reason: str
