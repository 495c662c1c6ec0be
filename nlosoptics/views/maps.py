"""Maps: wave aberration, point spread function, image, reconstruction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import expect, in_range, one_of, positive
from .canvas import SKY, few_ticks, new_axes, round_step

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..imaging import SpeckleImage
    from ..inverse import Reconstruction
    from ..psf import PointSpread, PupilField, Wavefront
    from ..raytrace import TracedImage

Array = NDArray[np.float64]


def wavefront(
    wavefront: Wavefront | PupilField,
    *,
    unit: Literal["waves", "nm"] = "waves",
    axes: Axes | None = None,
) -> Axes:
    """Draw the wave aberration over the pupil, or the phase of light from a rough wall.

    Parameters
    ----------
    wavefront : Wavefront or PupilField
        Wave to draw. Parts of the pupil without light are blank. Of a `PupilField`, the phase from
        -pi to pi is drawn.
    unit : {"waves", "nm"}
        Unit of the aberration: wavelengths or nanometres.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes in pupil coordinates u and v, mm. Red marks a longer optical path than that of a
        perfect spherical wave.

    See Also
    --------
    nlosoptics.psf.wavefront : Wave aberration of a scene.
    point_spread : Map of a PSF.

    Examples
    --------
    >>> from nlosoptics import psf, views
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 60e-9}, wavelength=600e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> axes = views.wavefront(wave, unit="nm")
    >>> axes.get_xlabel(), axes.get_title()
    ('u (mm)', 'wave aberration')
    """
    wavefront = expect("wavefront", wavefront, "Wavefront", "PupilField")
    one_of("unit", unit, ("waves", "nm"))
    (axes,) = (axes,) if axes is not None else new_axes(width=5.6, height=4.6)
    wave: Any = wavefront
    if hasattr(wave, "phase"):
        _draw_phase(axes, wave)
        return axes
    scale = wave.wavelength if unit == "waves" else 1e-9
    lit = (wave.amplitude > 0) & (wave.weights > 0)
    values = np.where(lit, wave.aberration / scale, np.nan)
    largest = float(np.nanmax(abs(values), initial=0.0)) or 1.0
    style: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
    u, v = wave.u * 1e3, wave.v * 1e3
    drawn: Any
    if wave.layout == "grid":
        drawn = axes.pcolormesh(u, v, values, shading="nearest", rasterized=True, **style)
    elif wave.layout == "cells":
        for patch in range(len(u)):
            drawn = axes.pcolormesh(
                u[patch], v[patch], values[patch], shading="gouraud", rasterized=True, **style
            )
    else:
        # a triangulation closes the seam at angle zero and the gap at the centre
        drawn = axes.tripcolor(u[lit], v[lit], values[lit], shading="gouraud", **style)
    colour_bar(axes, drawn, f"wave aberration ({unit})")
    axes.set(xlabel="u (mm)", ylabel="v (mm)", aspect="equal", title="wave aberration")
    return axes


def _draw_phase(axes: Axes, field: PupilField) -> None:
    """Draw the phase of a field, cut to the lit part of its grid."""
    n = field.values.shape[0]
    lit = np.nonzero(np.isfinite(field.phase).any(axis=0))[0]
    inside = slice(int(lit.min()), int(lit.max()) + 1) if lit.size else slice(0, n)
    ends = [(i - n // 2 - 0.5) * field.pitch * 1e3 for i in (inside.start, inside.stop)]
    drawn = axes.imshow(
        field.phase[inside, inside],
        origin="lower",
        extent=(*ends, *ends),
        interpolation="nearest",
        cmap="twilight",
        vmin=-np.pi,
        vmax=np.pi,
    )
    colour_bar(axes, drawn, "phase (rad)")
    axes.set(xlabel="u (mm)", ylabel="v (mm)", title="phase in the exit pupil")


def point_spread(
    point_spread: PointSpread,
    *,
    scale: Literal["log", "linear"] = "log",
    decades: float = 6.0,
    half_width: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw a point spread function as a map.

    Parameters
    ----------
    point_spread : PointSpread
        Point spread function to draw, for example from `nlosoptics.psf.point_spread`.
    scale : {"log", "linear"}
        Scale of the colours.
    decades : float
        Range of the logarithmic scale below the peak, in powers of ten. Fainter samples get the
        lowest colour.
    half_width : float, optional
        Half the side of the displayed square about the centre, m; the whole window by default.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes in image coordinates, um; -y points up, because the lens inverts the image.

    Raises
    ------
    SceneError
        If ``scale`` is unknown, or ``decades`` or ``half_width`` is not above 0.

    See Also
    --------
    nlosoptics.psf.point_spread : PSF of a given wave.
    spot_diagram : Points at which rays meet the image plane.

    Examples
    --------
    >>> from nlosoptics import psf, views
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 60e-9}, wavelength=600e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> axes = views.point_spread(psf.point_spread(wave, shape=64), scale="linear")
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('x (µm)', '−y, up (µm)')
    """
    point_spread = expect("point_spread", point_spread, "PointSpread")
    one_of("scale", scale, ("log", "linear"))
    positive("decades", decades)
    if half_width is not None:
        half_width = positive("half_width", half_width, unit="m")
    (axes,) = (axes,) if axes is not None else new_axes(width=5.6, height=4.6)
    from matplotlib.colors import LogNorm, Normalize

    light = point_spread.intensity
    peak = float(light.max()) or 1.0
    lowest = 0.0 if scale == "linear" else peak * 10.0**-decades
    ny, nx = light.shape
    pixel = point_spread.pitch * 1e6
    left, top = -(nx // 2 + 0.5) * pixel, (ny // 2 + 0.5) * pixel
    drawn = axes.imshow(
        np.maximum(light, lowest),
        norm=Normalize(lowest, peak) if scale == "linear" else LogNorm(lowest, peak),
        cmap="viridis",
        extent=(left, left + nx * pixel, top - ny * pixel, top),
        interpolation="nearest",
    )
    if half_width is not None:
        ends = -half_width * 1e6, half_width * 1e6
        axes.set(xlim=ends, ylim=ends)
    meaning = {
        "unit-sum": "energy per sample (image plane total 1)",
        "flux": "energy per sample (clear pupil total 1)",
        "ideal-peak": "intensity (aberration-free peak 1)",
    }
    colour_bar(axes, drawn, meaning[point_spread.normalisation])
    few_ticks(axes)
    title = f"point spread function, {point_spread.method}"
    axes.set(xlabel="x (µm)", ylabel="−y, up (µm)", title=title)
    return axes


def image(
    speckle_image: SpeckleImage, *, object_scale: float | None = None, axes: Axes | None = None
) -> Axes:
    """Draw a camera image upright, as the camera shows it: mirror-reversed by the wall.

    Parameters
    ----------
    speckle_image : SpeckleImage
        Simulated camera image to draw, such as ``image`` of a result of `nlosoptics.simulate`. The
        type is named after the speckle, the granular noise of laser light, that it includes.
    object_scale : float, optional
        Metres on the hidden object per metre on the detector, from
        `nlosoptics.limits.object_scale`. It adds a scale bar with a length on the object. None: no
        bar.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes in detector coordinates, mm. The lens inverts the image, so that -y points up. The
        colour bar is in electrons per pixel.

    See Also
    --------
    nlosoptics.imaging.form_image : Image in electrons, with noise.
    nlosoptics.limits.object_scale : Metres on the object per metre on the detector.
    overview : One figure of a whole run.

    Examples
    --------
    >>> from nlosoptics import Scene, limits, simulate, views
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> result = simulate(scene, seed=0)
    >>> axes = views.image(result.image, object_scale=limits.object_scale(scene))
    >>> axes.texts[0].get_text()
    '0.2 m on the object'
    """
    speckle_image = expect("speckle_image", speckle_image, "SpeckleImage", having="electrons")
    if object_scale is not None:
        object_scale = positive("object_scale", object_scale)
    (axes,) = (axes,) if axes is not None else new_axes(width=5.6, height=4.6)
    _pixel_map(axes, speckle_image.electrons, speckle_image.pitch, "electrons per pixel")
    if object_scale is not None:
        _scale_bar(axes, 1e3 / object_scale)
    axes.set_title("camera image")
    return axes


def traced_image(
    traced_image: TracedImage,
    *,
    quantity: Literal["expected", "power", "stray"] = "expected",
    percentile: float = 99.5,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw a ray-traced camera image and the relative standard error of its pixels.

    Parameters
    ----------
    traced_image : TracedImage
        Result of `nlosoptics.raytrace.trace_image`.
    quantity : {"expected", "power", "stray"}
        What to draw: the expected electrons of all light; the power of light that met the hidden
        object; or the power of light that never met it. Choose "power" if the laser spot is
        brighter than the object.
    percentile : float
        Percentage of the pixels that the grey scale covers, above 0 to 100. Brighter pixels, such
        as the few that rare paths happen to meet, are white; the label states this.
    axes : sequence of two matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    tuple of two Axes
        Values of the pixels, and their standard errors in per cent, in detector coordinates, mm; -y
        points up, because the lens inverts the image. Pixels without light are blank in the map of
        errors.

    See Also
    --------
    nlosoptics.raytrace.trace_image : Image and histogram of path lengths.
    path_lengths : Curves of the histogram.
    image : Image by waves, with the noise of the camera.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace, views
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(16)
    >>> found = raytrace.trace_image(scene, n_rays=4096, max_bounces=3, seed=0)
    >>> axes = views.traced_image(found)
    >>> axes[0].get_title(), axes[0].get_xlabel()
    ('traced image', 'x (mm)')
    """
    traced_image = expect("traced_image", traced_image, "TracedImage")
    one_of("quantity", quantity, ("expected", "power", "stray"))
    left, right = axes if axes is not None else new_axes(2, width=10.6, height=4.6)
    values, errors = (getattr(traced_image, quantity + end) for end in ("", "_error"))
    unit = "electrons per pixel" if quantity == "expected" else "power per pixel (W)"
    relative = np.full(values.shape, np.nan)
    known = np.isfinite(errors) & (values > 0.0)
    np.divide(100.0 * errors, values, out=relative, where=known)
    in_range("percentile", percentile, 0.0, 100.0, open_low=True)
    top = float(np.percentile(values, percentile))
    if not 0.0 < top < values.max():  # few pixels have light, or none is brighter
        top = float(values.max())
    else:
        unit += f", white above percentile {percentile:g}"
    _pixel_map(left, values, traced_image.pitch, unit)
    left.images[0].set_clim(min(0.0, values.min()), top)
    _pixel_map(right, relative, traced_image.pitch, "standard error (%)", "viridis")
    kinds = {"expected": "", "power": ", hidden object's light", "stray": ", stray light"}
    left.set_title(f"traced image{kinds[quantity]}")
    right.set_title("relative standard error")
    return left, right


def _pixel_map(axes: Axes, values: Array, pitch: float, label: str, colours: str = "gray") -> None:
    """Draw values of the camera's pixels with a colour bar; ``pitch`` is their side, m.

    Row 0 is on top, so that -y points up.
    """
    ny, nx = values.shape
    right, top = (n / 2 * pitch * 1e3 for n in (nx, ny))
    extent = (-right, right, -top, top)
    drawn = axes.imshow(values, cmap=colours, extent=extent, interpolation="nearest")
    colour_bar(axes, drawn, label)
    few_ticks(axes)
    axes.set(xlabel="x (mm)", ylabel="−y, up (mm)")


def _scale_bar(axes: Axes, per_metre: float) -> None:
    """Draw a bar of a round length on the object; an axes unit is 1 / ``per_metre`` m there."""
    from matplotlib.patheffects import withStroke

    left, right = axes.get_xlim()
    low, high = axes.get_ylim()
    width = right - left
    length = round_step(0.25 * width / per_metre)
    x, y = left + 0.05 * width, low + 0.06 * (high - low)
    # sky blue is readable on black, grey and white
    style: dict[str, Any] = {"color": SKY, "solid_capstyle": "butt", "linewidth": 3}
    axes.plot([x, x + length * per_metre], [y, y], scalex=False, scaley=False, **style)
    name = f"{length:g} m" if length >= 0.1 else f"{1e3 * length:g} mm"
    axes.annotate(
        f"{name} on the object",
        (x, y),
        (0, 4),
        textcoords="offset points",
        color=SKY,
        path_effects=[withStroke(linewidth=2.5, foreground="black")],  # over bright parts
    )


def reconstruction(
    reconstruction: Reconstruction,
    truth: ArrayLike | None = None,
    *,
    pitch: float | None = None,
    mirrored: bool = True,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw a reconstruction, next to the ground truth if that is known.

    Parameters
    ----------
    reconstruction : Reconstruction
        Result of a solver, such as `nlosoptics.inverse.tv_deconvolve`.
    truth : array_like, (ny, nx), optional
        True object on the pixels of the reconstruction, in the unit of ``Reconstruction.object``.
        None: only the reconstruction is drawn.
    pitch : float, optional
        Side of a pixel on the hidden object, m. The axes are then in metres about the middle of the
        image. None: the axes count pixels.
    mirrored : bool
        Whether the columns of the reconstruction are those of an image mirrored by the wall. False
        for the answers of `nlosoptics.inverse.shadow_fit` and for photographs without a wall.
    axes : sequence of matplotlib Axes, optional
        Axes to draw on: one, or two with a truth. A new figure by default.

    Returns
    -------
    tuple of Axes
        Axes of the truth (if given) and of the reconstruction. They are drawn as seen by a viewer
        in front of the object, upright and without the mirror reversal by the wall. The title of
        the reconstruction gives its status. Each has its own colour bar, labelled "relative
        brightness" if the largest value drawn there is 1. Otherwise it is labelled "object units",
        which are the unit of ``Reconstruction.object``.

    See Also
    --------
    image : The camera image.

    Examples
    --------
    >>> from nlosoptics import Scene, imaging, inverse, simulate, views
    >>> result = simulate(Scene.load("examples/scenes/letter_flat.toml").resized(32), seed=0)
    >>> model = imaging.ForwardModel(result.point_spread, shape=(32, 32))
    >>> (axes,) = views.reconstruction(inverse.wiener(result.image.electrons, model))
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('column (pixels)', 'row (pixels)')
    """
    if pitch is not None:
        pitch = positive("pitch", pitch, unit="m")
    shown = [] if truth is None else [("ground truth", np.asarray(truth))]
    values: Any = expect("reconstruction", reconstruction, "Reconstruction", having="object").object
    if hasattr(values, "detach"):  # a tensor, which may be on another device or carry gradients
        values = values.detach().cpu()
    shown.append((f"reconstruction, {reconstruction.status.replace('_', ' ')}", np.asarray(values)))
    if axes is None:
        axes = new_axes(len(shown), width=0.6 + 4.8 * len(shown), height=4.6)
    for where, (title, picture) in zip(axes, shown, strict=True):
        ny, nx = picture.shape
        if pitch is None:
            drawn = where.imshow(picture, cmap="gray", interpolation="nearest")
            if mirrored:
                where.invert_xaxis()
            where.set(xlabel="column (pixels)", ylabel="row (pixels)")
        else:
            right, top = nx / 2 * pitch, ny / 2 * pitch
            extent = (-right, right, -top, top)
            upright = picture[:, ::-1] if mirrored else picture
            drawn = where.imshow(upright, cmap="gray", extent=extent, interpolation="nearest")
            where.set(xlabel="right (m on the object)", ylabel="up (m on the object)")
        relative = np.isclose(picture.max(), 1.0)
        colour_bar(where, drawn, "relative brightness" if relative else "object units")
        few_ticks(where)
        where.set_title(title)
    return tuple(axes)


def colour_bar(axes: Axes, drawn: Any, label: str) -> None:
    """Add a colour bar to the right of axes, as high as their map."""
    figure: Any = axes.get_figure(root=True)
    figure.colorbar(drawn, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)), label=label)
