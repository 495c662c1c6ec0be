"""Rendering of captures from scene files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect
from ..._progress import Progress
from ...errors import SceneError
from ...scene import Lambert, MeshObject, PlanarObject, Scene, SumMaterial, TransientScan
from ...scene.parts.occluders import joined
from ..capture.capture import TransientCapture
from ..capture.wall_points import wall_grid
from .render import render
from .scan import Scan

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


def render_scene(
    scene: Scene,
    *,
    outer_legs: bool = False,
    tol: float = 1e-3,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> TransientCapture:
    """Compute the time-resolved capture of a scene: light over time at points of its relay wall.

    The scene's ``transient`` entry, a `nlosoptics.scene.TransientScan`, defines the wall points,
    the bins and the number of bounces. Times are optical paths in m, from wall to wall; with
    ``outer_legs=True`` they begin at the laser's position and end at the camera's. Values are for a
    laser of 1 W, whatever the scene's power; ``quantity`` is "irradiance", W/m^2, by default. The
    laser spot is a point. With five or more bounces, the whole wall also reflects light between
    hidden surfaces. A hidden image is converted to a mesh of its white area, of at most 64 cells
    along each side, that scatters on both sides. Occluders are further surfaces, black or of their
    material. If the scene has a ``wall_roughness``, its ``realisation`` must be ``"mean"``. Such a
    roughness has no effect here, because it does not change the reflection of a Lambertian wall.

    Parameters
    ----------
    scene : Scene
        Scene with ``transient``, a flat Lambertian wall, and a mesh or a black-and-white image.
    outer_legs : bool
        Whether times include the paths from the laser to the wall and from the wall to the camera.
    tol : float
        Error allowed for three bounces, for each pair of points: sum of the absolute errors of all
        bins, relative to the sum of the values.
    seed : int
        Seed of the random paths with more than three bounces, 0 to 2^64 - 1.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.
    **options
        Further arguments of `render`: ``quantity``, ``tol_multiple``, ``min_bounces``, ``n_rays``.
        All others follow from the scene.

    Returns
    -------
    TransientCapture
        Capture of all bounces. Where the scene gives them, ``details["picture"]`` holds the options
        for its later reconstruction: virtual wavelength ``wl_mean``, and the range of depths
        ``near`` and ``far`` with its ``step``, m.

    Raises
    ------
    SceneError
        If the scene has no ``transient``, its wall or image is unsuitable, or `render` raises.
    SamplingError, MemoryLimitError
        If `render` raises them.

    See Also
    --------
    render : Render a capture from meshes.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics import scene
    >>> from nlosoptics.transient import render_scene
    >>> place, aim = (-0.5, 0.0, 0.25), (0.0, 0.0, 0.0)
    >>> room = scene.Scene(
    ...     laser=scene.Laser(
    ...         wavelength=532e-9, power=0.1, beam_diameter=3e-3, position=place, aim=aim
    ...     ),
    ...     wall=scene.FlatWall(),
    ...     wall_material=scene.Lambert(0.8),
    ...     hidden=scene.PlanarObject(np.ones((8, 8)), 0.4, position=(0.0, 0.0, 1.0)),
    ...     camera=scene.Camera(position=place, aim=aim, focal_length=0.05, stop_diameter=0.025),
    ...     transient=scene.TransientScan(side=1.0, count=3, t_start=1.9, delta_t=0.05, n_bins=20),
    ... )
    >>> capture = render_scene(room)
    >>> capture.H.shape
    (20, 3, 3)
    """
    scene = expect("scene", scene, "Scene")
    scene.check_laser_light()
    scan = scene.transient
    if scan is None:
        raise SceneError(
            "the scene has no [transient]; add the table with side, count, delta_t and n_bins"
        )
    roughness, scene = scene.wall_roughness, scene.with_relief()
    if roughness is not None and not scene.wall.is_flat:
        raise SceneError(
            f"wall_roughness.realisation is {roughness.realisation!r}, must be 'mean' for "
            "time-resolved captures, which need a flat wall"
        )
    albedo = _wall_albedo(scene, scan)
    surfaces = [(_hidden_mesh(scene.hidden), scene.hidden.material)]
    black = joined([mesh for mesh, material in scene.occluder_surfaces if material.is_black])
    if black is not None:
        surfaces.append((black, Lambert(0.0)))
    surfaces += [found for found in scene.occluder_surfaces if not found[1].is_black]
    grid = wall_grid(scan.side, scan.count)
    capture = render(
        surfaces,
        Scan(
            laser_points=scene.laser.aim if scan.scan == "single" else grid,
            sensor_points=grid,
            pairing="confocal" if scan.scan == "confocal" else "all",
            t_start=scan.t_start,
            delta_t=scan.delta_t,
            n_bins=scan.n_bins,
            outer_legs=outer_legs,
            laser_origin=scene.laser.position,
            sensor_origin=scene.camera.position,
            wall_albedo=albedo,
            wall_size=_wall_between(scene, scan),
        ),
        max_bounces=scan.max_bounces,
        tol=tol,
        seed=seed,
        progress=progress,
        **options,
    )
    wanted = {name: getattr(scan, name) for name in ("wl_mean", "near", "far", "step")}
    picture = {name: value for name, value in wanted.items() if value is not None}
    return capture.with_details(side=scan.side, picture=picture)


def _wall_albedo(scene: Scene, scan: TransientScan) -> float:
    """Return the albedo of a flat Lambertian wall; raise if the wall is of another kind."""
    if not scene.wall.is_flat:
        raise SceneError(
            f"wall.shape is {type(scene.wall).__name__}, must be flat for time-resolved captures; "
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
            f"wall.material is {type(material).__name__}, must be Lambertian for time-resolved "
            'captures; give lobe = "lambert" and its albedo'
        )
    return float(material.rho)


def _wall_between(scene: Scene, scan: TransientScan) -> tuple[float, float] | None:
    """Return the sides of the wall that reflects between hidden surfaces, m, or None."""
    if scan.max_bounces < 5:
        return None
    if scene.wall.size is None:
        raise SceneError(
            f"wall.size is missing, with transient.max_bounces = {scan.max_bounces} the whole wall "
            "reflects; give its size in m"
        )
    return scene.wall.size


def _hidden_mesh(hidden: MeshObject | PlanarObject) -> trimesh.Trimesh:
    return hidden.surface if isinstance(hidden, MeshObject) else cut_out(hidden)


def cut_out(picture: PlanarObject) -> trimesh.Trimesh:
    """Return a mesh of the white area of a hidden image, world frame, m."""
    import trimesh

    bright = picture.reflectance
    grey = float(bright[(bright > 0.1) & (bright < 0.9)].sum())
    if grey > 0.1 * float(bright.sum()):
        raise SceneError(
            f"hidden.image has {100 * grey / float(bright.sum()):.3g} % of its reflectance in grey "
            f"pixels, limit 10 % for time-resolved captures; give a "
            "black-and-white image, or hidden.mesh"
        )
    edges = [np.linspace(0, n, min(n, 64) + 1).round().astype(int) for n in bright.shape]
    sums = np.add.reduceat(np.add.reduceat(bright, edges[0][:-1], 0), edges[1][:-1], 1)
    areas = np.multiply.outer(np.diff(edges[0]), np.diff(edges[1]))
    boxes = _rectangles(2.0 * sums >= areas)
    if not boxes:
        raise SceneError("hidden.image has no white area; give an image with bright pixels")
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
    """Cover the white cells once by few rectangles (first row, end row, first, end column)."""
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
