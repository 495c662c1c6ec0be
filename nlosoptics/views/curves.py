"""Curves of metrics and path lengths; spot diagrams; forecasts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import counted, expect, whole
from ..errors import SceneError
from .canvas import BLUE, GREY, SERIES, VERMILION, few_ticks, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..limits import Feasibility
    from ..psf import ThroughFocus
    from ..raytrace.images.trace_image import PathHistogram


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
    found = expect("found", found, "ThroughFocus")
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.0, height=4.2)
    length = found.criterion in ("rms", "spot")
    shifts, values = 1e3 * found.shifts, (1e6 if length else 1.0) * found.values
    marker = "o" if len(shifts) <= 50 else None
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
    few_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend()
    return axes


def spot_diagram(spots: Any, *, most: int = 20_000, axes: Axes | None = None) -> Axes:
    """Draw a spot diagram: the points at which rays meet the image plane, with the Airy disc.

    Parameters
    ----------
    spots : SpotDiagram, or Wavefront, Scene or Result
        Result of `nlosoptics.psf.spot_diagram`, or what that takes.
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
    from .. import psf

    if not isinstance(spots, psf.SpotDiagram):
        spots = psf.spot_diagram(spots)
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
    few_ticks(axes)
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
    histogram = expect("histogram", histogram, "PathHistogram")
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
    few_ticks(axes)
    axes.grid(alpha=0.25)
    axes.legend()
    return axes


def feasibility(found: Feasibility, *, axes: Axes | None = None) -> Axes:
    """Draw which detail an image can show: contrast against spatial frequency, with noise limits.

    Parameters
    ----------
    found : Feasibility
        Result of `nlosoptics.limits.feasibility`.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the modulation against the spatial frequency on the hidden object, cycles/m. The
        modulation is the contrast of a sine pattern on the object that is left in the camera image.
        One curve is for the image formed by the mirror-like part of the wall's reflection, one for
        its diffuse part. A dashed line of the same colour marks the modulation at which the
        signal-to-noise ratio is 1; only frequencies with a modulation above it are detectable. A
        grey line marks the frequency whose period is twice the width of the object's strokes. The
        title gives the verdict.

    See Also
    --------
    nlosoptics.limits.feasibility : Predict what an image can show.
    image : Map of a camera image.
    """
    found = expect("found", found, "Feasibility")
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.2)
    parts: list[tuple[str, str, Any, Any]] = [
        ("specular image", BLUE, found.modulation, found.signal_to_noise),
        ("diffuse reflection", VERMILION, found.relay_modulation, found.relay_signal_to_noise),
    ]
    for name, colour, modulation, ratio in parts:
        if not np.any(modulation > 0.0):
            continue
        axes.semilogy(found.frequency, np.maximum(modulation, 1e-5), color=colour, label=name)
        if ratio[0] > 0.0:
            hidden = modulation[0] / ratio[0]
            label = f"{name}: noise limit {hidden:.1g}"
            axes.axhline(hidden, color=colour, ls="--", lw=1, label=label)
    if found.stroke > 0.0:
        axes.axvline(0.5 / found.stroke, color=GREY, lw=1, label="stroke frequency")
    axes.set(
        xlabel="spatial frequency on the object (cycles/m)",
        ylabel="modulation",
        ylim=(1e-4, 1.5),
        xlim=(0.0, float(found.frequency[-1])),
        title=found.verdict.split(":")[0] + f", {counted(found.modes, 'mode')}",
    )
    few_ticks(axes)
    # below the axes, where it cannot cover a curve
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8)
    return axes
