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
    """Complex scalar field, sampled on a plane z = const.

    Parameters
    ----------
    samples : array_like, (ny, nx)
        Complex amplitudes, converted to complex128 and read-only. Row 0 is at the lowest y, and
        sample [ny//2, nx//2] is on the axis. Time dependence exp(-i omega t): a wave that
        travels along +z has the phase exp(+ikz).
    pitch : float
        Distance between samples along x and y, m.
    wavelength : float
        Wavelength in the medium, m.
    z : float
        Position of the plane, m.
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
        """Sample a function of x and y.

        Parameters
        ----------
        function : callable
            Returns complex amplitudes for x (1, nx) and y (ny, 1), m.
        pitch : float
            Distance between samples, m.
        shape : int or (int, int)
            Number of samples (ny, nx); one number means a square.
        wavelength, z, periodic
            As in the constructor.

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
        """Coordinates of the columns, (nx,), m."""
        return Window.centred(self.pitch, self.shape).x

    @property
    def y(self) -> Array:
        """Coordinates of the rows, (ny,), m."""
        return Window.centred(self.pitch, self.shape).y

    @property
    def intensity(self) -> Array:
        """Squared modulus of the samples, (ny, nx)."""
        return np.asarray(self.samples.real**2 + self.samples.imag**2)

    @property
    def power(self) -> float:
        """Sum of the intensity times the cell area, m^2 times the unit of the intensity."""
        return float(self.intensity.sum()) * self.pitch**2

    @property
    def sampling_error(self) -> float:
        """Estimated relative rms difference between a continuous wave and these samples.

        It covers aliasing (spatial frequencies above 1/(2 pitch)) and, unless the field is
        periodic, the part of the wave outside the window. Each of these energies is estimated as
        ten times the energy in the outer tenth of the frequency band or of the window. This is an
        upper estimate for densities that fall as 1/f^2 or faster, such as the spectrum of a hard
        edge. Aliased energy counts twice, since it is also added at wrong frequencies.
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
    """Scalar field after propagation, with the method that computed it and its errors.

    Both errors refer to this propagation only. They are relative rms errors over the output
    window, ``sqrt(sum |dU|^2/sum |U|^2)``.

    Parameters
    ----------
    samples, pitch, wavelength, z, periodic
        As in `ScalarField`.
    method : str
        Method that computed the field.
    error_estimate : float
        Bound of the numerical error: aliasing, wrap-around and truncation. The reference is the
        exact propagation, by the kernel of the method, of the band-limited wave that the input
        samples define. `ScalarField.sampling_error` states how well they define it.
    model_error : float
        Bound of the error of the Fresnel approximation; 0 for the angular spectrum.
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
