"""Captures of scene files: `render_scene`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._progress import Progress
from ...errors import SceneError
from ...scene import Lambert, MeshObject, PlanarObject, Scene, SumMaterial, TransientScan
from ..capture.capture import TransientCapture
from ..capture.wall_points import wall_grid
from .render import render

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

#: Cells across a picture before it is cut out.
PICTURE_CELLS = 64
#: Largest share of a picture's light in greys, from a tenth to nine tenths of white.
MOST_GREY = 0.1


def render_scene(
    scene: Scene,
    *,
    tol: float = 1e-3,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> TransientCapture:
    """Time-resolved light that a scene sends back to its relay wall, by `render`.

    The laser spot is a point, of 1 W (or 1 J of a pulse) on the wall; laser and camera give the
    ends of the outer legs. From five reflections on, all of the wall takes part in between. A
    picture becomes what of it is white, cut out of its plane over at most 64 cells across, and
    faces both ways. Occluders are black surfaces.

    Parameters
    ----------
    scene : Scene
        With ``transient``, a flat Lambertian wall and a mesh or a black-and-white picture.
    tol : float
        Relative error of three bounces, L1 over the bins of each pair of points.
    seed : int
    progress : callable(str, float), optional
        Told what is being done and the fraction done.
    **options
        Of `render`: ``quantity``, ``keep_laser_cosine``, ``outer_legs``, ``tol_multiple``,
        ``min_bounces``, ``n_rays``. The scene says the rest.

    Returns
    -------
    TransientCapture
        With the scene's ``wl_mean``, ``near``, ``far`` and ``step`` in ``details["picture"]``.

    Raises
    ------
    SceneError
        If the scene has no ``transient``, a wall or a picture that this cannot render, or see
        `render`.
    """
    scan = scene.transient
    if scan is None:
        raise SceneError(
            "the scene has no [transient]; add it with side, count, delta_t and n_bins"
        )
    albedo = _wall_albedo(scene, scan)
    surfaces = [(_hidden_mesh(scene.hidden), scene.hidden.material)]
    if scene.occluding_mesh is not None:
        surfaces.append((scene.occluding_mesh, Lambert(0.0)))
    grid = wall_grid(scan.side, scan.count)
    capture = render(
        surfaces,
        laser_points=scene.laser.aim if scan.scan == "single" else grid,
        sensor_points=grid,
        pairing="confocal" if scan.scan == "confocal" else "all",
        wall_albedo=albedo,
        t_start=scan.t_start,
        delta_t=scan.delta_t,
        n_bins=scan.n_bins,
        max_bounces=scan.max_bounces,
        wall_size=_wall_between(scene, scan),
        laser_origin=scene.laser.position,
        sensor_origin=scene.camera.position,
        tol=tol,
        seed=seed,
        progress=progress,
        **options,
    )
    wanted = {name: getattr(scan, name) for name in ("wl_mean", "near", "far", "step")}
    picture = {name: value for name, value in wanted.items() if value is not None}
    return capture.with_details(side=scan.side, picture=picture)


def _wall_albedo(scene: Scene, scan: TransientScan) -> float:
    """Albedo of a wall that `render` can take."""
    if not scene.wall.is_flat:
        raise SceneError(
            f"wall.shape is {type(scene.wall).__name__}, light over time is taken off flat walls; "
            'give shape = "flat"'
        )
    if scene.wall.size is not None:
        width, height = scene.wall.size
        if scan.side > min(width, height):
            raise SceneError(
                f"transient.side = {scan.side:g} m is out of range, must be at most the wall's "
                f"{min(width, height):g} m; make wall.size larger"
            )
    material = scene.wall_material
    if isinstance(material, SumMaterial) and len(material.parts) == 1:
        material = material.parts[0]
    if not isinstance(material, Lambert):
        raise SceneError(
            f"wall.material is {type(material).__name__}, light over time is taken off Lambertian "
            'walls; give lobe = "lambert" and its albedo'
        )
    return float(material.rho)


def _wall_between(scene: Scene, scan: TransientScan) -> tuple[float, float] | None:
    """Sides of the wall where light may meet it between its first and its last reflection, m."""
    if scan.max_bounces < 5:
        return None
    if scene.wall.size is None:
        raise SceneError(
            f"wall.size is missing, with transient.max_bounces = {scan.max_bounces} all of the "
            "wall takes part; give its size"
        )
    return scene.wall.size


def _hidden_mesh(hidden: MeshObject | PlanarObject) -> trimesh.Trimesh:
    return hidden.surface if isinstance(hidden, MeshObject) else cut_out(hidden)


def cut_out(picture: PlanarObject) -> trimesh.Trimesh:
    """Triangles of the white of a picture, m, world.

    Raises
    ------
    SceneError
        If more than a tenth of its light is in greys, or it has no white.
    """
    import trimesh

    bright = picture.reflectance
    grey = float(bright[(bright > 0.1) & (bright < 0.9)].sum())
    if grey > MOST_GREY * float(bright.sum()):
        raise SceneError(
            f"hidden.image has {100 * grey / float(bright.sum()):.3g} % of its light in greys, "
            f"limit {100 * MOST_GREY:g} %: light over time is taken off what is black or white; "
            "give such a picture, or hidden.mesh"
        )
    edges = [np.linspace(0, n, min(n, PICTURE_CELLS) + 1).round().astype(int) for n in bright.shape]
    sums = np.add.reduceat(np.add.reduceat(bright, edges[0][:-1], 0), edges[1][:-1], 1)
    areas = np.multiply.outer(np.diff(edges[0]), np.diff(edges[1]))
    boxes = _rectangles(2.0 * sums >= areas)
    if not boxes:
        raise SceneError("hidden.image has no white in it; give a picture of something")
    right, up, _ = picture.axes
    width, height = picture.size
    across = (edges[1] / bright.shape[1] - 0.5) * width
    upward = (0.5 - edges[0] / bright.shape[0]) * height
    corners = [
        picture.position + across[j] * right + upward[i] * up
        for top, low, left, end in boxes
        for i, j in ((top, left), (low, left), (low, end), (top, end))
    ]
    first = 4 * np.arange(len(boxes))[:, None]
    faces = (first[..., None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return trimesh.Trimesh(np.array(corners), faces, process=False)


def _rectangles(white: Any) -> list[tuple[int, int, int, int]]:
    """Few rectangles that cover the white cells once: (top, below, left, beyond)."""
    left_over = white.copy()
    boxes = []
    for i, j in np.argwhere(white):
        if not left_over[i, j]:
            continue
        row = left_over[i, j:]
        width = row.size if row.all() else int(row.argmin())
        below = left_over[i:, j : j + width].all(axis=1)
        height = below.size if below.all() else int(below.argmin())
        left_over[i : i + height, j : j + width] = False
        boxes.append((int(i), int(i) + height, int(j), int(j) + width))
    return boxes
