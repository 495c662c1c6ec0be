"""Maps: wave aberration, point spread, image, reconstruction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import one_of, positive
from .canvas import new_axes
from .reliefs import relief, spread_norm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.image import AxesImage

    from ..imaging import SpeckleImage
    from ..inverse import Reconstruction
    from ..psf import HybridPointSpread, PointSpread, Wavefront
    from ..raytrace import WallIrradiance

Array = NDArray[np.float64]

#: What the value 1 of a point spread stands for.
MEANING = {
    "unit-sum": "energy per sample, whole image plane 1",
    "flux": "energy per sample, clear pupil 1",
    "ideal-peak": "intensity, peak without aberration 1",
}


def wavefront(
    wavefront: Wavefront, *, unit: Literal["waves", "nm"] = "waves", axes: Axes | None = None
) -> Axes:
    """Draw the wave aberration over the pupil.

    Parameters
    ----------
    wavefront : Wavefront
        In any layout of nodes; nodes without light are left blank.
    unit : {"waves", "nm"}
        Of the colour bar.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Pupil coordinates in mm; red where the wave has gone the longer path.
    """
    one_of("unit", unit, ("waves", "nm"))
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.6, height=4.6)
    scale = wavefront.wavelength if unit == "waves" else 1e-9
    lit = (wavefront.amplitude > 0) & (wavefront.weights > 0)
    values = np.where(lit, wavefront.aberration / scale, np.nan)
    largest = float(np.nanmax(abs(values), initial=0.0)) or 1.0
    style: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
    u, v = wavefront.u * 1e3, wavefront.v * 1e3
    drawn: Any
    if wavefront.layout == "grid":
        drawn = axes.pcolormesh(u, v, values, shading="nearest", rasterized=True, **style)
    elif wavefront.layout == "cells":
        for patch in range(len(u)):
            drawn = axes.pcolormesh(
                u[patch], v[patch], values[patch], shading="gouraud", rasterized=True, **style
            )
    else:
        # triangles close the seam at angle zero and the gap at the centre
        drawn = axes.tripcolor(u[lit], v[lit], values[lit], shading="gouraud", **style)
    colour_bar(axes, drawn, f"wave aberration ({unit})")
    axes.set(xlabel="u (mm)", ylabel="v (mm)", aspect="equal", title="wave aberration")
    return axes


def point_spread(
    point_spread: PointSpread,
    *,
    scale: Literal["log", "linear", "surface"] = "log",
    decades: float = 6.0,
    half_width: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw a point spread function.

    Parameters
    ----------
    point_spread : PointSpread
        What to draw.
    scale : {"log", "linear", "surface"}
        Of the colours; "surface" draws heights in a linear scale under colours in a logarithmic
        one, on axes of three dimensions.
    decades : float
        Of the logarithmic scale, below the peak; what is fainter is drawn like the faintest.
    half_width : float, optional
        Half the side of the square that is shown about the centre, m; all by default.
    axes : matplotlib Axes, optional
        Where to draw, for a surface with ``projection="3d"``; a new figure by default.

    Returns
    -------
    Axes
        Image coordinates in um, turned as the camera shows them: y grows downward, on a surface
        toward the viewer.

    Raises
    ------
    SceneError
        If ``scale`` is unknown, ``decades`` or ``half_width`` is not above 0, or a surface is
        wanted on flat axes.
    """
    one_of("scale", scale, ("log", "linear", "surface"))
    positive("decades", decades)
    if half_width is not None:
        half_width = positive("half_width", half_width, unit="m")
    meaning = MEANING[point_spread.normalisation]
    title = f"point spread, {point_spread.method}"
    if scale == "surface":
        return relief(point_spread, decades, half_width, meaning=meaning, title=title, axes=axes)
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.6, height=4.6)
    norm = spread_norm(point_spread, None if scale == "linear" else decades)
    drawn = _spread_map(axes, point_spread.intensity, point_spread.pitch, norm)
    if half_width is not None:
        axes.set(
            xlim=(-half_width * 1e6, half_width * 1e6), ylim=(half_width * 1e6, -half_width * 1e6)
        )
    colour_bar(axes, drawn, meaning)
    axes.set(xlabel="x (µm)", ylabel="y (µm)", title=title)
    return axes


