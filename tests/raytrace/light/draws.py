"""Random arguments of the kernels of light paths.

Generic numbers have no symmetry, so that each operation of a kernel changes its results. Coarse
ones are multiples of 1/8 and axis-parallel directions: with them rays meet edges exactly, and
numbers that a kernel compares are often equal.
"""

import numpy as np

from nlosoptics.raytrace.light import _light_kernels as kernels
from nlosoptics.raytrace.light._surround_kernels import (
    BACK,
    LENS,
    LOST,
    NOTHING,
    OBJECT,
    OCCLUDER,
    ROOM,
    WALL,
)
from nlosoptics.raytrace.light.surroundings import Surroundings
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    Occluder,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
    WavyWall,
)

#: Random numbers from Philox alone.
SAMPLER = (np.uint64(3), np.zeros((0, 0, 32), dtype=np.uint64), np.zeros((0, 0), dtype=np.uint64))
SURFACES = (NOTHING, WALL, WALL, OBJECT, OBJECT, ROOM, ROOM + 1)
FLAT = FlatWall(size=(2.0, 1.5))
WAVY = WavyWall(0.02, 0.4, 0.3, direction=0.7, size=(2.0, 1.5))
GLOSSY = SumMaterial(Lambert(0.3), SpecularMicrofacet(0.2, 0.0), SpecularMicrofacet(0.1, 0.05))
SHINY = SumMaterial(
    Lambert(0.2),
    SpecularMicrofacet(0.3, 0.08, distribution="ggx", index=1.5),
    Ward(0.1, 0.12),
    SpecularMicrofacet(0.1, 0.3),
    SpecularMicrofacet(0.05, 0.15),
)
PLAIN = SumMaterial(Lambert(0.3), SpecularMicrofacet(0.2, 0.0))


class Draw:
    """Draws of arguments, generic or coarse."""

    def __init__(self, seed, coarse=False):
        self.random, self.coarse = np.random.default_rng(seed), coarse

    def numbers(self, low, high, *shape):
        if self.coarse:
            return low + (high - low) * self.random.integers(0, 9, shape) / 8
        return self.random.uniform(low, high, shape)

    def choice(self, values, *shape):
        return self.random.choice(values, shape)

    def units(self, count, toward=(0.0, 0.0, 0.0)):
        """Unit vectors, on average along a vector."""
        away = self.random.normal(size=(count, 3)) + toward
        if self.coarse:
            away = np.sign(away) * (np.abs(away) == np.abs(away).max(axis=1)[:, None])
        return away / np.linalg.norm(away, axis=1)[:, None]

    def vertices(self, count, low=-0.6, high=0.6, surfaces=SURFACES):
        found = np.zeros((count, kernels.VERTEX))
        found[:, kernels.P] = self.numbers(low, high, count, 3) + np.array([0.0, 0.0, 0.7])
        found[:, kernels.N], found[:, kernels.I] = self.units(count), self.units(count)
        cosine = (found[:, kernels.N] * found[:, kernels.I]).sum(axis=1)
        grazing, facing = cosine == 0.0, np.sign(cosine)  # lobes divide by this cosine
        found[grazing, kernels.I], facing[grazing] = found[grazing, kernels.N], 1.0
        found[:, kernels.I] *= np.where(self.random.random(count) < 0.8, facing, 1.0)[:, None]
        found[:, kernels.POWER] = self.choice((0.0, 0.5, 0.8, 1.0), count)
        found[:, kernels.DENSITY] = self.choice((-1.0, 0.0, 0.3, 0.7, 2.0), count)
        found[:, kernels.SURFACE] = self.choice(surfaces, count)
        found[:, kernels.BEFORE] = self.choice((NOTHING, WALL, OBJECT, ROOM), count)
        found[:, kernels.MET] = self.choice((0.0, 1.0), count)
        found[:, kernels.HISTORY] = self.choice((0.0, 1.0, 2.0, 3.0), count)
        for column in (kernels.SCALE, kernels.LENGTH, kernels.LIT):
            found[:, column] = self.numbers(0.5, 1.5, count)
        for column in (kernels.NARROW, kernels.BEGUN, kernels.LINKED):
            found[:, column] = self.choice((0.0, 0.2, 0.6, 1.0), count)
        return found

    def hits(self, count):
        """Distance, kind, normal, scale and lit of first hits."""
        kinds = (NOTHING, WALL, WALL, OBJECT, OBJECT, OBJECT, OBJECT, OCCLUDER, LENS, BACK, LOST)
        kinds += (ROOM, ROOM + 1)
        kind = self.choice(kinds, count).astype(np.int16)
        distance = np.where(kind == NOTHING, np.inf, self.numbers(0.3, 1.7, count))
        distance[kind == LOST] = 0.0
        scale, lit = self.numbers(0.2, 1.0, count), self.numbers(0.5, 2.5, count)
        normal = Draw(9).units(count)  # no ray meets a surface at grazing incidence
        return distance, kind, normal, scale, lit

    def leaving(self, vertices, hits):
        """Rows of `_light_kernels.scatter` for rays that leave vertices and meet hits."""
        count = len(vertices)
        found = np.zeros((count, kernels.LEAVE))
        found[:, :3] = self.units(count)
        facing = np.sign((found[:, :3] * vertices[:, kernels.N]).sum(axis=1))
        found[:, :3] *= np.where(self.random.random(count) < 0.8, facing, 1.0)[:, None]
        found[:, kernels.LOBE] = self.choice((0.0, 0.3, 0.7), count)
        found[:, kernels.PDF] = self.choice((0.0, 0.2, 0.9), count)
        found[:, kernels.MIRROR] = self.choice((-1.0, -1.0, 0.0, 0.4), count)
        found[:, kernels.AIMED] = self.choice((0.0, 0.3, 0.8), count)
        reach = self.choice((-1.0, 0.5, 0.9), count)
        found[:, kernels.REACH] = np.where(self.random.random(count) < 0.4, hits[0], reach)
        found[~np.isfinite(found[:, kernels.REACH]), kernels.REACH] = 0.9
        found[:, kernels.APART] = self.choice((0.0, 1.0), count)
        found[:, kernels.SHARE] = self.choice((0.0, 0.3, 1.0), count)
        return found


