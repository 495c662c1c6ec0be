"""Best focus of a wave, and its metrics through focus."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy  # loads scipy.optimize on first use
from numpy.typing import ArrayLike

from ..._checks import expect, numbers, one_of, positive, real
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._vectors import Array
from ...errors import SamplingError, SceneError
from ..transform.point_spread import point_spread
from ..wave.detilted import split
from ..wave.fits import fitted_terms
from ..wave.wavefront import Wavefront
from .psf_metrics import intensity_at, mtf, rms_aberration, spectrum_along
from .spot_diagram import spot_radius

Criterion = Literal["strehl", "rms", "spot", "mtf"] | Callable[[Wavefront], float]
LEAST = ("rms", "spot")  # criteria whose least value is best
#: Least relative difference: of the criterion over the search, and between its two best maxima.
DISTINCT = 1e-4


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
        Wave in the exit pupil, of any ``layout``.
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
    ``W' = W - 2 shift z/(d' + s sqrt(d'^2 - 2 shift z))``, the exact difference of the paths to
    both reference points. A detector beyond focus has W < 0. The tilt and the amplitude are kept;
    the latter causes a relative error of about ``r^2 shift/(2 d^3)``.

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
    wavefront = expect("wavefront", wavefront, "Wavefront")
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
    shifts: ArrayLike | None = None,
    *,
    criterion: Criterion = "strehl",
    frequency: float | None = None,
    azimuth: float = 0.0,
) -> ThroughFocus:
    """Compute the image quality of a wave in several image planes along the axis.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, of any ``layout``.
    shifts : array_like, (n,), optional
        Displacements of the image plane along the direction of the light, m; positive away from the
        lens. By default 33 from -4 to 4 ``wavelength f_number^2``: half a wave at the rim either
        way.
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
    wavefront = expect("wavefront", wavefront, "Wavefront")
    name, measure, _ = _metric(criterion, frequency, azimuth)
    if shifts is None:
        shifts = np.linspace(-4.0, 4.0, 33) * wavefront.wavelength * wavefront.f_number**2
    planes = numbers("shifts", shifts).copy()
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
    wavefront, criterion, frequency, azimuth
        As in `through_focus`. ``rms`` and ``spot`` are minimised, all others maximised.
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
    The default range is centred on the plane of the smallest rms aberration. Its half width, as
    defocus at the rim of the pupil, is the pupil's radius times the largest slope of the aberration
    without piston, tilt and defocus, plus two wavelengths. The criterion is computed at planes
    close enough not to miss a maximum, at least four per wavelength of defocus for the Strehl
    ratio and for given functions. All local optima that come close to the best one are refined.

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
    wavefront = expect("wavefront", wavefront, "Wavefront")
    name, measure, score = _metric(criterion, frequency, azimuth)
    d, unit = wavefront.image_distance, wavefront.wavelength
    weights = wavefront.amplitude * wavefront.weights
    u, v = (p - float(np.sum(weights * p) / np.sum(weights)) for p in (wavefront.u, wavefront.v))
    radius = float(np.hypot(u, v)[weights > 0].max())
    low, high = _search_range(wavefront, radius, limits)

    def shift_of(waves: float) -> float:
        """Shift, m, that adds a defocus at the rim, wavelengths."""
        bend = 2 * waves * unit * d / radius**2
        return -d * bend / (1 + bend)

    def loss(waves: float) -> float:
        """Negative score at a defocus, wavelengths at the rim."""
        return -score(measure(focus_shifted(wavefront, shift_of(waves))))

    periods = 0.0 if criterion in LEAST else 1.0  # those of LEAST are parabolas
    if frequency is not None:
        x = min(unit * abs(d) * frequency / (2 * radius), 0.5)
        periods = max(8 * x * (1 - x), 0.1)
    count = max(17, math.ceil(4 * periods * (high - low) / unit) + 1)
    defocus = np.linspace(low / unit, high / unit, min(count, 513))
    where = f"from shift = {shift_of(defocus[-1]):.3g} m to {shift_of(defocus[0]):.3g} m"
    if count > 512:
        raise SamplingError(
            f"the search for the best {name} takes {count} image planes {where}, limit 512; give "
            "narrower limits, or use criterion='spot'"
        )
    losses = np.array([loss(waves) for waves in defocus.tolist()])
    least, spread = float(losses.min()), float(np.ptp(losses))
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
    optima: list[tuple[float, float]] = []
    for i in np.nonzero(peaks)[0]:
        ends = (defocus[i], defocus[i + 2])
        refined = scipy.optimize.minimize_scalar(
            loss, bounds=ends, method="bounded", options={"xatol": 1e-6}
        )
        optima.append((float(refined.fun), float(refined.x)))
    (value, best), *others = sorted(optima)
    for other, waves in others:
        if abs(waves - best) > 0.01 and other - value < DISTINCT * abs(value):
            raise SamplingError(
                f"{name} has two best foci, at shift = {shift_of(best):.4g} m and "
                f"{shift_of(waves):.4g} m; give limits around one of them, or criterion='rms'"
            )
    return shift_of(best)


