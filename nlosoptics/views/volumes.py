"""Reconstructed volumes: maximum projections and isosurfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import expect, in_range, one_of
from ..errors import SamplingError
from .canvas import GREY, few_ticks, new_axes, pyvista
from .maps import colour_bar
from .rays import dark_viridis
from .stages import FLAT, add_floor, add_legend, bar_style, drawn_on, finish_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pyvista import Plotter

    from ..transient import VolumeImage
    from ..transient.imaging.depth import DepthMap


def volume(image: VolumeImage, *, axis: str = "z", axes: Axes | None = None) -> Axes:
    """Draw a reconstructed volume as seen along an axis, by its maximum intensity projection.

    Parameters
    ----------
    image : VolumeImage
        Reconstruction to draw, for example from `nlosoptics.transient.lct`.
    axis : {"z", "y", "x"}
        Axis along which the largest intensity is taken: "z" for the view from the wall, "y" for the
        top view, "x" for the side view.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes in world coordinates, m. In the views from the wall and from above, x points left, as
        it does for a viewer who looks from the wall into the room. Colours are relative to the
        brightest voxel.

    See Also
    --------
    phasor_volume : Isosurface of a volume in 3-D.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics import transient, views
    >>> axis = np.linspace(-0.5, 0.5, 5)
    >>> grid = transient.Volume(axis, axis, np.linspace(0.8, 1.2, 3))
    >>> image = transient.VolumeImage(intensity=np.ones((3, 5, 5)), volume=grid, method="test")
    >>> views.volume(image, axis="y").get_ylabel()
    'z (m)'
    """
    image = expect("image", image, "VolumeImage")
    # horizontal axis, vertical axis and title
    views = {
        "z": ("x", "y", "view from the wall"),
        "y": ("x", "z", "top view"),
        "x": ("z", "y", "side view"),
    }
    one_of("axis", axis, views)
    across, up, title = views[axis]
    ends = [_ends(getattr(image.volume, name)) for name in (across, up)]
    if axes is None:
        shape = (ends[0][1] - ends[0][0]) / (ends[1][1] - ends[1][0])
        (axes,) = new_axes(1, width=min(2.0 + 3.8 * max(shape, 0.25), 8.0), height=4.6)
    seen = image.projection(axis)
    if axis == "x":
        seen = seen.T  # (nz, ny) with z across
    brightest = float(seen.max())
    drawn = axes.imshow(
        seen / brightest if brightest > 0.0 else seen,
        cmap="inferno",
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=(*ends[0], *ends[1]),
        interpolation="nearest",
    )
    if across == "x":
        axes.invert_xaxis()
    few_ticks(axes)
    colour_bar(axes, drawn, "relative intensity")
    axes.set(xlabel=f"{across} (m)", ylabel=f"{up} (m)", title=title)
    return axes


def depth_map(depths: DepthMap, *, axes: Axes | None = None) -> Axes:
    """Draw the depth of the hidden surface in each cell, as seen from the wall.

    Parameters
    ----------
    depths : DepthMap
        Depths from `nlosoptics.transient.depth_map` or `nlosoptics.transient.advise`.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes in world coordinates, m; x points left. Cells without a surface are blank.

    See Also
    --------
    volume : Projection of the volume.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics import transient, views
    >>> axis = np.linspace(-0.5, 0.5, 5)
    >>> grid = transient.Volume(axis, axis, np.linspace(0.8, 1.2, 3))
    >>> image = transient.VolumeImage(intensity=np.ones((3, 5, 5)), volume=grid, method="test")
    >>> views.depth_map(transient.depth_map(image)).get_title()
    'depth from the wall'
    """
    depths = expect("depths", depths, "DepthMap")
    if axes is None:
        (axes,) = new_axes(1, width=5.8, height=4.6)
    seen = depths.depth[np.isfinite(depths.depth)]
    low, high = np.percentile(seen, (2, 98)) if seen.size else (0.0, 1.0)  # without outliers
    drawn = axes.imshow(
        depths.depth,
        cmap="viridis",
        vmin=low,
        vmax=high,
        origin="lower",
        extent=(*_ends(depths.x), *_ends(depths.y)),
        interpolation="nearest",
    )
    axes.invert_xaxis()
    few_ticks(axes)
    colour_bar(axes, drawn, "depth (m)")
    axes.set(xlabel="x (m)", ylabel="y (m)", title="depth from the wall")
    return axes


def _ends(values: Any) -> tuple[float, float]:
    """Return the outer edges of the cells of an axis, m; a single cell is drawn 1 cm wide."""
    half = 0.5 * float(np.diff(values[:2])[0]) if len(values) > 1 else 0.005
    return float(values[0]) - half, float(values[-1]) + half


def phasor_volume(
    image: VolumeImage, *, threshold: float = 0.25, plotter: Plotter | None = None
) -> Plotter:
    """Draw a reconstructed volume in 3-D: its isosurface, coloured by the distance from the wall.

    Parameters
    ----------
    image : VolumeImage
        Reconstruction to draw, for example from `nlosoptics.transient.phasor_image`.
    threshold : float
        Intensity on the isosurface, relative to the brightest voxel, 0.001 to 0.999.
    plotter : pyvista Plotter, optional
        Plotter to draw on, for example from `scene_3d`; by default a new one that renders off
        screen, for `save`. A volume that the plotter already shows is replaced.

    Returns
    -------
    Plotter
        Plotter in world coordinates, m. It shows the isosurface, interpolated linearly between
        voxels, and the box of the voxel centres. A new plotter looks toward the wall from the far
        end of the room, and also shows a floor grid, whose step the legend states, and the axes x,
        y and z.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.
    SamplingError
        If the intensity is zero everywhere, if an axis has fewer than two voxels, or if no voxel is
        below the threshold.

    See Also
    --------
    volume : Projections of a volume.
    nlosoptics.transient.phasor_image : Image by virtual waves, for any capture.
    """
    image = expect("image", image, "VolumeImage")
    in_range("threshold", threshold, 1e-3, 0.999)
    volume = image.volume
    if min(volume.shape) < 2:
        raise SamplingError(
            f"a volume of {volume.shape} voxels (z, y, x) has no surface, which needs two or more "
            "along each axis; use views.volume instead"
        )
    brightest = float(image.intensity.max())
    if not brightest > 0.0:
        raise SamplingError(
            "the intensity of the volume is zero everywhere, so that it has no surface; use "
            "views.volume instead"
        )
    pv = pyvista()
    axes = (volume.x, volume.y, volume.z)
    low, high = (np.array([float(axis[end]) for axis in axes]) for end in (0, -1))
    grid = pv.ImageData(
        dimensions=[len(axis) for axis in axes],
        spacing=[float(axis[1] - axis[0]) for axis in axes],
        origin=low,
    )
    # in both layouts x varies fastest
    grid.point_data["brightness"] = np.asarray(image.intensity, dtype=np.float64).ravel()
    level = threshold * brightest
    surface = grid.contour([level], scalars="brightness", method="flying_edges")
    if not surface.n_cells:
        raise SamplingError(
            f"no voxel is below threshold = {threshold:g} of the brightest; increase the threshold"
        )
    surface.point_data.clear()
    surface.point_data["z"] = np.asarray(surface.points)[:, 2]
    surface = surface.compute_normals(cell_normals=False, auto_orient_normals=False)
    alone = plotter is None
    plotter = drawn_on(plotter, f"Reconstructed volume, {image.method}")
    title = "distance from the wall (m)"
    if title in plotter.scalar_bars:
        plotter.remove_scalar_bar(title)
    plotter.add_mesh(
        surface,
        scalars="z",
        cmap=dark_viridis(),
        clim=(low[2], high[2]),
        name="hidden scene",
        smooth_shading=True,
        ambient=0.35,
        diffuse=0.65,
        scalar_bar_args=bar_style(title, fmt="%.3g"),
        reset_camera=False,
    )
    finish_bar(plotter, title)
    box = pv.Box([value for ends in zip(low, high, strict=True) for value in ends])
    plotter.add_mesh(box.extract_all_edges(), color=GREY, name="volume", **FLAT)
    middle_of_viridis = "#26828E"
    legend = {f"surface at {threshold:g} of the maximum": middle_of_viridis, "volume": GREY}
    if alone:
        legend |= add_floor(plotter, box.points, low, high, [])
    add_legend(plotter, legend)
    return plotter
