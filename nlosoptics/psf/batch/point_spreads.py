"""Point spread functions of many waves on one pupil, and gradients of functions of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, in_range, one_of, positive, whole
from ..._nouns import Noun
from ..._vectors import product
from ...errors import SamplingError, SceneError
from ..transform.antialiased_fft import SINGLE_ERROR
from ..transform.high_aperture import check_cone
from ..transform.point_spread import NORMALISATIONS, Normalisation, check_nyquist
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from ..window import error_bounds
from ..window.pixels import pixel_rule
from ..window.window import Window, shape_of, square_shape
from .batch_transform import BatchTransform
from .chord_nodes import Need, chord_nodes
from .polar_basis import PolarBasis, SmoothModes, magnitudes

Array = NDArray[np.float64]

#: Accuracy of the sum over nodes, relative to ``tol`` times the field's predicted peak.
AIM = 0.125
#: Largest number of digits to which the sum over nodes is asked to converge.
MOST_DIGITS = 13.0
#: Phase, relative to ``tol``, rad, below which terms of all waves are left out. What they add up to
#: is part of the error estimate.
NEGLIGIBLE = 1e-6
#: Factor on slopes that are found on rings and spokes rather than everywhere.
MARGIN = 1.05
#: Waves whose slopes are computed at a time.
RAYS = 64
#: Smallest peak in an error bound; darker windows are refused.
DARKEST = 1e-100
#: Remedy of batches that are too large for the memory.
FEWER = "give fewer waves at a time, or a smaller shape"


@dataclass(frozen=True, eq=False, kw_only=True)
class PointSpreads(Noun):
    """Point spread functions of many waves that share one pupil, with their errors.

    Parameters
    ----------
    intensity : ndarray
        Intensities (waves, ny, nx), read-only, row 0 at the lowest y. Sample [ny//2, nx//2] is on
        the optical axis.
    error_estimate : ndarray
        Largest error of each point spread relative to its peak, an upper bound, (waves,). The
        reference is the exact image of the wave whose aberration over the pupil is the smooth
        interpolation of the given samples.
    aberration : ndarray
        Aberration of each wave at the sample points of the pupil, (waves, n_r, n_theta), m,
        read-only.
    wavefront : Wavefront
        Wave whose pupil, amplitude, wavelength and image distance all waves share. Its own
        aberration is not used.
    pitch : float
        Distance between samples, or pixel side, m.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1: the energy in the whole image plane, the peak without
        aberration, or the energy that a clear disc of the pupil's radius transmits.
        With "unit-sum" and "flux", values are energies per pixel: the intensity times ``pitch^2``.
    pixel_integrated : bool
        Whether values are means over square pixels, instead of samples at their centres. With
        "unit-sum" and "flux" both are multiplied by the area of a pixel.
    tol : float
        Error that was requested, relative to the peak; all error estimates are below it.
    accuracy : float
        Error of the complex field due to the finite number of quadrature nodes, relative to the
        field's peak without aberration. `aberration_gradient` uses the same accuracy.

    See Also
    --------
    point_spreads : Compute the point spreads of many waves.
    PointSpread : Point spread of one wave.
    """

    intensity: Array
    error_estimate: Array
    aberration: Array
    wavefront: Wavefront
    pitch: float
    normalisation: Normalisation
    pixel_integrated: bool
    tol: float
    accuracy: float

    def __post_init__(self) -> None:
        for array in (self.intensity, self.error_estimate, self.aberration):
            array.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of waves."""
        return len(self.intensity)

    def aberration_gradient(self, intensity_gradient: ArrayLike, *, degree: int = 12) -> Array:
        """Return the gradient of a loss function with respect to the aberrations (backpropagation).

        Parameters
        ----------
        intensity_gradient : array_like
            Derivative of the loss with respect to each value of ``intensity``, (waves, ny, nx).
        degree : int
            Degree of polynomials in the pupil coordinates u and v; by default 12. The gradient is
            valid for changes of the aberration that are polynomials up to this degree.

        Returns
        -------
        ndarray
            Gradient (waves, n_r, n_theta), unit of the loss per m. A small change dW of the
            aberration changes the loss by ``sum(gradient * dW)``. If the aberrations are sums of
            modes (k, n_r, n_theta), the gradient with respect to their coefficients is
            ``einsum("wrt,krt->wk", gradient, modes)``.

        Raises
        ------
        SceneError
            If ``degree`` is below 1.
        SamplingError
            If ``intensity_gradient`` has another shape than ``intensity`` or is not finite, or if
            the wave has too few sample points for polynomials of the degree.
        MemoryLimitError
            If the arrays do not fit into memory.

        Notes
        -----
        The gradient is exact to rounding error, in the precision in which the intensities were
        computed. It takes two to three times as long as the point spreads, because their complex
        fields are computed again.

        The gradient is limited to polynomials because changing the aberration at a single point
        does not give a smooth function. Divided by the area of each node,
        ``gradient/wavefront.weights``, it is a polynomial itself. A gradient step along this
        quotient therefore keeps the wave smooth.

        Examples
        --------
        Derivative of the peak with respect to defocus, at a defocus of 20 nm rms:

        >>> from nlosoptics import psf
        >>> import numpy as np
        >>> wave = psf.Wavefront.from_zernike(
        ...     {4: 1e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
        ... )
        >>> mode = wave.aberration / 1e-9  # of 1 m rms
        >>> spreads = psf.point_spreads(
        ...     wave, 20e-9 * mode[None], shape=33, normalisation="ideal-peak"
        ... )
        >>> of_peak = np.zeros((1, 33, 33))
        >>> of_peak[0, 16, 16] = 1.0
        >>> slope = np.sum(spreads.aberration_gradient(of_peak) * mode)
        >>> print(f"peak {spreads.intensity.max():.4f}, slope {1e-9 * slope:.6f} per nm")
        peak 0.9384, slope -0.006004 per nm
        """
        degree = whole("degree", degree)
        n_r, n_theta = self.wavefront.u.shape
        most = min(2 * n_r - 2, (n_theta - 1) // 2)
        if degree > most:
            raise SamplingError(
                f"degree = {degree}, limit {most} for {n_r} x {n_theta} pupil nodes; give a lower "
                "degree, or waves on more nodes"
            )
        given = _finite("intensity_gradient", intensity_gradient)
        if given.shape != self.intensity.shape:
            raise SamplingError(
                f"intensity_gradient has shape {given.shape}; give {self.intensity.shape}, that of "
                "the intensities"
            )
        batch = _Batch(self.wavefront, self.aberration, self.tol)
        batch.core = self.accuracy
        plan = batch.plan(
            self.pitch,
            (given.shape[1], given.shape[2]),
            self.normalisation,
            self.pixel_integrated,
            further=degree,
        )
        need = 2.0 * self.aberration.nbytes + plan.memory(len(self))
        need += 4.0 * (degree + 1) * (degree + 2) * len(plan.nodes.u)  # polynomials at the nodes
        fits_memory(_told(given.shape), need, FEWER)
        modes = SmoothModes(degree)
        at_nodes = modes.at(plan.nodes.u, plan.nodes.heights)
        parts = plan.gradients(batch.series_of(plan.basis), given, at_nodes)
        return modes.on_nodes(parts, self.wavefront) / self.wavefront.wavelength


def point_spreads(
    wavefront: Wavefront,
    aberrations: ArrayLike,
    *,
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
    out: Array | None = None,
) -> PointSpreads:
    """Compute the point spread functions of many waves that share one round or annular pupil.

    For many waves this is much faster than calling `point_spread` for each.

    Parameters
    ----------
    wavefront : Wavefront
        Wave with the layout "polar" whose pupil, amplitude, wavelength and image distance all waves
        share. Its own aberration is not used.
    aberrations : array_like
        Aberration of each wave at the sample points of ``wavefront``, (waves, n_r, n_theta), m. A
        tilt shifts the spot.
    tol : float
        Largest permitted error of a point spread, relative to its peak; above 0, at most 1.
    pitch : float, optional
        Distance between image samples, or pixel side, m. Default lambda N/4, with the wavelength
        lambda and the F-number N.
    shape : int or (int, int), optional
        Samples or pixels (ny, nx). By default a square that contains all rays of all waves and a
        margin of 16 lambda N for diffraction; without ``pixel_integrated`` it has at least 256
        samples per side. A smaller window is allowed and shows the middle of the image.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1: the energy in the whole image plane, the peak without
        aberration, or the energy that a clear disc of the pupil's radius transmits.
        With "unit-sum" and "flux", values are energies per pixel: the intensity times ``pitch^2``.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.
    out : ndarray, optional
        Array (waves, ny, nx), float64, into which the intensities are written. The result contains
        a read-only view of it, and another call with the same array overwrites that result. By
        default a new array is allocated; reusing one saves time.

    Returns
    -------
    PointSpreads
        Intensities (waves, ny, nx), and an error estimate for each wave.

    Raises
    ------
    SceneError
        If an option is out of range or an array has the wrong shape.
    SamplingError
        If ``wavefront`` has another layout than "polar", the pitch is too wide, or the sample
        points are too few for ``tol``.
    MemoryLimitError
        If the intensities do not fit into memory; raised before they are allocated.

    See Also
    --------
    point_spread : Point spread of one wave, of any layout and by any method.
    nlosoptics.inverse.PupilPSF : Point spread as a torch module.

    Notes
    -----
    The result is that of ``point_spread(model="scalar")``. The pupil is integrated along parallel
    chords, so that the integral becomes two matrix products. They use the mirror symmetry of the
    pupil. Single precision is used where ``tol`` allows it. The waves are computed on all cores;
    the values do not depend on the number of threads.

    All waves are computed with the number of nodes that the steepest one needs. Put waves of very
    different aberration into separate calls.

    Examples
    --------
    Peaks of three waves with 0, 20 and 40 nm rms of defocus, relative to the first:

    >>> from nlosoptics import psf
    >>> import numpy as np
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 1e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> defocus = np.array([0.0, 20e-9, 40e-9])  # m rms
    >>> aberrations = defocus[:, None, None] * wave.aberration / 1e-9
    >>> spreads = psf.point_spreads(wave, aberrations, shape=64, normalisation="ideal-peak")
    >>> spreads.intensity.shape, bool(spreads.error_estimate.max() < 1e-3)
    ((3, 64, 64), True)
    >>> print(spreads.intensity.max(axis=(1, 2)).round(3))
    [1.    0.938 0.772]
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    if not isinstance(wavefront, Wavefront):
        raise SceneError(f"wavefront is a {type(wavefront).__name__}; give a psf.Wavefront")
    if wavefront.layout != "polar":
        raise SamplingError(
            f"wavefront has layout '{wavefront.layout}', limit 'polar' for a batch; sample the "
            "pupil with nodes='polar', or call psf.point_spread for each wave"
        )
    given = np.array(_finite("aberrations", aberrations))  # a copy that stays as it is
    if given.ndim != 3 or given.shape[1:] != wavefront.u.shape or not len(given):
        raise SceneError(
            f"aberrations have shape {given.shape}; give (waves, "
            f"{', '.join(map(str, wavefront.u.shape))}), one or more waves on the wavefront's nodes"
        )
    batch = _Batch(wavefront, given, tol)
    unit = batch.residual.airy_unit
    if pitch is None:
        pitch = min(unit / 4, batch.residual.nyquist_pitch / 2)
    pitch = positive("pitch", pitch, unit="m")
    if not pixel_integrated and normalisation != "ideal-peak":
        check_nyquist(batch.residual, pitch, normalisation)
    batch.check(batch.errors(batch.lost, np.ones(len(given)), pitch, pixel_integrated))
    if shape is None:
        size = square_shape(batch.reach, unit, pitch, 1 if pixel_integrated else 256)
    else:
        size = shape_of(shape)
    sides = len(given), *size
    new = 8.0 * math.prod(sides) if out is None else 0.0
    fits_memory(_told(sides), new, FEWER)
    intensity = np.empty(sides) if out is None else _checked_out(out, sides)
    for last in (False, True):
        plan = batch.plan(pitch, size, normalisation, pixel_integrated)
        fits_memory(_told(sides), new + plan.memory(len(given)), FEWER)
        peaks = plan.intensities(batch.series_of(plan.basis), intensity)
        errors = batch.errors(batch.field_errors, peaks, pitch, pixel_integrated)
        excess = float(errors.max()) / tol
        if excess <= 1 or last:
            break
        # the window is darker than predicted, so that the relative error is larger
        batch.core = max(batch.core / (8 * excess), 10.0**-MOST_DIGITS)
    batch.check(errors)
    return PointSpreads(
        intensity=intensity,
        error_estimate=errors,
        aberration=given,
        wavefront=wavefront,
        pitch=pitch,
        normalisation=normalisation,
        pixel_integrated=pixel_integrated,
        tol=tol,
        accuracy=batch.core,
    )


class _Reach(NamedTuple):
    """Rays of all waves.

    Attributes
    ----------
    slope : float
        Largest gradient of any wave, rad, tilt included.
    spread : ndarray, (waves,)
        Largest deviation of a wave's slopes along u or v from their mean, rad.
    """

    slope: float
    spread: Array


class _Batch:
    """Series of many waves, and what their transform needs.

    Parameters
    ----------
    wave : Wavefront
        Pupil.
    aberrations : ndarray, (waves, n_r, n_theta)
        Aberrations, m.
    tol : float
        Wanted error.
    """

    def __init__(self, wave: Wavefront, aberrations: Array, tol: float) -> None:
        self.wave, self.tol = wave, tol
        self.residual: Residual = split(wave)
        check_cone(self.residual)
        n_r, n_theta = self.counts = (wave.u.shape[0], wave.u.shape[1])
        fits_memory(_told(aberrations.shape), 10.0 * aberrations.nbytes, FEWER)
        self.basis = PolarBasis(n_r, n_theta, wave.obscuration)
        self.series = self.basis.analysed(aberrations / wave.wavelength)
        sizes = 2 * math.pi * magnitudes(self.series, n_theta // 2 + 1)
        total = sizes.sum(axis=(1, 2))
        # the highest terms, as in `PolarSpectrum.truncation`, and rounding error
        n_k, n_m = max(2, n_r // 8), max(4, sizes.shape[2] // 8)
        self.lost = sizes[:, -n_k:].sum(axis=(1, 2)) + sizes[:, :-n_k, -n_m:].sum(axis=(1, 2))
        self.lost += 1e-15 * total
        largest = sizes.max(axis=0)
        self.degree, self.order = _degrees(largest, max(NEGLIGIBLE * tol, 1e-13))
        self.lost += np.maximum(
            total - sizes[:, : self.degree + 1, : self.order + 1].sum(axis=(1, 2)), 0.0
        )
        self.rays = self._rays()
        # light spread evenly over the square in which rays land, and the Airy disc about it
        reach = np.abs(wave.image_distance) * self.rays.spread / self.residual.airy_unit
        peak = float(np.min(4 / math.pi / (2 * reach + 2) ** 2))
        self.core = max(AIM * tol * math.sqrt(peak), 10.0**-MOST_DIGITS)
        self._largest = largest
        if not self.residual.is_uniform:
            self.lost += self.residual.amplitude_series.truncation() / float(wave.amplitude.max())

    @property
    def single(self) -> bool:
        """Whether single precision suffices."""
        return bool(self.core >= SINGLE_ERROR)

    @property
    def field_errors(self) -> Array:
        """Bound of the field's error relative to its ideal peak, (waves,)."""
        return np.asarray(self.lost + self.core + (SINGLE_ERROR if self.single else 0.0))

    @property
    def resolved(self) -> int:
        """Degree of the pupil functions that the nodes must resolve."""
        small = self.core**0.25
        degrees = _degrees(self._largest, small)
        degree = max(2 * degrees[0] + 1, degrees[1])
        if not self.residual.is_uniform:
            degrees = self.residual.amplitude_series.degrees(small)
            degree += max(2 * degrees[0] + 1, degrees[1])
        return degree

    @property
    def reach(self) -> float:
        """Largest distance from the axis at which rays land, m."""
        return self.rays.slope * abs(self.wave.image_distance)

    def series_of(self, basis: PolarBasis) -> list[Array]:
        """Return the series of all waves on a basis of fewer terms."""
        pairs = zip(self.series, basis.orders, strict=True)
        return [np.ascontiguousarray(part[:, : basis.n_k, : len(orders)]) for part, orders in pairs]

    def plan(
        self,
        pitch: float,
        shape: tuple[int, int],
        normalisation: str,
        pixel_integrated: bool,
        *,
        further: int = 0,
    ) -> BatchTransform:
        """Return the transform of the terms that matter to a window.

        It has as many nodes as the steepest wave needs at the farthest image point, for factors of
        the pupil function up to a ``further`` degree.
        """
        wave, residual = self.wave, self.residual
        basis = PolarBasis(*self.counts, wave.obscuration, self.degree, self.order)
        rule, window = None, Window.centred(pitch, shape)
        if pixel_integrated:
            rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
            window = rule.window(pitch, shape)
        x, y = window.reach_from((0.0, 0.0))
        per_slope = residual.wavenumber * wave.pupil_radius
        far = math.hypot(x, y) / abs(wave.image_distance) + self.rays.slope
        along = x / abs(wave.image_distance) + self.rays.slope
        digits = -math.log10(self.core)
        need = Need(per_slope * along, per_slope * far, self.resolved + further, digits)
        nodes = chord_nodes(wave.obscuration, need)
        sizes = np.tile(nodes.weights, (4, 1))
        if not residual.is_uniform:
            terms = self.basis.at(nodes.u, nodes.heights)
            parts = self.basis.analysed(wave.amplitude[None])
            even, u, v, both = (
                np.einsum("k,kn->n", part.ravel(), term)
                for part, term in zip(parts, terms, strict=True)
            )
            sizes *= [
                even + u + v + both,
                even - u + v - both,
                even + u - v - both,
                even - u - v + both,
            ]
        scale = 1.0
        if normalisation != "ideal-peak":
            scale = residual.pixel_share(pitch) * (wave.flux if normalisation == "flux" else 1.0)
        turns = wave.pupil_radius / (wave.wavelength * wave.image_distance)
        sizes /= sizes.sum()
        return BatchTransform(basis, nodes, sizes, turns, window, rule, scale, self.single)

    def errors(self, field: Array, peaks: Array, pitch: float, pixel_integrated: bool) -> Array:
        """Return an upper bound of the error of each wave's image, relative to its peak.

        ``field`` is the error of the complex field and ``peaks`` the largest intensity of each
        wave, (waves,), relative to the peak without aberration. With ``peaks`` of 1 the result is a
        lower bound.
        """
        pixel = pitch / self.residual.airy_unit if pixel_integrated else 0.0
        level = self.residual.pixel_share(pitch)
        return np.array(
            [
                error_bounds.intensity_error(peak, one, one**2, pixel=pixel, level=level)
                for peak, one in zip(
                    np.maximum(peaks, DARKEST).tolist(), field.tolist(), strict=True
                )
            ]
        )

    def check(self, errors: Array) -> None:
        """Refuse waves with too large an error, (waves,)."""
        worst = int(np.argmax(errors))
        if errors[worst] > self.tol:
            raise SamplingError(
                f"aberrations[{worst}] has an error of at least {errors[worst]:.2g} of the peak, "
                f"limit tol = {self.tol:g}; give more pupil nodes per wave (now "
                f"{' x '.join(map(str, self.counts))}), a window that shows the spot, or a larger "
                "tol"
            )

    def _rays(self) -> _Reach:
        """Return the largest slopes, on rings that resolve the series, with a margin."""
        obscuration = self.wave.obscuration
        basis = PolarBasis(*self.counts, obscuration, self.degree, self.order)
        rings = np.linspace(max(obscuration, 0.02), 1.0, basis.n_k + 6)
        spokes = 2 * math.pi * np.arange(3 * self.order + 8) / (3 * self.order + 8)
        rho, angle = (axis.ravel() for axis in np.meshgrid(rings, spokes, indexing="ij"))
        tables = basis.slopes_at(rho, angle)
        series = [part.reshape(len(part), -1) for part in self.series_of(basis)]
        steepest, spread = 0.0, np.zeros(len(series[0]))
        du, dv = np.empty((2, RAYS, rho.size))
        for first in range(0, len(spread), RAYS):
            here = slice(first, min(first + RAYS, len(spread)))
            for table, out in zip(tables, (du, dv), strict=True):
                out[:] = 0.0
                for part, terms in zip(series, table, strict=True):
                    out[: here.stop - first] += product(part[here], terms)
            steepest = max(steepest, float(np.max(du * du + dv * dv)))
            for out in (du, dv):
                off = np.abs(out - out.mean(axis=1, keepdims=True)).max(axis=1)
                spread[here] = np.maximum(spread[here], off[: here.stop - first])
        per_metre = MARGIN * self.wave.wavelength / self.wave.pupil_radius
        return _Reach(per_metre * math.sqrt(steepest), per_metre * spread)


def _degrees(sizes: Array, threshold: float) -> tuple[int, int]:
    """Return the highest degree and order of terms (degrees, orders) above a threshold."""
    degrees, orders = np.nonzero(sizes > threshold)
    return int(degrees.max(initial=0)), int(orders.max(initial=0))


def _told(shape: tuple[int, ...]) -> str:
    """Return what an array of waves is, for a message about memory."""
    return f"a batch of {' x '.join(map(str, shape))} values"


def _finite(name: str, values: ArrayLike) -> Array:
    """Return an array of finite float64 numbers, or raise `SceneError`."""
    try:
        if np.iscomplexobj(values):  # numpy would only warn and drop the imaginary part
            raise TypeError
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{name} is not an array of real numbers; give real values") from None
    # A sum is finite unless a value is not, or it overflows; then look closer.
    if not math.isfinite(float(array.sum())) and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.unravel_index(np.argmin(np.isfinite(array)), array.shape))
        raise SceneError(f"{name} = {array[where]} at {where}; give finite numbers")
    return array


def _checked_out(out: object, shape: tuple[int, ...]) -> Array:
    """Return a view of the array for the intensities after checking it."""
    if not isinstance(out, np.ndarray) or out.dtype != np.float64 or out.shape != shape:
        told = f"{out.dtype} of shape {out.shape}" if isinstance(out, np.ndarray) else type(out)
        raise SceneError(f"out is {told}; give a float64 array of shape {shape}")
    if not out.flags.writeable or not out.flags.c_contiguous:
        raise SceneError("out is read-only or not contiguous; give an array from numpy.empty")
    return out.view()
