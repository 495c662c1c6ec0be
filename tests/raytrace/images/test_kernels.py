"""Kernels of traced images with random arguments, on record."""

import numpy as np
import pytest

from nlosoptics.raytrace.images import _image_kernels as images
from nlosoptics.raytrace.light import _light_kernels as kernels
from nlosoptics.raytrace.light import _surround_kernels as surround
from nlosoptics.scene import Lambert, SpecularMicrofacet, SumMaterial

from ..light.draws import Draw, rays_to_lens, scene, world

COUNT, FIRST = 400, 2048
METAL = SumMaterial(
    SpecularMicrofacet(0.5, 0.0, index=1.2 + 6.0j),
    SpecularMicrofacet(0.3, 0.3, index=1.5),
    Lambert(0.15),
)


@pytest.mark.parametrize("outer", [False, True])
@pytest.mark.parametrize("coarse", [False, True])
def test_pixels_and_bins(coarse, outer, on_record):
    draw, camera = Draw(5, coarse), world().camera.copy()
    camera[16] *= 1.1
    ends, away = rays_to_lens(draw, camera, COUNT)
    power, last = draw.choice((0.0, 0.4, 1.2), COUNT), draw.vertices(COUNT)
    last[:, kernels.P] = ends + draw.numbers(0.3, 1.5, COUNT, 1) * away
    length, legs = draw.numbers(1.0, 4.0, COUNT), draw.numbers(0.25, 0.75, COUNT)
    layers = (draw.choice((0, 1, 2), COUNT).astype(np.int64), 3)
    cells, slots, rays = np.zeros((3, COUNT), dtype=np.int64)
    powers = np.zeros(COUNT)
    count = images.sort_light(
        *(camera, FIRST + 7, layers, power, length, legs, last, ends, (5, 12)),
        *((1.25, 0.125, 14, outer), cells, slots, powers, rays),
    )
    on_record([count, cells, slots, powers, rays], 1e-8)


@pytest.mark.parametrize(("n_light", "m"), [(1, 1), (2, 2), (1, 2), (2, 3), (1, 3)])
def test_polarisation(n_light, m, on_record):
    draw = Draw(6)
    given = world(scene(material=METAL, paint=METAL))
    vertices = np.stack(
        [draw.vertices(COUNT, surfaces=(surround.WALL, surround.OBJECT)) for _ in range(m)]
    )
    ends, _ = rays_to_lens(draw, given.camera, COUNT)
    path = np.concatenate([vertices[..., kernels.P], ends[None]])
    for j in range(m):  # normals that face both neighbours, mostly
        before = vertices[0, :, kernels.I] if j == 0 else path[j - 1] - path[j]
        both = [
            one / np.linalg.norm(one, axis=1)[:, None] for one in (before, path[j + 1] - path[j])
        ]
        normal = both[0] + both[1] + draw.random.normal(0, 0.4, (COUNT, 3))
        vertices[j, :, kernels.N] = normal / np.linalg.norm(normal, axis=1)[:, None]
    power, out = draw.choice((0.0, 0.4, 1.2), COUNT), np.zeros((COUNT, 4))
    mirrored = draw.choice((False, True), COUNT)
    laser, axis = (1.0, 0.5, -0.3, 0.6), (0.6, 0.0, 0.8)
    images.path_stokes(given, power, vertices, n_light, mirrored, ends, laser, axis, out)
    on_record([out, *out.T.copy()], 1e-8)