def _metric(
    criterion: Criterion, frequency: float | None, azimuth: float
) -> tuple[str, Callable[[Wavefront], float], Callable[[float], float]]:
    """Return the name of a criterion, its value for a wave, and the score of a value.

    Larger scores are better. Squares make them parabolas or band-limited functions of defocus.
    """
    if criterion != "mtf" and (frequency is not None or azimuth != 0):
        raise SceneError("frequency or azimuth without criterion='mtf'; leave them out")
    if callable(criterion):
        return (
            getattr(criterion, "__name__", "criterion"),
            lambda wave: real("criterion(wavefront)", criterion(wave)),
            lambda value: value,
        )
    one_of("criterion", criterion, ("strehl", "rms", "spot", "mtf"))
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
    residual = split(wavefront)
    if (jump := residual.jump()[0]) > 0.5:
        raise SamplingError(
            f"aberration jumps {jump:.2f} waves between neighbours in the image plane at "
            f"{wavefront.image_distance:.6g} m, limit 0.50; give shifts or limits nearer to focus, "
            "or more pupil samples"
        )
    return intensity_at(residual, residual.shift)


def _mtf(wavefront: Wavefront, frequency: float, azimuth: float) -> float:
    """Return the MTF at one frequency, 1/m, for any outline of the pupil."""
    if split(wavefront).is_disc:
        return float(mtf(wavefront, frequency, azimuth=azimuth))
    # One method for all planes: a change would make the criterion jump by its error. The energy
    # in the whole plane is 1, so energy outside the window does not raise the result.
    methods: dict[str, Literal["fft", "nufft"]] = {"grid": "fft", "scattered": "nufft"}
    spread = point_spread(wavefront, method=methods.get(wavefront.layout, "quadrature"))
    return float(np.abs(spectrum_along(spread, np.array([frequency]), azimuth))[0])


def _search_range(
    wavefront: Wavefront, radius: float, limits: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the least and largest defocus at the rim, m, of a search."""
    d = wavefront.image_distance
    if limits is not None:
        first, last = (real("limits", limit) for limit in limits)
        if not first < last or min((d + first) * d, (d + last) * d) <= 0:
            raise SceneError(
                f"limits = ({first:g}, {last:g}) m must increase and keep the image plane at {d:g} "
                "m on its side of the pupil; give others"
            )
        low, high = (-(radius**2) * s / (2 * d * (d + s)) for s in (last, first))
        return low, high
    u, v = wavefront.u / radius, wavefront.v / radius
    basis = np.stack([np.ones_like(u), u, v, u**2 + v**2])
    fit = fitted_terms(wavefront.aberration, wavefront.amplitude * wavefront.weights, basis)
    rest = split(replace(wavefront, aberration=wavefront.aberration - np.tensordot(fit, basis, 1)))
    middle = -float(fit[3])
    half = radius * rest.rays.slope + 2 * wavefront.wavelength
    vergence = 1 + 2 * middle * d / radius**2
    if vergence <= 0:
        raise SceneError(
            f"the wave's defocus of {-middle / wavefront.wavelength:.3g} waves at the rim leaves "
            f"no focus on the side of the image plane at {d:g} m; give another image_distance"
        )
    # Image distances from an eighth to eight times that of the least rms, for weak pupils.
    ends = [(share * vergence - 1) * radius**2 / (2 * d) for share in (0.125, 8.0)]
    return max(middle - half, min(ends)), min(middle + half, max(ends))
