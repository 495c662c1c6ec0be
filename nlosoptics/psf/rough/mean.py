"""Mean point spread function of a rough wall in closed form, without random samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import fits_memory, in_range, one_of, positive
from ..._vectors import Array
from ...errors import SamplingError
from ...scene import Scene
from ..pupil.scene_optics import SceneOptics
from ..transform.models import in_normalisation, wide_pixel_error
from ..transform.point_spread import (
    NORMALISATIONS,
    Normalisation,
    PointSpread,
    point_spread,
)
from ..transform.wide_pixels import detilted_wide_spread
from ..wave.detilted import Residual
from ..wave.regime import regime
from ..wave.wavefront import Wavefront
from ..window.error_bounds import rounded_up
from ..window.window import WIDEST_DEFAULT, Window, check_rays, default_shape, shape_of
from .relief import Relief
from .roughness import Roughness
from .scattered_light import EPSILON, PIXEL_BYTES, Scattering
from .source import rough_source
from .view import RoughView

#: Energy fraction of the smooth core below which it is left out, since it is below rounding.
NO_CORE: Final = 2e-17


@dataclass(frozen=True, eq=False, kw_only=True)
class RoughPointSpread(PointSpread):
    """Point spread function of a rough wall, divided into a sharp core and a diffuse halo.

    It has all fields of `PointSpread`, and the following.

    Parameters
    ----------
    coherent : ndarray, (ny, nx)
        Part of ``intensity`` that the wall reflects like a smooth mirror (the core), read-only. The
        rest is `diffuse`.
    rayleigh_parameter : float
        Rms phase s that the heights add to the wave, rad: ``s = k (cos_i + cos_o) height_rms``,
        with k = 2 pi/wavelength and the cosines of the angles of incidence and reflection.
    coherent_fraction : float, optional
        Fraction of the energy in the core, 0 to 1. Default ``exp(-s^2)``, which holds for Gaussian
        heights.

    See Also
    --------
    mean_point_spread : Mean PSF over all walls of one roughness.
    """

    coherent: Array
    rayleigh_parameter: float
    coherent_fraction: float = math.nan
    _images = ("intensity", "coherent")

    def __post_init__(self) -> None:
        super().__post_init__()
        if math.isnan(self.coherent_fraction):
            found = math.exp(-(self.rayleigh_parameter**2))
            object.__setattr__(self, "coherent_fraction", found)

    @property
    def diffuse(self) -> Array:
        """Part of ``intensity`` that the roughness scatters (the halo), (ny, nx)."""
        return self.intensity - self.coherent


def mean_point_spread(
    source: Wavefront | Scene | SceneOptics,
    roughness: Roughness | Relief,
    *,
    footprint: ArrayLike | None = None,
    cos_sum: float | None = None,
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> RoughPointSpread:
    """Compute the mean point spread function (PSF) of rough walls, without random samples.

    It consists of a sharp core, like the PSF of a smooth wall, and a halo of light that the
    roughness scatters.

    Parameters
    ----------
    source : Wavefront, Scene or SceneOptics
        Wave that the wall without roughness gives; or a scene, from which wave and geometry are
        computed (once for all calls that share a `SceneOptics`). The pupil of a scene is sampled as
        finely as ``tol`` requires.
    roughness : Roughness, FacetWall, GaussianWall or HeightMapWall
        Statistics of the wall's heights. For a `FacetWall` or `GaussianWall` the mean is over all
        seeds. A height map is replaced by Gaussian heights with the same rms height and rms slope.
    footprint : float or array_like (2, 2), optional
        Matrix M: seen from a pupil point displaced by (du, dv), the object's light comes from a
        wall point displaced by M (du, dv), in steps along two tangents of the wall, see `WallView`.
        A number stands for a multiple of the unit matrix. For a flat wall at normal incidence it is
        ``d1/(d1 + d2)``, with d1 and d2 the distances from the wall to object and lens. Required
        with a wavefront, not allowed with a scene.
    cos_sum : float, optional
        Sum of the cosines of the angles of incidence and reflection at the wall, above 0 and at
        most 2. Required with a wavefront, not allowed with a scene.
    tol : float
        Largest permitted error of the intensity, relative to its peak; above 0, at most 1.
    pitch : float, optional
        Distance between image samples, or pixel side, m. Default lambda N/4, with the wavelength
        lambda and the F-number N.
    shape : int or (int, int), optional
        Samples or pixels (ny, nx); one number means a square. By default at least 256 per side, and
        enough for all rays, a margin of 16 lambda N for diffraction, and the scattered light.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1: the energy in the whole image plane, the peak of the smooth
        wall without aberration, or the energy that a clear disc of the pupil's radius transmits.
        Roughness does not change the energy in the whole plane.
        With "unit-sum" and "flux", values are energies per pixel: the intensity times ``pitch^2``.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.

    Returns
    -------
    RoughPointSpread
        Mean intensity (ny, nx), row 0 at the lowest y, with its core and an error estimate.

    Raises
    ------
    SceneError
        If ``footprint`` or ``cos_sum`` is missing, or given with a scene.
    SamplingError
        If ``tol`` cannot be reached, or the window is too narrow for the rays.

    See Also
    --------
    sample_point_spread : Speckle pattern of one random wall.

    Notes
    -----
    Roughness multiplies the optical transfer function (OTF) of the smooth wall by a factor [1]_::

        OTF_mean(d) = OTF_smooth(d) exp(-s^2 [1 - C(M d)])

    Here d is the distance (vector) between two points of the exit pupil, s the rms phase
    (``rayleigh_parameter``), C the autocorrelation of the heights and M the ``footprint``. At large
    d the factor is ``exp(-s^2)``; this constant part gives the core. The remainder gives the halo,
    by a Fourier integral over d, with as many points d as the window requires.

    The formula holds for any s. It assumes that the path changes in proportion to the heights, that
    the heights are Gaussian, and that the wall is large compared with the area that the pupil sees.
    It neglects shadowing and multiple scattering. It therefore does not hold for materials such as
    white foam.

    References
    ----------
    .. [1] Goodman, Statistical Optics, 2nd ed., sec. 8.3.

    Examples
    --------
    Heights of 50 nm rms leave 37 % of the energy in the sharp core:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=632.8e-9, pupil_radius=12.5e-3, image_distance=1.0
    ... )
    >>> rough = psf.Roughness(height_rms=50e-9, correlation_length=2e-3)
    >>> mean = psf.mean_point_spread(wave, rough, footprint=0.5, cos_sum=2.0, shape=65)
    >>> print(f"s = {mean.rayleigh_parameter:.3f} rad, core {mean.coherent_fraction:.3f}")
    s = 0.993 rad, core 0.373
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    smooth = rough_source(source, roughness, footprint, cos_sum)
    step, size = image_sampling(smooth.residual, smooth.view, pitch, shape)
    return smooth.refined(
        lambda residual: detilted_mean(
            residual,
            smooth.view,
            tol,
            step,
            size,
            normalisation=normalisation,
            pixel_integrated=pixel_integrated,
        )
    )


