"""Wu's scene with Lambertian walls and a letter of triangles, and its flux by plain quadrature.

python benchmarks/wu_scene.py          prints the detected flux by the number of reflections

The geometry is that of examples/scenes/letter_flat.toml. Lambert everywhere, so that every renderer
can model it; no field stop, so that the detector alone bounds the field, to a rectangle.
"""

from __future__ import annotations

import math

import numpy as np

WALL = (1.4, 1.0)  # m, x and y
WALL_ALBEDO, LETTER_ALBEDO = 0.7, 0.8
POWER, WAVELENGTH, BEAM, INCIDENCE = 5e-3, 632.8e-9, 3e-3, math.radians(15)
SPOT = np.array([0.64, 0.0, 0.0])
LETTER = np.array([0.54433, 0.0, 1.0])
CELL = 0.01  # m, side of the letter's cells, two triangles each
#: Strokes of the F seen from the wall, in cells: left, right (its own), bottom, top.
STROKES = ((-10, -4, -15, 16), (-4, 10, 10, 16), (-4, 7, -2, 4))
CAMERA = np.array([-0.43546, 0.0, 0.8])  # looks at the origin
SENSOR = 36.864e-3  # m, side
FOCAL_LENGTH = SENSOR / 2 / math.tan(math.radians(20))
FOCUS, STOP, TRANSMISSION = 2.05, 25e-3, 0.9


def letter_triangles():
    """Vertices (n, 3), m, and faces (m, 3) of a flat F around its position, facing the wall."""
    cells = np.concatenate(
        [
            np.stack(np.meshgrid(np.arange(a, b), np.arange(c, d)), -1).reshape(-1, 2)
            for a, b, c, d in STROKES
        ]
    )
    corners = cells[:, None] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    nodes, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    index = index.reshape(-1, 4)
    # counterclockwise as a viewer at the wall sees it, whose right is -x: the normals are -z
    faces = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
    vertices = np.column_stack([-nodes[:, 0], nodes[:, 1], np.zeros(len(nodes))]) * CELL
    return vertices, faces


def scene():
    """The same as `nlosoptics.scene.Scene`."""
    import trimesh

    from nlosoptics.scene import Camera, FlatWall, Lambert, Laser, MeshObject, Scene

    vertices, faces = letter_triangles()
    return Scene(
        Laser(
            wavelength=WAVELENGTH,
            power=POWER,
            beam_diameter=BEAM,
            position=tuple(SPOT + 1.2 * np.array([math.sin(INCIDENCE), 0, math.cos(INCIDENCE)])),
            aim=tuple(SPOT),
        ),
        FlatWall(size=WALL),
        MeshObject(
            mesh=trimesh.Trimesh(vertices, faces, process=False),
            position=tuple(LETTER),
            material=Lambert(LETTER_ALBEDO),
        ),
        Camera(
            position=tuple(CAMERA),
            aim=(0.0, 0.0, 0.0),
            focal_length=FOCAL_LENGTH,
            stop_diameter=STOP,
            transmission=TRANSMISSION,
            focus_distance=FOCUS,
        ),
        wall_material=Lambert(WALL_ALBEDO),
    )


def rectangle(low, high, nodes):
    """Gauss-Legendre points (n, 2) and weights (n,) of a rectangle."""
    t, w = np.polynomial.legendre.leggauss(nodes)
    (x, wx), (y, wy) = (
        ((a + b) / 2 + (b - a) / 2 * t, (b - a) / 2 * w) for a, b in zip(low, high, strict=True)
    )
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2), np.outer(wy, wx).ravel()


def disc(radius, rings):
    """Points (n, 2) and weights (n,) of a disc: Gauss in r^2, trapezoid in angle."""
    t, w = np.polynomial.legendre.leggauss(rings)
    r, angle = radius * np.sqrt((1 + t) / 2), np.arange(4 * rings) * (math.pi / (2 * rings))
    points = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], -1)
    return points.reshape(-1, 2), np.repeat(w / 2 * math.pi * radius**2 / (4 * rings), 4 * rings)


