"""Curves of metrics, fit histories, transforms and path lengths; and spot diagrams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import in_range, whole
from ..errors import SamplingError, SceneError
from .canvas import (
    BLUE,
    GREY,
    MARKERS,
    ORANGE,
    SERIES,
    VERMILION,
    new_axes,
    space_ticks,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..inverse import Reconstruction
    from ..psf import Comparison, MetricEstimate, SpotDiagram, ThroughFocus
    from ..raytrace import PathHistogram

Array = NDArray[np.float64]

#: Axis labels (y, x) of each record in a fit's history. Records with equal labels share axes.
RECORDS = {
    "objective": ("objective", "iteration"),
    "residual": ("residual, rms of the noise", "iteration"),
    "change": ("relative change", "iteration"),
    "fourier_error": ("Fourier error", "restart"),
}
WIDE_RANGE = 10.0  # ratio of largest to smallest value above which the scale is logarithmic
FEW = 50  # largest number of values that are drawn with markers


def mtf(
    frequency: ArrayLike,
    along_x: ArrayLike,
    along_y: ArrayLike | None = None,
    *,
    diffraction_limit: ArrayLike | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw cuts through the modulation transfer function along x and y.

    Parameters
    ----------
    frequency : array_like, (n,)
        Spatial frequency in the image, cycles per m.
    along_x, along_y : array_like, (n,)
        Modulation at these frequencies, 0 to 1, from `nlosoptics.psf.mtf` with ``azimuth`` 0 and
        pi/2.
    diffraction_limit : array_like, (n,), optional
        Modulation without aberration, drawn as a dashed line. None: no line.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the modulation from 0 to 1 against the frequency in cycles/mm.

    Raises
    ------
    SamplingError
        If the shape of an array differs from that of ``frequency``, or if values are not finite.

    See Also
    --------
    nlosoptics.psf.mtf : Modulus of the optical transfer function.
    encircled_energy : Curve of the encircled energy.

    Examples
    --------
    >>> from nlosoptics import psf, views
    >>> wave = psf.Wavefront.from_zernike(
    ...     {7: 60e-9}, wavelength=600e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> spread = psf.point_spread(wave, pitch=2e-6, shape=64)
    >>> frequency = [0.0, 25e3, 50e3, 75e3, 100e3]
    >>> along_x, along_y = (psf.mtf(spread, frequency, azimuth=a) for a in (0.0, 1.5708))
    >>> axes = views.mtf(frequency, along_x, along_y)
    >>> axes.get_xlabel()
    'spatial frequency in the image (cycles/mm)'
    """
    places = _samples("frequency", frequency) * 1e-3
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.0, height=4.2)
    if diffraction_limit is not None:
        limit = _samples("diffraction_limit", diffraction_limit, like=places, of="frequency")
        axes.plot(places, limit, color=GREY, linestyle="--", label="diffraction limit")
    cuts = [("along_x", "along x", BLUE, "-"), ("along_y", "along y", VERMILION, "-.")]
    for (name, label, colour, line), given in zip(cuts, (along_x, along_y), strict=True):
        if given is None:
            continue
        values = _samples(name, given, like=places, of="frequency")
        axes.plot(places, values, color=colour, linestyle=line, label=label)
    axes.set(
        xlabel="spatial frequency in the image (cycles/mm)",
        ylabel="modulation",
        ylim=(0.0, 1.02),
        xlim=(float(places.min()), float(places.max())),
        title="modulation transfer function",
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend()
    return axes


def encircled_energy(
    radius: ArrayLike,
    energy: ArrayLike,
    *,
    diffraction_limit: ArrayLike | None = None,
    shares: Sequence[float] = (0.5, 0.8),
    axes: Axes | None = None,
) -> Axes:
    """Draw the energy of a point spread within circles against their radius.

    Parameters
    ----------
    radius : array_like, (n,)
        Radii of the circles, m, in increasing order.
    energy : array_like, (n,)
        Fraction of the energy within each circle, from `nlosoptics.psf.encircled_energy`.
    diffraction_limit : array_like, (n,), optional
        Encircled energy without aberration, drawn as a dashed line. None: no line.
    shares : sequence of float
        Fractions of the energy, above 0 and up to 1. The radius of the circle that contains each
        of them is marked, interpolated linearly.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the fraction of the energy against the radius in um.

    Raises
    ------
    SceneError
        If a value in ``shares`` is out of range.
    SamplingError
        If the shape of an array differs from that of ``radius``, if the radii do not increase, or
        if values are not finite.

    See Also
    --------
    nlosoptics.psf.encircled_energy : Energy within circles.
    mtf : Curves of the MTF.
    """
    radii = _samples("radius", radius) * 1e6
    if len(radii) > 1 and np.diff(radii).min() <= 0.0:
        raise SamplingError(
            "radius must increase from value to value; sort it together with energy"
        )
    wanted = [in_range("shares", share, 0.0, 1.0, open_low=True) for share in shares]
    values = _samples("energy", energy, like=radii, of="radius")
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.0, height=4.2)
    if diffraction_limit is not None:
        limit = _samples("diffraction_limit", diffraction_limit, like=radii, of="radius")
        axes.plot(radii, limit, color=GREY, linestyle="--", label="diffraction limit")
    axes.plot(radii, values, color=BLUE, label="encircled energy")
    lines = zip(wanted, (VERMILION, ORANGE, *SERIES[2:]), strict=False)
    for share, colour in lines:
        place = _crossing(radii, values, share)
        if place is None:
            axes.plot([], [], " ", label=f"{100 * share:g} % not within {radii[-1]:.3g} µm")
            continue
        style: dict[str, Any] = {"color": colour, "linewidth": 1.2, "linestyle": ":"}
        axes.plot([place, place, radii[0]], [0.0, share, share], **style)
        label = f"{100 * share:g} % within {place:.3g} µm"
        axes.plot([place], [share], color=colour, marker="o", linestyle="", label=label)
    axes.set(
        xlabel="radius (µm)",
        ylabel="fraction of the energy",
        ylim=(0.0, 1.02),
        xlim=(float(radii[0]), float(radii[-1])),
        title="encircled energy",
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower right")
    return axes


def through_focus(found: ThroughFocus, *, axes: Axes | None = None) -> Axes:
    """Draw the quality of a point spread against the shift of the image plane, and the best plane.

    Parameters
    ----------
    found : ThroughFocus
        Result of `nlosoptics.psf.through_focus`, whose ``criterion`` is the quality measure.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the shift in mm, positive in the direction of the light. The vertical axis shows
        the metric of ``criterion``: the rms wave aberration ("rms") or the spot radius ("spot") in
        um, or the relative values "strehl" and "mtf". The shaded range is the depth of focus about
        the best plane. It extends by ``2 lambda N^2`` to each side, with the wavelength lambda and
        the F-number N. At its ends, the defocus at the pupil's rim is a quarter of a wave.

    See Also
    --------
    nlosoptics.psf.through_focus : Metric in several image planes.
    nlosoptics.psf.best_focus : Displacement of best focus.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics import psf, views
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 50e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> axes = views.through_focus(psf.through_focus(wave, np.linspace(-2e-4, 4e-4, 31)))
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('shift of the image plane (mm)', 'strehl')
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.0, height=4.2)
    length = found.criterion in ("rms", "spot")
    shifts, values = 1e3 * found.shifts, (1e6 if length else 1.0) * found.values
    marker = "o" if len(shifts) <= FEW else None
    order = np.argsort(shifts)
    axes.plot(shifts[order], values[order], color=BLUE, marker=marker, markersize=3.5)
    best, depth = shifts[found.best], 2e3 * found.wavelength * found.f_number**2
    axes.axvline(best, color=VERMILION, linestyle="--", label=f"best of these, {best:.4g} mm")
    axes.axvspan(best - depth, best + depth, color=GREY, alpha=0.2, label="depth of focus")
    axes.set(
        xlabel="shift of the image plane (mm)",
        ylabel=f"{found.criterion} (µm)" if length else found.criterion,
        xlim=(float(shifts.min()), float(shifts.max())) if len(shifts) > 1 else None,
        title="through focus",
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend()
    return axes


def history(fit: Reconstruction, *, axes: Sequence[Axes] | None = None) -> tuple[Axes, ...]:
    """Draw how a fit converged: each quantity that the solver recorded, against the iteration.

    Parameters
    ----------
    fit : Reconstruction
        Result of a solver; its ``history`` is drawn.
    axes : sequence of matplotlib Axes, optional
        Axes to draw on, one for each recorded quantity. A new figure by
        default.

    Returns
    -------
    tuple of Axes
        Axes in the order of the history. A scale is logarithmic where the values are positive and
        span more than a factor of ten. For the residual (measured minus modelled image), a dashed
        line marks the level of the noise.

    Raises
    ------
    SceneError
        If the history is empty, or if the number of axes differs from that of the quantities. A
        method without iterations keeps no history.

    See Also
    --------
    reconstruction : Reconstructed object next to the true one.
    nlosoptics.inverse.Reconstruction : Result of every solver.
    """
    panels: dict[str, dict[str, Array]] = {}
    for name, record in fit.history.items():
        if len(record):
            panels.setdefault(RECORDS.get(name, (name, ""))[0], {})[name] = np.asarray(record)
    if not panels:
        raise SceneError(
            "the history of this fit is empty, because its method does not iterate or found no "
            "signal; use views.reconstruction instead"
        )
    on = (
        tuple(axes)
        if axes is not None
        else new_axes(len(panels), width=4.0 * len(panels), height=3.6)
    )
    if len(on) != len(panels):
        raise SceneError(
            f"{len(on)} axes were given, must be {len(panels)}: one each for {', '.join(panels)}"
        )
    for axis, (label, records) in zip(on, panels.items(), strict=True):
        unit = "iteration"
        for (name, record), colour, marker in zip(records.items(), SERIES, MARKERS, strict=False):
            unit = RECORDS.get(name, ("", "iteration"))[1]
            style = "" if unit == "restart" else "-"
            dots = marker if len(record) <= FEW or not style else ""
            axis.plot(
                np.arange(1, len(record) + 1),
                record,
                color=colour,
                linestyle=style,
                marker=dots,
                markersize=4,
                label=name,
            )
        every = np.concatenate(list(records.values()))
        if every.min() > 0.0 and every.max() > WIDE_RANGE * every.min():
            axis.set_yscale("log")
        if "residual" in records:
            axis.axhline(1.0, color=GREY, linestyle="--", linewidth=1.2, label="noise")
        if len(axis.lines) > 1:
            axis.legend()
        axis.grid(alpha=0.25)
        axis.set(xlabel=unit, ylabel=label)
        space_ticks(axis, integer=True)
    return on


def _samples(name: str, values: ArrayLike, *, like: Array | None = None, of: str = "") -> Array:
    """Return the values (n,) of a curve as float64, after a check of shape and finiteness.

    Values must have the shape of ``like``; without it, n must be at least 2. Error messages call
    the values ``name`` and the array ``like`` by the name in ``of``.
    """
    array = np.asarray(values, dtype=np.float64)
    if like is None and (array.ndim != 1 or array.size < 2):
        raise SamplingError(f"{name} has shape {array.shape}, must be (n,) with n at least 2")
    if like is not None and array.shape != like.shape:
        raise SamplingError(f"{name} has shape {array.shape}, must be {like.shape} like {of}")
    n_bad = array.size - int(np.count_nonzero(np.isfinite(array)))
    if n_bad:
        raise SamplingError(f"{name} has {n_bad} of {array.size} values that are not finite")
    return array


def _crossing(places: Array, values: Array, level: float) -> float | None:
    """Return where a curve first reaches a level, interpolated linearly, or None."""
    reached = np.flatnonzero(values >= level)
    if not len(reached):
        return None
    at = int(reached[0])
    if at == 0:
        return float(places[0])
    return float(np.interp(level, values[at - 1 : at + 1], places[at - 1 : at + 1]))


def spot_diagram(spots: SpotDiagram, *, most: int = 20_000, axes: Axes | None = None) -> Axes:
    """Draw a spot diagram: the points at which rays meet the image plane, with the Airy disc.

    Parameters
    ----------
    spots : SpotDiagram
        Result of `nlosoptics.psf.spot_diagram`.
    most : int
        Largest number of rays drawn. If there are more, every second, third, ... ray is drawn.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes in image coordinates, um; -y points up, because the lens inverts the image. The area of
        a dot is proportional to the energy of its ray. The circle around the centroid is the first
        dark ring of the Airy pattern, the image of a point without aberration.

    See Also
    --------
    nlosoptics.psf.spot_diagram : Points at which rays meet the image plane.
    point_spread : Map of a PSF.
    """
    whole("most", most)
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.4, height=5.4)
    from matplotlib.patches import Circle

    drawn = slice(None, None, max(1, -(-len(spots.x) // most)))
    x, y, energy = (1e6 * spots.x[drawn], 1e6 * spots.y[drawn], spots.energy[drawn])
    rms, airy = 1e6 * spots.radius, 1e6 * spots.airy_radius
    centre = (1e6 * spots.centroid[0], 1e6 * spots.centroid[1])
    axes.scatter(
        x,
        y,
        s=np.clip(8.0 * energy / energy.mean(), 0.5, 40.0),
        color=BLUE,
        linewidths=0,
        alpha=0.7,
        rasterized=True,
        label=f"rays, rms radius {rms:.3g} µm",
    )
    style: dict[str, Any] = {"fill": False, "color": VERMILION, "linewidth": 1.5}
    axes.add_patch(Circle(centre, airy, label=f"Airy disc, radius {airy:.3g} µm", **style))
    half = 1.3 * max(airy, float(np.abs(x - centre[0]).max()), float(np.abs(y - centre[1]).max()))
    axes.set(
        xlim=(centre[0] - half, centre[0] + half),
        ylim=(centre[1] + half, centre[1] - half),
        aspect="equal",
        xlabel="x (µm)",
        ylabel="y (µm)",
        title="spot diagram",
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend(loc="upper right")
    return axes


def path_lengths(histogram: PathHistogram, *, axes: Axes | None = None) -> Axes:
    """Draw the detected power against the path length of the light, by number of reflections.

    Parameters
    ----------
    histogram : PathHistogram
        The ``histogram`` of a result of `nlosoptics.raytrace.trace_image`.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the power per bin in W, on a logarithmic scale, against the path length in m, with
        one curve for each number of reflections that contributes, and one for light that never met
        the hidden object. The bands are one standard error.

    Raises
    ------
    SceneError
        If there is no light in any bin.

    See Also
    --------
    nlosoptics.raytrace.trace_image : Image and histogram of path lengths.
    transient : Streak image of a capture.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace, views
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(16)
    >>> bins = {"t_start": 3.0, "delta_t": 0.1, "n_bins": 40}
    >>> found = raytrace.trace_image(scene, n_rays=4096, max_bounces=3, seed=0, **bins)
    >>> views.path_lengths(found.histogram).get_xlabel()
    'path length, laser to lens (m)'
    """
    parts = [
        (f"{k} reflection{'s' if k > 1 else ''}", power, histogram.by_bounce_error[k])
        for k, power in enumerate(histogram.by_bounce)
    ]
    parts.append(("stray light", histogram.stray, histogram.stray_error))
    parts = [part for part in parts if part[1].any()]
    if not parts:
        low, high = histogram.edges[[0, -1]]
        raise SceneError(
            f"no light has a path length of {low:g} to {high:g} m; change t_start or n_bins, or "
            "trace more rays"
        )
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.2)
    for k, (label, power, error) in enumerate(parts):
        colour = SERIES[k % len(SERIES)]
        lit = np.where(power > 0.0, power, np.nan)
        axes.step(histogram.times, lit, where="mid", color=colour, label=label)
        spread = np.where(np.isfinite(error), error, 0.0)
        low = np.maximum(lit - spread, 0.1 * lit)  # a band down to zero has no end on this scale
        high = lit + spread
        axes.fill_between(histogram.times, low, high, step="mid", color=colour, alpha=0.25)
    ends = "laser to lens" if histogram.outer_legs else "first to last reflection"
    axes.set(
        xlabel=f"path length, {ends} (m)",
        ylabel="detected power per bin (W)",
        yscale="log",
        xlim=tuple(histogram.edges[[0, -1]]),
        title="path lengths of the detected light",
    )
    space_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend()
    return axes