def hybrid_parts(
    point_spread: HybridPointSpread,
    *,
    decades: float = 6.0,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the parts of a hybrid point spread: coherent, halo and diffuse, in one scale.

    Parameters
    ----------
    point_spread : HybridPointSpread
        What to draw.
    decades : float
        Of the logarithmic scale, below the peak of the sum; what is fainter is drawn like the
        faintest.
    axes : sequence of three matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    tuple of three Axes
        Image coordinates in um, turned as the camera shows them: y grows downward.
    """
    positive("decades", decades)
    drawn_on = tuple(axes) if axes is not None else new_axes(3, width=13.0, height=4.2)
    norm = spread_norm(point_spread, decades)
    for axis, name in zip(drawn_on, ("coherent", "halo", "diffuse"), strict=True):
        drawn = _spread_map(axis, getattr(point_spread, name), point_spread.pitch, norm)
        share = getattr(point_spread, f"{name}_flux")
        axis.set(xlabel="x (µm)", ylabel="y (µm)", title=f"{name}, {share:.3g} in all")
    colour_bar(drawn_on[-1], drawn, MEANING[point_spread.normalisation])
    return drawn_on


def _spread_map(axes: Axes, intensity: Array, pitch: float, norm: Normalize) -> AxesImage:
    """Draw samples of the image plane about their centre, as the camera shows them."""
    ny, nx = intensity.shape
    pixel = pitch * 1e6
    left, low = (-(n // 2 + 0.5) * pixel for n in (nx, ny))
    return axes.imshow(
        np.maximum(intensity, norm.vmin or 0.0),
        norm=norm,
        cmap="viridis",
        extent=(left, left + nx * pixel, low + ny * pixel, low),
        interpolation="nearest",
    )


def image(speckle_image: SpeckleImage, *, axes: Axes | None = None) -> Axes:
    """Draw a camera image as the camera shows it: upright, mirror-reversed by the wall.

    Parameters
    ----------
    speckle_image : SpeckleImage
        What to draw.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Detector coordinates in mm, row 0 on top; colours are electrons per pixel.
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.6, height=4.6)
    ny, nx = speckle_image.electrons.shape
    right, low = (n / 2 * speckle_image.pitch * 1e3 for n in (nx, ny))
    drawn = axes.imshow(
        speckle_image.electrons,
        cmap="gray",
        extent=(-right, right, low, -low),
        interpolation="nearest",
    )
    colour_bar(axes, drawn, "electrons per pixel")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="speckle image")
    return axes


def reconstruction(
    reconstruction: Reconstruction,
    truth: ArrayLike | None = None,
    *,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw a reconstruction, beside the ground truth where it is known.

    Parameters
    ----------
    reconstruction : Reconstruction
        What to draw.
    truth : array_like (ny, nx), optional
        The object in the frame of the reconstruction, in the same units.
    axes : sequence of matplotlib Axes, optional
        Where to draw, one axes or, with a truth, two; a new figure by default.

    Returns
    -------
    tuple of Axes
        Truth, where it is given, and reconstruction. The mirror is undone: columns count from right
        to left, so that letters read. Colours are relative brightness where the largest value is
        1, and else in the units that the given gain refers to.
    """
    pictures = [] if truth is None else [("ground truth", np.asarray(truth))]
    found = reconstruction.object
    if hasattr(found, "detach"):  # a tensor, which may be on another device or carry gradients
        found = found.detach().cpu()
    told = reconstruction.status.replace("_", " ")
    pictures.append((f"reconstruction, {told}", np.asarray(found)))
    if axes is None:
        axes = new_axes(len(pictures), width=0.6 + 4.8 * len(pictures), height=4.6)
    for where, (title, picture) in zip(axes, pictures, strict=True):
        drawn = where.imshow(picture, cmap="gray", interpolation="nearest")
        where.invert_xaxis()
        relative = np.isclose(picture.max(), 1.0)
        colour_bar(where, drawn, "relative brightness" if relative else "object units")
        where.set(xlabel="column (pixels)", ylabel="row (pixels)", title=title)
    return tuple(axes)


def colour_bar(axes: Axes, drawn: Any, label: str) -> None:
    """Add a colour bar beside axes, as high as what is drawn on them."""
    figure: Any = axes.get_figure(root=True)
    figure.colorbar(drawn, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)), label=label)


def irradiance(irradiance: WallIrradiance, *, axes: Axes | None = None) -> Axes:
    """Draw the irradiance of the relay wall.

    Parameters
    ----------
    irradiance : WallIrradiance
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        World x and y in m, as seen from the room: x grows to the right, y up.
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.6)
    drawn = axes.pcolormesh(
        irradiance.x, irradiance.y, irradiance.irradiance, shading="nearest", rasterized=True
    )
    colour_bar(axes, drawn, "irradiance (W/m$^2$)")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="light on the relay wall")
    return axes
