"""Best focus of a wave, and its metrics through focus."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import scipy  # loads scipy.optimize on first use
from numpy.typing import ArrayLike, NDArray

from ..._checks import one_of, positive, real
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..transform.point_spread import point_spread
from ..wave.detilted import split
from ..wave.fits import fitted_terms
from ..wave.wavefront import Wavefront
from .psf_metrics import mtf, rms_aberration, spectrum_along, strehl
from .spot_diagram import spot_radius

Array = NDArray[np.float64]
Criterion = Literal["strehl", "rms", "spot", "mtf"] | Callable[[Wavefront], float]
CRITERIA: Final = ("strehl", "rms", "spot", "mtf")
#: Criteria whose least value is best.
LEAST: Final = ("rms", "spot")

#: Least relative difference: of the criterion over the search, and between its two best maxima.
DISTINCT: Final = 1e-4
#: Largest number of image planes of a scan.
MOST_PLANES: Final = 512
#: Tolerance of the best focus, wavelengths of defocus at the rim of the pupil.
TOLERANCE: Final = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class ThroughFocus(Noun, Shown):
    """Image quality of a wave, such as the Strehl ratio, in several image planes along the axis.

    Parameters
    ----------
    shifts : ndarray
        Displacements of the image plane along the direction of the light, (n,), m, read-only.
    values : ndarray
        Measure of image quality in each plane, (n,), read-only. In m for "rms" and "spot", without
        unit for "strehl" and "mtf".
    criterion : str
        Name of the measure: "strehl", "rms", "spot" or "mtf", or that of a given function.
    wavelength : float
        Vacuum wavelength, m.
    f_number : float
        Working F-number (image distance over pupil diameter) at shift 0.

    See Also
    --------
    through_focus : Computes it.
    best_focus : Displacement of best focus.
    nlosoptics.views.through_focus : Plot of the values.
    """

    shifts: Array
    values: Array
    criterion: str
    wavelength: float
    f_number: float

    @property
    def best(self) -> int:
        """Index of the best plane: smallest "rms" or "spot", largest value of any other measure."""
        return int(np.argmin(self.values) if self.criterion in LEAST else np.argmax(self.values))

    def _figures(self) -> Figures:
        low, high, best = self.shifts.min(), self.shifts.max(), self.best
        rows = {
            "criterion": self.criterion,
            "planes": f"{self.shifts.size}, {1e3 * low:.4g} to {1e3 * high:.4g} mm",
            "best plane": f"{1e3 * self.shifts[best]:.4g} mm, {self.values[best]:.4g}",
            "F-number": f"{self.f_number:.4g}",
        }
        return Figures("Through focus", rows, f"{self.criterion} against the image plane's shift")


def focus_shifted(wavefront: Wavefront, shift: float) -> Wavefront:
    """Return the wave relative to an image plane that is displaced along the axis (defocus).

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`).
    shift : float
        Displacement of the image plane along the direction of the light, m; positive away from the
        lens.

    Returns
    -------
    Wavefront
        Wave with the image distance ``image_distance + shift``. Its aberration is relative to the
        sphere about the point where the axis meets the new image plane.

    Raises
    ------
    SceneError
        If the new image plane would lie in the pupil or on its other side.

    See Also
    --------
    best_focus : Displacement that brings the wave into focus.

    Notes
    -----
    The points (u, v) lie on the reference sphere, at the depth
    ``z = r^2/(d + s sqrt(d^2 - r^2))``, with the image distance d, its sign s, and
    r^2 = u^2 + v^2. With d' = d + shift, the aberration W changes to

    ``W' = W - 2 shift z/(d' + s sqrt(d'^2 - 2 shift z))``

    This is the exact difference between the paths from (u, v, z) and from the pupil's centre to
    the new reference point. The paraxial term ``(1/d' - 1/d) r^2/2`` is smaller at the rim by about
    the fraction ``1/(16 N^2)``, with N the F-number. A detector beyond focus has W < 0.

    The tilt is kept, so that a spot off the axis moves in proportion to the image distance. The
    amplitude is not changed; this causes a relative error of about ``r^2 shift/(2 d^3)``.

    Examples
    --------
    A detector 0.4 mm beyond the focus of an F/10 beam, a wave of defocus at the rim:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> beyond = psf.focus_shifted(wave, 0.4e-3)
    >>> print(f"{1e9 * beyond.aberration.min():.0f} nm, Strehl ratio {psf.strehl(beyond):.3f}")
    -497 nm, Strehl ratio 0.000
    """
    d = wavefront.image_distance
    moved = d + real("shift", shift)
    if moved * d <= 0:
        raise SceneError(
            f"shift = {shift:g} m moves the image plane from {d:g} m to {moved:g} m of the pupil, "
            "which must stay on one side of it; give a smaller shift"
        )
    r2 = wavefront.u**2 + wavefront.v**2
    # Corners of a square grid may lie outside the sphere; no light passes there.
    depth = r2 / (d + math.copysign(1.0, d) * np.sqrt(np.maximum(d * d - r2, 0.0)))
    bend = 2 * (moved - d) * depth
    path = wavefront.aberration - bend / (
        moved + math.copysign(1.0, d) * np.sqrt(moved * moved - bend)
    )
    return replace(wavefront, aberration=path, image_distance=moved)


def through_focus(
    wavefront: Wavefront,
    shifts: ArrayLike,
    *,
    criterion: Criterion = "strehl",
    frequency: float | None = None,
    azimuth: float = 0.0,
) -> ThroughFocus:
    """Compute the image quality of a wave in several image planes along the axis.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`).
    shifts : array_like, (n,)
        Displacements of the image plane along the direction of the light, m; positive away from the
        lens.
    criterion : {"strehl", "rms", "spot", "mtf"} or callable
        Measure of image quality:

        - ``strehl``: Strehl ratio; tilt is removed, so that a spot that moves sideways is followed.
        - ``rms``: rms aberration without piston and tilt, m.
        - ``spot``: rms radius of the spot of rays, without diffraction, m.
        - ``mtf``: modulation transfer function at ``frequency``.
        - A function of a `Wavefront` that returns a number, such as
          ``lambda wave: psf.encircled_energy(wave, 5e-6)``.
    frequency : float, optional
        Spatial frequency in the image, cycles per m; required for ``mtf`` and not allowed
        otherwise.
    azimuth : float
        Direction along which the frequency is counted, rad from x toward y.

    Returns
    -------
    ThroughFocus
        Image quality in each plane, (n,), with the shifts in the given order.

    Raises
    ------
    SceneError
        If an option is unknown, missing or out of range.
    SamplingError
        If the samples of a wave with the layout "grid" or "scattered" are too few for the defocus.

    See Also
    --------
    best_focus : Displacement of best focus.
    focus_shifted : Wave for a displaced image plane.

    Examples
    --------
    Strehl ratio 0.2 mm before, in and beyond the focus of an F/10 lens without aberration. It is
    about ``(sin(pi w)/(pi w))^2``, with w the defocus at the rim in wavelengths,
    ``shift/(8 N^2 lambda)``, and the F-number N:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> found = psf.through_focus(wave, [-0.2e-3, 0.0, 0.2e-3])
    >>> print(" ".join(f"{value:.2f}" for value in found.values))
    0.40 1.00 0.41
    """
    name, measure, _ = _metric(criterion, frequency, azimuth)
    planes = np.array(shifts, dtype=np.float64)
    if planes.ndim != 1 or planes.size == 0:
        raise SceneError(f"shifts have shape {planes.shape}; give (n,), m")
    values = np.array([measure(focus_shifted(wavefront, float(s))) for s in planes])
    for array in (planes, values):
        array.setflags(write=False)
    return ThroughFocus(
        shifts=planes,
        values=values,
        criterion=name,
        wavelength=wavefront.wavelength,
        f_number=wavefront.f_number,
    )


def best_focus(
    wavefront: Wavefront,
    *,
    criterion: Criterion = "strehl",
    frequency: float | None = None,
    azimuth: float = 0.0,
    limits: tuple[float, float] | None = None,
) -> float:
    """Find the displacement of the image plane that brings a wave into focus.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`).
    criterion : {"strehl", "rms", "spot", "mtf"} or callable
        Measure of image quality: Strehl ratio, rms aberration, rms radius of the spot of rays, MTF
        at ``frequency``, or a function of a `Wavefront` that returns a number. ``rms`` and ``spot``
        are minimised, all others maximised.
    frequency : float, optional
        Spatial frequency in the image, cycles per m; required for ``mtf`` and not allowed
        otherwise.
    azimuth : float
        Direction along which the frequency is counted, rad from x toward y.
    limits : (float, float), optional
        Smallest and largest shift to search, m. By default the search covers every plane in which
        the wave may be in focus, see Notes.

    Returns
    -------
    float
        Displacement of the image plane along the direction of the light, m, which `focus_shifted`
        takes. It is accurate to ``1e-6 * 8 N^2 lambda``, with the F-number N: a defocus of 1e-6
        wavelengths at the rim.

    Raises
    ------
    SceneError
        If an option is unknown, missing or out of range, or the wave has no focus on the image's
        side of the pupil.
    SamplingError
        If the criterion is constant, has two equally good maxima, or has its maximum at an end of
        the search range, if the search would take more than 512 planes, or if the wave has too few
        samples for it.

    See Also
    --------
    through_focus : Image quality in several image planes.

    Notes
    -----
    The search range is counted in the defocus at the rim of the pupil, ``(1/d' - 1/d) R^2/2``, with
    the pupil's radius R, the image distance d and the shifted one d', m. It is centred on the plane
    of the smallest rms aberration. Its half width is R times the largest slope of the aberration
    without piston, tilt and defocus, plus two wavelengths. Shifted image distances are limited to
    1/8 to 8 times that of the smallest rms aberration.

    The criterion is computed at planes close enough not to miss a maximum of the Strehl ratio or
    the MTF: at least four per wavelength of defocus for the Strehl ratio and for given functions.
    Let D be the difference between the best and the worst value. Every local optimum whose value
    differs from the best one by at most 0.2 D is refined by Brent's method [1]_.

    The Strehl ratio divides the intensity by that of a wave without aberration, focused on the same
    plane. This reference intensity is higher in planes closer to the pupil. At Fresnel numbers of a
    few, the plane of highest intensity is therefore closer to the pupil than the plane of the best
    Strehl ratio.

    References
    ----------
    .. [1] Brent, Algorithms for Minimization without Derivatives, Prentice-Hall, 1973, ch. 5.

    Examples
    --------
    One wavelength of primary spherical aberration is balanced by one wavelength of defocus, a shift
    of ``8 N^2 lambda`` = 0.4 mm:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_function(
    ...     lambda u, v: 500e-9 * ((u**2 + v**2) / 5e-3**2) ** 2,
    ...     wavelength=500e-9,
    ...     pupil_radius=5e-3,
    ...     image_distance=0.1,
    ... )
    >>> shift = psf.best_focus(wave)
    >>> focused = psf.focus_shifted(wave, shift)
    >>> print(f"{1e3 * shift:.2f} mm, {psf.strehl(wave):.2f} to {psf.strehl(focused):.2f}")
    0.40 mm, 0.09 to 0.80
    """
    name, measure, score = _metric(criterion, frequency, azimuth)
    d, radius = wavefront.image_distance, _radius(wavefront)
    unit = wavefront.wavelength
    smooth = criterion in LEAST  # parabolas, up to the spheres' higher orders
    if limits is None:
        low, high = _search_range(wavefront, radius)
    else:
        low, high = _given_range(wavefront, radius, limits)
    periods = 0.0 if smooth else 1.0
    if frequency is not None:
        x = min(unit * abs(d) * frequency / (2 * radius), 0.5)
        periods = max(8 * x * (1 - x), 0.1)
    count = max(17, math.ceil(4 * periods * (high - low) / unit) + 1)
    if count > MOST_PLANES:
        raise SamplingError(
            f"the search for the best {name} takes {count} image planes from shift = "
            f"{_shift(high, radius, d):.3g} m to {_shift(low, radius, d):.3g} m, limit "
            f"{MOST_PLANES}; give narrower limits, or use criterion='spot'"
        )

    def loss(t: float) -> float:
        """Negative score at a defocus, wavelengths at the rim."""
        return -score(measure(focus_shifted(wavefront, _shift(t * unit, radius, d))))

    defocus = np.linspace(low / unit, high / unit, count)
    losses = np.array([loss(t) for t in defocus.tolist()])
    least, spread = float(losses.min()), float(np.ptp(losses))
    where = f"from shift = {_shift(high, radius, d):.3g} m to {_shift(low, radius, d):.3g} m"
    if not spread > DISTINCT * float(np.abs(losses).max()):
        raise SamplingError(
            f"{name} changes by less than {DISTINCT:g} of its value {where}, so that it has no "
            "best focus; use another criterion or frequency, or wider limits"
        )
    if losses[[0, -1]].min() == least:
        raise SamplingError(
            f"{name} is best at the edge of the search {where}; give wider limits around the focus"
        )
    inner = losses[1:-1]
    peaks = (inner <= losses[:-2]) & (inner <= losses[2:]) & (inner <= least + 0.2 * spread)
    found: list[tuple[float, float]] = []
    for i in np.nonzero(peaks)[0]:
        refined = scipy.optimize.minimize_scalar(
            loss,
            bounds=(defocus[i], defocus[i + 2]),
            method="bounded",
            options={"xatol": TOLERANCE},
        )
        found.append((float(refined.fun), float(refined.x)))
    (value, best), *others = sorted(found)
    for other, t in others:
        if abs(t - best) > 0.01 and other - value < DISTINCT * abs(value):
            raise SamplingError(
                f"{name} has two best foci, at shift = {_shift(best * unit, radius, d):.4g} m and "
                f"{_shift(t * unit, radius, d):.4g} m, which differ by less than {DISTINCT:g} of "
                "its value; give limits around one of them, or use criterion='rms'"
            )
    return _shift(best * unit, radius, d)


def _metric(
    criterion: Criterion, frequency: float | None, azimuth: float
) -> tuple[str, Callable[[Wavefront], float], Callable[[float], float]]:
    """Return the name of a criterion, its value for a wave, and the score of a value.

    Larger scores are better. Squares make them parabolas or band-limited functions of defocus.
    """
    if criterion != "mtf" and (frequency is not None or azimuth != 0):
        raise SceneError(
            f"frequency = {frequency!r}, azimuth = {azimuth!r} without criterion='mtf'; leave them "
            "out"
        )
    if callable(criterion):
        return (
            getattr(criterion, "__name__", "criterion"),
            lambda wave: real("criterion(wavefront)", criterion(wave)),
            lambda value: value,
        )
    one_of("criterion", criterion, CRITERIA)
    if criterion == "strehl":
        return criterion, _strehl, lambda value: value
    if criterion == "mtf":
        if frequency is None:
            raise SceneError("frequency is missing, criterion = 'mtf' needs it; give it, 1/m")
        at, along = positive("frequency", frequency, unit="1/m"), real("azimuth", azimuth)
        return criterion, lambda wave: _mtf(wave, at, along), lambda value: value**2
    measure = rms_aberration if criterion == "rms" else spot_radius
    return criterion, measure, lambda value: -(value**2)


def _strehl(wavefront: Wavefront) -> float:
    """Return the Strehl ratio without tilt; refuse grids and scattered nodes that alias."""
    if not wavefront.is_spectral and (jump := split(wavefront).grid_jump()[0]) > 0.5:
        raise SamplingError(
            f"aberration jumps {jump:.2f} waves between neighbours in the image plane at "
            f"{wavefront.image_distance:.6g} m, limit 0.50; give shifts or limits nearer to focus, "
            "or more pupil samples"
        )
    return strehl(wavefront, remove=("tilt",))


def _mtf(wavefront: Wavefront, frequency: float, azimuth: float) -> float:
    """Return the MTF at one frequency, 1/m, for any outline of the pupil."""
    if wavefront.layout == "polar" and wavefront.obscuration == 0:
        return float(mtf(wavefront, frequency, azimuth=azimuth))
    # One method for all planes: a change would make the criterion jump by its error. The energy
    # in the whole plane is 1, so energy outside the window does not raise the result.
    method: Literal["fft", "nufft", "quadrature"] = "quadrature"
    if not wavefront.is_spectral:
        method = "fft" if wavefront.layout == "grid" else "nufft"
    spread = point_spread(wavefront, method=method)
    return float(np.abs(spectrum_along(spread, np.array([frequency]), azimuth))[0])


def _radius(wavefront: Wavefront) -> float:
    """Return the largest distance of a lit node from the centroid of the amplitude, m."""
    weights = wavefront.amplitude * wavefront.weights
    u, v = (p - float(np.sum(weights * p) / np.sum(weights)) for p in (wavefront.u, wavefront.v))
    return float(np.hypot(u, v)[weights > 0].max())


def _shift(defocus: float, radius: float, distance: float) -> float:
    """Return the shift of the image plane, m, that adds a defocus at the rim, m."""
    bend = 2 * defocus * distance / radius**2
    return -distance * bend / (1 + bend)


def _given_range(
    wavefront: Wavefront, radius: float, limits: tuple[float, float]
) -> tuple[float, float]:
    """Return the defocus at the rim, m, at the largest and the least shift to search."""
    d = wavefront.image_distance
    try:
        first, last = (real("limits", limit) for limit in limits)
    except (TypeError, ValueError) as error:
        raise SceneError(f"limits = {limits!r}; give the least and the largest shift, m") from error
    if not first < last or min((d + first) * d, (d + last) * d) <= 0:
        raise SceneError(
            f"limits = ({first:g}, {last:g}) m must increase and keep the image plane at {d:g} m "
            "on its side of the pupil; give others"
        )
    low, high = (-(radius**2) * s / (2 * d * (d + s)) for s in (last, first))
    return low, high


def _search_range(wavefront: Wavefront, radius: float) -> tuple[float, float]:
    """Return the least and largest defocus at the rim, m, that a search covers by default."""
    u, v = wavefront.u / radius, wavefront.v / radius
    basis = np.stack([np.ones_like(u), u, v, u**2 + v**2])
    fit = fitted_terms(wavefront.aberration, wavefront.amplitude * wavefront.weights, basis)
    rest = split(replace(wavefront, aberration=wavefront.aberration - np.tensordot(fit, basis, 1)))
    middle = -float(fit[3])
    half = radius * rest.rays.slope + 2 * wavefront.wavelength
    vergence = 1 + 2 * middle * wavefront.image_distance / radius**2
    if vergence <= 0:
        raise SceneError(
            f"the wave's defocus of {-middle / wavefront.wavelength:.3g} waves at the rim leaves "
            f"no focus on the side of the image plane at {wavefront.image_distance:g} m; give "
            "another image_distance"
        )
    # Image distances from an eighth to eight times that of the least rms, for weak pupils.
    ends = [
        (share * vergence - 1) * radius**2 / (2 * wavefront.image_distance)
        for share in (0.125, 8.0)
    ]
    return max(middle - half, min(ends)), min(middle + half, max(ends))