def detilted_mean(
    residual: Residual,
    view: RoughView,
    tol: float,
    pitch: float,
    shape: tuple[int, int],
    *,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> RoughPointSpread:
    """Compute `mean_point_spread` for a wave already split into piston, tilt and residual."""
    wave = residual.wavefront
    fits_memory(
        f"a point spread of {shape[0]} x {shape[1]} samples",
        PIXEL_BYTES * shape[0] * shape[1],
        "use a larger tol or wider pixels",
    )
    core, part = None, tol
    share = view.coherent_fraction
    if share > NO_CORE:
        if pixel_integrated:
            core = detilted_wide_spread(residual, pitch, shape, tol)
        else:
            core = point_spread(residual, tol=tol, pitch=pitch, shape=shape, model="scalar")
        part = max(tol - core.error_estimate, tol / 10)  # the errors of both add
    coherent = np.zeros(shape) if core is None else share * core.intensity
    diffuse, error = np.zeros(shape), 0.0
    if view.rayleigh_parameter > 0:
        halo = Scattering(residual, view, Window.centred(pitch, shape), pixel_integrated, part)
        diffuse, error = halo.run(coherent)
    # A mean of intensities is at least 0; negative values are within the error.
    total = np.maximum(coherent + diffuse, 0.0)
    peak = float(total.max())
    error = error / peak + 10 * EPSILON
    model_error = wide_pixel_error(residual) * float(diffuse.max()) / peak
    if core is not None:
        error += core.error_estimate * float(coherent.max()) / peak
        model_error += core.model_error * float(coherent.max()) / peak
    if error > tol:
        raise SamplingError(
            f"the mean over rough walls has an error of {error:.2g}, limit tol = {tol:g}; use "
            f"tol = {rounded_up(1.5 * error)}, or a wavefront of more pupil nodes"
        )
    scale = {
        "unit-sum": 1.0,
        "flux": wave.flux,
        "ideal-peak": 1 / residual.pixel_share(pitch),
    }[normalisation]
    return RoughPointSpread(
        intensity=total * scale,
        coherent=coherent * scale,
        pitch=pitch,
        method="separations" if core is None else f"{core.method} + separations",
        error_estimate=error,
        model_error=in_normalisation(residual, model_error, normalisation),
        normalisation=normalisation,
        wavelength=wave.wavelength,
        f_number=wave.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(total.sum()),
        rayleigh_parameter=view.rayleigh_parameter,
        coherent_fraction=share,
        regime=regime(residual, pitch, rayleigh_parameter=view.rayleigh_parameter),
        reason=_reason(view, core),
    )


def _reason(view: RoughView, core: PointSpread | None) -> str:
    """Return the text of `PointSpread.reason`: methods of halo and core."""
    s = view.rayleigh_parameter
    if s == 0:
        halo = "the wall is smooth"
    else:
        halo = f"halo of {100 * view.scattered_fraction:.3g} % of the energy, s = {s:.3g} rad"
    if core is None:
        return f"{halo}; no core: its energy is below rounding"
    return f"{halo}; core: {core.reason}"


def image_sampling(
    residual: Residual,
    view: RoughView,
    pitch: float | None,
    shape: int | tuple[int, int] | None,
) -> tuple[float, tuple[int, int]]:
    """Return the pitch, m, and the shape (ny, nx), checked if given, by default otherwise.

    Raises `SamplingError` if a given window loses rays, or the default window is too large.
    """
    if pitch is None:
        pitch = min(residual.airy_unit / 4, residual.nyquist_pitch / 2)
    pitch = positive("pitch", pitch, unit="m")
    if shape is not None:
        shape = shape_of(shape)
        check_rays(residual, pitch, shape)
        return pitch, shape
    n = default_shape(residual, pitch)[0]
    halo = view.halo(residual.wavefront)
    n = max(n, n - 256 + 2 * math.ceil(halo / pitch))
    if n > WIDEST_DEFAULT:
        raise SamplingError(
            f"the halo reaches {halo:.3g} m from the axis, {n} samples of {pitch:.3g} m across, "
            f"limit {WIDEST_DEFAULT}; give a wider pitch with pixel_integrated=True, or a shape"
        )
    return pitch, (n, n)