def scene(wall=FLAT, *, mesh=None, material=SHINY, paint=GLOSSY, **camera):
    """Scene of a wall, an object and occluders of two materials, all of them glossy."""
    import trimesh

    picture = np.random.default_rng(1).uniform(0.1, 1.0, (4, 6))
    place = {"position": (0.35, -0.05, 0.5), "yaw": 0.3, "pitch": 0.2}
    hidden = PlanarObject(picture, 0.6, **place, material=material)
    if mesh is not None:
        hidden = MeshObject(mesh=mesh, position=(0.3, 0.0, 0.5), material=material)
    plates = [trimesh.creation.box((0.1, 0.2, 0.04)) for _ in range(3)]
    for plate, x in zip(plates, (-0.8, 0.1, 0.7), strict=True):
        plate.apply_translation((x, 0.6, 0.4))
    options = {"position": (-0.45, 0.1, 0.6), "aim": (0.05, 0.0, 0.0), "focal_length": 0.05}
    options |= {"focus_distance": 0.9, "transmission": 0.9, "pixel_pitch": 1e-3}
    options |= {"stop_diameter": 0.3, "pixels": (120, 50), "binning": 1}
    return Scene(
        Laser(
            wavelength=633e-9,
            power=2.0,
            beam_diameter=0.02,
            position=(-0.1, 0.8, 0.9),
            aim=(0.1, 0.0, 0.0),
        ),
        wall,
        hidden,
        Camera(**options | camera),
        (
            Occluder(plates[0], material=SHINY),
            Occluder(plates[1], material=Lambert(0.4)),
            Occluder(plates[2]),
        ),
        wall_material=paint,
    )


def world(found=None, **changes):
    """Data of a scene for the kernels; rays are aimed at the object from wall and occluders."""
    given = Surroundings(scene() if found is None else found).world
    return given._replace(**{"aimed": np.array([0.3, 0.4]), "chains": 3} | changes)


def rays_to_lens(draw, camera, count):
    """Points of the lens, and unit vectors from there into the scene, around the optical axis."""
    r, turn = camera[12] * draw.numbers(0, 1, count), draw.numbers(0, 2 * np.pi, count)
    across, up = (r * np.cos(turn))[:, None], (r * np.sin(turn))[:, None]
    points = camera[:3] + across * camera[3:6] + up * camera[6:9]
    spread = draw.random.normal(0, 0.5, (count, 2))
    away = camera[9:12] + spread[:, :1] * camera[3:6] + spread[:, 1:] * camera[6:9]
    return points, away / np.linalg.norm(away, axis=1)[:, None]
