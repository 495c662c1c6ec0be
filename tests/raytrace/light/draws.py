"""Random arguments of the kernels of light paths.

Generic numbers have no symmetry, so that each operation of a kernel changes its results. Coarse
ones are multiples of 1/8 and axis-parallel directions: with them rays meet edges exactly, and
numbers that a kernel compares are often equal.
"""

import numpy as np

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
)

#: Random numbers from Philox alone.
FLAT = FlatWall(size=(2.0, 1.5))
GLOSSY = SumMaterial(Lambert(0.3), SpecularMicrofacet(0.2, 0.0), SpecularMicrofacet(0.1, 0.05))
SHINY = SumMaterial(
    Lambert(0.2),
    SpecularMicrofacet(0.3, 0.08, distribution="ggx", index=1.5),
    Ward(0.1, 0.12),
    SpecularMicrofacet(0.1, 0.3),
    SpecularMicrofacet(0.05, 0.15),
)


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