def gather(targets, sources, power):
    """Irradiance of points that face the planes of sources which face them, along z.

    ``power`` (n,) is radiant exitance times area, W, of Lambertian ``sources`` (n, 3).
    """
    away = targets[:, None] - sources
    square = (away**2).sum(axis=-1)
    return (away[..., 2] ** 2 / (math.pi * square**2)) @ power


def letter_nodes(nodes):
    """Quadrature points (n, 3) and areas (n,) of the letter."""
    parts = [rectangle((CELL * a, CELL * c), (CELL * b, CELL * d), nodes) for a, b, c, d in STROKES]
    flat = np.concatenate([points for points, _ in parts])
    points = LETTER + np.column_stack([-flat[:, 0], flat[:, 1], np.zeros(len(flat))])
    return points, np.concatenate([areas for _, areas in parts])


def field_nodes(nodes, rings, stop):
    """Wall points (n, 3) that detector and lens see, and their share of flux per radiance, m^2 sr.

    A ray from the lens point u to the point p of the plane in focus carries
    L cos^2/r^2 dA_u dA_p = L s^2/r^4 dA_u dA_p, with r from u to p, s the focus distance.
    """
    axis = -CAMERA / math.dist(CAMERA, (0, 0, 0))
    e1 = np.cross((0.0, 1.0, 0.0), axis)
    e1 /= math.sqrt(e1 @ e1)
    frame = np.stack([e1, np.cross(axis, e1)])
    image_distance = FOCAL_LENGTH * FOCUS / (FOCUS - FOCAL_LENGTH)
    half = SENSOR / 2 * FOCUS / image_distance
    (p, wp), (u, wu) = rectangle((-half,) * 2, (half,) * 2, nodes), disc(stop / 2, rings)
    lens = (CAMERA + u @ frame)[:, None]
    ray = CAMERA + FOCUS * axis + p @ frame - lens
    extent = FOCUS**2 / (ray**2).sum(axis=-1) ** 2 * wp * wu[:, None]
    points = lens - ray * (lens[..., 2:] / ray[..., 2:])
    # the scene's own field ends within the wall; that of a much wider lens does not
    extent *= (abs(points[..., :2]) < np.divide(WALL, 2)).all(axis=-1)
    return points.reshape(-1, 3), extent.ravel()


def flux(*, letter=10, field=20, rings=2, wall=32, spot=3, stop=STOP):
    """Detected power, W, by reflections: {3: wall, letter, wall; 5: twice by way of the letter}.

    Letter and wall are parallel planes, so there are no other paths of up to 5 reflections, nothing
    hides anything, and every integrand is smooth: the quadrature converges exponentially.
    """
    ellipse, area = disc(BEAM / 2, spot)
    stretch = 1 / math.cos(INCIDENCE)
    lit = SPOT + np.column_stack([ellipse[:, 0] * stretch, ellipse[:, 1], np.zeros(len(area))])
    letters, cells = letter_nodes(letter)
    seen, extent = field_nodes(field, rings, stop)
    flat, patches = rectangle(np.multiply(WALL, -0.5), np.multiply(WALL, 0.5), wall)
    walls = np.column_stack([flat, np.zeros(len(flat))])

    on_letter = gather(letters, lit, WALL_ALBEDO * POWER * area / area.sum())
    found = {}
    for reflections in (3, 5):
        leaving = LETTER_ALBEDO * on_letter * cells
        radiance = WALL_ALBEDO / math.pi * gather(seen, letters, leaving)
        found[reflections] = TRANSMISSION * float(radiance @ extent)
        on_letter = gather(letters, walls, WALL_ALBEDO * gather(walls, letters, leaving) * patches)
    return found


def main():
    """Print the flux, and how far it changes with the quadrature."""
    coarse, fine = flux(letter=7, field=14, wall=24, rings=1, spot=2), flux()
    for reflections, value in fine.items():
        change = abs(coarse[reflections] / value - 1)
        print(f"{reflections} reflections: {value:.10e} W (coarser quadrature: {change:.0e} off)")


if __name__ == "__main__":
    main()
