"""Mean point spread of a rough wall, without drawing one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import ducc0
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import fits_memory, in_range, one_of, positive
from ..errors import SamplingError
from ..scene import Scene
from .point_spreads import NORMALISATIONS, Normalisation, PointSpread, point_spread
from .residuals import Residual, split
from .rough_views import RoughView, rough_view
from .roughness import Roughness
from .transfers import Transfer, transfer
from .wavefronts import Wavefront
from .windows import WIDEST_DEFAULT, Window, check_rays, default_shape, shape_of

Array = NDArray[np.float64]

#: Share of the diffuse transfer function's height that is left out.
CUT: Final = 1e-13
#: Times that the separations are refined by half before giving up.
ROUNDS: Final = 5
#: Rayleigh parameter beyond which the smooth core, exp(-s^2), is below rounding.
ALL_DIFFUSE: Final = 6.2
EPSILON: Final = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True)
class RoughPointSpread(PointSpread):
    """Mean image of a point by a rough wall, over all walls of the same statistics.

    Parameters
    ----------
    coherent : ndarray
        (ny, nx), read-only: the part of ``intensity`` in the smooth core, which has the shape of
        the smooth wall's point spread; the rest is `diffuse`.
    rayleigh_parameter : float
        ``s = k (cos_i + cos_o) height_rms``, rad: rms of the phase that the heights give.
    """

    coherent: Array
    rayleigh_parameter: float

    def __post_init__(self) -> None:
        super().__post_init__()
        coherent = np.array(self.coherent, dtype=np.float64, order="C")
        coherent.setflags(write=False)
        object.__setattr__(self, "coherent", coherent)

    @property
    def diffuse(self) -> Array:
        """The part of ``intensity`` that the roughness scatters."""
        return self.intensity - self.coherent

    @property
    def coherent_fraction(self) -> float:
        """``exp(-s^2)``, the share of the light in the smooth core."""
        return math.exp(-(self.rayleigh_parameter**2))

    @property
    def total_integrated_scatter(self) -> float:
        """``1 - exp(-s^2)``, the share that is scattered, into any angle."""
        return -math.expm1(-(self.rayleigh_parameter**2))


@dataclass(frozen=True, eq=False)
class Halo:
    """What the sum over separations needs."""

    residual: Residual
    smooth: Transfer
    view: RoughView
    window: Window
    pixel_integrated: bool

    @property
    def per_metre(self) -> float:
        """Radians per metre of separation and of image."""
        wave = self.residual.wavefront
        return 2 * math.pi / (wave.wavelength * wave.image_distance)

    def counts(self) -> tuple[int, int]:
        """Lags and half-circle directions, for waves over the window."""
        x, y = self.window.reach_from(self.residual.shift)
        directions = math.pi * np.arange(64) / 64
        widest = float(np.hypot(*self._separations(directions, np.ones(1))[:2]).max())
        v = abs(self.per_metre) * math.hypot(x, y) * widest
        return math.ceil(0.55 * v + 64), math.ceil((v + 12 * v ** (1 / 3) + 48) / 2)

    def intensity(self, n_lags: int, n_directions: int) -> tuple[Array, float]:
        """Diffuse light of each sample, the whole plane 1, and what an error of 1 would do."""
        fits_memory(
            f"{n_lags} x {n_directions} separations to {self.window.shape} samples",
            250.0 * n_lags * n_directions + 80.0 * math.prod(self.window.shape),
            "use a smaller shape",
        )
        wave, pitch = self.residual.wavefront, self.window.pitch
        theta = ducc0.misc.GL_thetas(n_lags)
        tau = np.sin(theta / 2) ** 2
        weight = ducc0.misc.GL_weights(n_lags, 1) / (4 * math.pi)
        directions = math.pi * np.arange(n_directions) / n_directions
        # denser toward the pupil's diameter, where the transfer function ends as a power 3/2
        share = tau * (2 - tau)
        du, dv, lag, last = self._separations(directions, share)
        area = lag * last * (2 * (1 - tau) * weight)[:, None] * (math.pi / n_directions)
        area /= abs(float(np.linalg.det(self.view.footprint)))
        factor = 2 * area * self.view.diffuse_transfer(lag)
        factor *= (pitch / (wave.wavelength * wave.image_distance)) ** 2
        if self.pixel_integrated:
            turns = self.per_metre * pitch / (2 * math.pi)
            factor = factor * np.sinc(turns * du) * np.sinc(turns * dv)
        ny, nx = self.window.shape
        x = self.window.first[0] + (nx // 2) * pitch - self.residual.shift[0]
        y = self.window.first[1] + (ny // 2) * pitch - self.residual.shift[1]
        points = factor * self.smooth.at(du, dv)
        points = points * np.exp(-1j * self.per_metre * (x * du + y * dv))
        coord = np.stack([dv.ravel(), du.ravel()], axis=1) * (self.per_metre * pitch)
        image = np.empty(self.window.shape, dtype=np.complex128)
        ducc0.nufft.nu2u(
            points=points.ravel(), coord=coord, forward=True, epsilon=EPSILON, nthreads=1, out=image
        )
        # opposite separations are each other's conjugate
        return np.ascontiguousarray(image.real), float(np.abs(factor).sum())

    def _separations(self, directions: Array, share: Array) -> tuple[Array, Array, Array, Array]:
        """Separations at shares of the last lag each way, their lags, and the last lags."""
        units = np.stack([np.cos(directions), np.sin(directions)])
        back = np.linalg.solve(self.view.footprint, units)
        last = np.minimum(self.view.last_lag(CUT), self.smooth.reach / np.hypot(*back))
        lag = share[:, None] * last
        return lag * back[0], lag * back[1], lag, last


def mean_point_spread(
    source: Wavefront | Scene,
    roughness: Roughness,
    *,
    footprint: ArrayLike | None = None,
    cos_sum: float | None = None,
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> RoughPointSpread:
    """Mean point spread over all rough walls of the same statistics, in closed form.

    Parameters
    ----------
    source : Wavefront or Scene
        The wave of the smooth wall; or the scene it is computed from, whose wall is the mean one.
    roughness : Roughness
    footprint : float or array_like (2, 2), optional
        M, from a step in the exit pupil to the step seen in the wall; ``d1/(d1 + d2)`` at normal
        incidence. Needed with a wavefront, taken from `wall_view` with a scene.
    cos_sum : float, optional
        Sum of the cosines of incidence and exitance, above 0 to 2; as ``footprint``.
    tol : float
        Largest error of the result, relative to its peak.
    pitch : float, optional
        Image sampling or pixel side, m. Default a quarter of lambda N.
    shape : int or (int, int), optional
        (ny, nx). Default at least 256 a side with all rays, their tails and the halo inside.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        As of `point_spread`. The whole plane carries what the smooth wall sends.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.

    Returns
    -------
    RoughPointSpread

    Raises
    ------
    SceneError
        If ``footprint`` or ``cos_sum`` is missing, or given with a scene.
    SamplingError
        As of `point_spread`, or if the sum over separations does not reach ``tol``.

    Notes
    -----
    ``OTF_mean(d) = OTF_0(d) exp(-s^2 [1 - C(M d)])``, d the separation of exit-pupil points [1]_:
    exact for a thin screen of Gaussian heights in first order, large against the footprint; without
    shadowing or multiple scattering, so not for white foam. The plateau ``exp(-s^2)`` is the smooth
    point spread; the rest is summed over lags M d with nodes of their own, which resolve a C that
    is narrow against the pupil, and is exact in a window of any size.

    References
    ----------
    .. [1] Goodman, Statistical Optics, 2nd ed., sec. 8.3.
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    wave, view = rough_view(source, roughness, footprint, cos_sum)
    residual = split(wave)
    pitch, shape = image_sampling(residual, view, pitch, shape)
    check_rays(residual, pitch, shape)
    core = None
    if view.rayleigh_parameter < ALL_DIFFUSE:
        core = point_spread(
            wave, tol=tol, pitch=pitch, shape=shape, pixel_integrated=pixel_integrated
        )
    share = math.exp(-(view.rayleigh_parameter**2))
    coherent = np.zeros(shape) if core is None else share * core.intensity
    smooth = transfer(residual)
    halo = Halo(residual, smooth, view, Window.centred(pitch, shape), pixel_integrated)
    diffuse, error = converged(halo, coherent, tol)
    total = coherent + diffuse
    peak = float(total.max())
    if core is not None:
        error += core.error_estimate * float(coherent.max()) / peak
    if error > tol:
        raise SamplingError(
            f"the mean of the rough wall reaches an error of {error:.2g}, limit tol = {tol:g}; use "
            f"tol = {error:.2g}, or more pupil nodes"
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
        normalisation=normalisation,
        wavelength=wave.wavelength,
        f_number=wave.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(total.sum()),
        rayleigh_parameter=view.rayleigh_parameter,
    )


