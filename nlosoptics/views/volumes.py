"""Reconstructed volumes: projections along an axis, and the surface around bright voxels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import in_range, one_of
from ..errors import SamplingError
from .canvas import new_axes, round_step
from .maps import colour_bar
from .rays import dark_viridis
from .room_parts import floor_grid, triad
from .stages import INK, add_legend, bar_style, finish_bar, look_at, new_plotter, pyvista

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pyvista import Plotter

    from ..transient import VolumeImage

#: Across and up of each view, with the side that it is seen from.
VIEWS = {
    "z": ("x", "y", "from the wall"),
    "y": ("x", "z", "from above"),
    "x": ("z", "y", "from the side"),
}

BAR = "distance from the wall (m)"
BOX, GRID = "#707070", "#a8a8a8"
FLAT: dict[str, Any] = {"lighting": False}


def volume(image: VolumeImage, *, axis: str = "z", axes: Axes | None = None) -> Axes:
    """Draw the brightest voxels along an axis.

    Parameters
    ----------
    image : VolumeImage
        What to draw.
    axis : {"z", "y", "x"}
        Along which: from the wall into the room, from above, or from the side.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        World coordinates in m. Seen from the wall and from above, x grows to the left, so that
        letters read; colours are relative to the brightest voxel.
    """
    one_of("axis", axis, VIEWS)
    across, up, title = VIEWS[axis]
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
    colour_bar(axes, drawn, "relative brightness")
    axes.set(xlabel=f"{across} (m)", ylabel=f"{up} (m)", title=title)
    return axes


def _ends(values: Any) -> tuple[float, float]:
    """Where the cells of an axis begin and end, m; 1 cm for a single one."""
    half = 0.5 * float(np.diff(values[:2])[0]) if len(values) > 1 else 0.005
    return float(values[0]) - half, float(values[-1]) + half


def phasor_volume(
    image: VolumeImage, *, threshold: float = 0.25, plotter: Plotter | None = None
) -> Plotter:
    """Draw the surface around the bright voxels of a volume, coloured by their depth.

    Parameters
    ----------
    image : VolumeImage
        What to draw, such as a `transient.PhasorImage`.
    threshold : float
        Where the surface is, of the brightest voxel, 0.001 to 0.999.
    plotter : pyvista Plotter, optional
        Where to draw, such as a room of `scene_3d`; a new one off the screen by default. A volume
        that it already shows is replaced.

    Returns
    -------
    Plotter
        World coordinates in m, seen from the room's far end where nothing else is drawn: the
        surface, which runs linearly between voxels, the box of voxel centres, a grid on its floor
        whose step the legend names, and the axes.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.
    SamplingError
        If the volume is dark, has fewer than two voxels along an axis, or none above the threshold
        beside one below.
    """
    in_range("threshold", threshold, 1e-3, 0.999)
    volume = image.volume
    if min(volume.shape) < 2:
        raise SamplingError(
            f"a volume of {volume.shape} voxels (z, y, x) has no surface; give two or more along "
            "each axis, or draw views.volume"
        )
    brightest = float(image.intensity.max())
    if not brightest > 0.0:
        raise SamplingError("the volume is dark everywhere, so nothing can be drawn")
    pv = pyvista()
    axes = (volume.x, volume.y, volume.z)
    low, high = (np.array([float(axis[end]) for axis in axes]) for end in (0, -1))
    grid = pv.ImageData(
        dimensions=[len(axis) for axis in axes],
        spacing=[float(axis[1] - axis[0]) for axis in axes],
        origin=low,
    )
    # x runs fastest in both
    grid.point_data["brightness"] = np.asarray(image.intensity, dtype=np.float64).ravel()
    level = threshold * brightest
    surface = grid.contour([level], scalars="brightness", method="flying_edges")
    if not surface.n_cells:
        raise SamplingError(
            f"no voxel is below threshold = {threshold:g} of the brightest; raise it"
        )
    surface.point_data.clear()
    surface.point_data["z"] = np.asarray(surface.points)[:, 2]
    surface = surface.compute_normals(cell_normals=False, auto_orient_normals=False)
    alone = plotter is None
    if plotter is None:
        plotter = new_plotter(f"Hidden scene by {image.method}")
    if BAR in plotter.scalar_bars:
        plotter.remove_scalar_bar(BAR)
    plotter.add_mesh(
        surface,
        scalars="z",
        cmap=dark_viridis(),
        clim=(low[2], high[2]),
        name="hidden scene",
        smooth_shading=True,
        ambient=0.35,
        diffuse=0.65,
        scalar_bar_args=bar_style(BAR, fmt="%.3g"),
        reset_camera=False,
    )
    finish_bar(plotter, BAR)
    box = pv.Box([value for ends in zip(low, high, strict=True) for value in ends])
    plotter.add_mesh(box.extract_all_edges(), color=BOX, name="volume", **FLAT)
    legend = {f"{threshold:g} of the brightest voxel or more": "#26828e", "volume": BOX}
    if alone:
        step = round_step(float((high - low).max()) / 6)
        floor = floor_grid(low, high, step)
        plotter.add_mesh(floor, color=GRID, line_width=1, name="floor grid", **FLAT)
        legend[f"floor grid, {step:g} m"] = GRID
        frame = look_at(plotter, np.concatenate([[low, high], floor.points, box.points]), [])
        leftmost = floor.points[np.argmin(floor.points @ frame[0])]
        plotter.add_mesh(triad(leftmost, 0.6 * step, frame), color=INK, name="axes", **FLAT)
    add_legend(plotter, legend)
    return plotter