def image_sampling(
    residual: Residual,
    view: RoughView,
    pitch: float | None,
    shape: int | tuple[int, int] | None,
) -> tuple[float, tuple[int, int]]:
    """Pitch and shape, given or by default."""
    if pitch is None:
        pitch = min(residual.airy_unit / 4, residual.nyquist_pitch / 2)
    pitch = positive("pitch", pitch, unit="m")
    if shape is not None:
        return pitch, shape_of(shape)
    n = default_shape(residual, pitch)[0]
    halo = view.halo(residual.wavefront)
    n = max(n, n - 256 + 2 * math.ceil(halo / pitch))
    if n > WIDEST_DEFAULT:
        raise SamplingError(
            f"the halo reaches {halo:.3g} m from the axis, {n} samples of {pitch:.3g} m across, "
            f"limit {WIDEST_DEFAULT}; give a wider pitch with pixel_integrated=True, or a shape"
        )
    return pitch, (n, n)


def converged(halo: Halo, coherent: Array, tol: float) -> tuple[Array, float]:
    """Diffuse part with as many separations as it takes, and its error relative to the peak."""
    if halo.view.rayleigh_parameter == 0:
        return np.zeros(halo.window.shape), 0.0
    n_lags, n_directions = halo.counts()
    coarse, _ = halo.intensity(math.ceil(0.7 * n_lags), math.ceil(0.7 * n_directions))
    error = math.inf
    for _ in range(ROUNDS):
        fine, per_error = halo.intensity(n_lags, n_directions)
        peak = float(np.max(coherent + fine))
        # what the coarser nodes miss bounds what these do
        missed = float(np.abs(fine - coarse).max())
        error = (missed + per_error * halo.smooth.error) / peak + 10 * EPSILON
        if missed <= 0.1 * tol * peak:
            break
        coarse = fine
        n_lags, n_directions = math.ceil(1.5 * n_lags), math.ceil(1.5 * n_directions)
    return fine, error
