"""Data of hidden surfaces for kernels, against the meshes that they are made of."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import SceneError
from nlosoptics.raytrace import intersect_mesh
from nlosoptics.scene import Lambert, OrenNayar, SpecularMicrofacet, SumMaterial, Ward
from nlosoptics.transient.rendering.surfaces import bounce_surfaces, hidden_surfaces

MIXED = SumMaterial(Lambert(0.3), Ward(0.2, 0.15), SpecularMicrofacet(0.1, 0.08))


def triangles(count, seed, low=(-1.7, -0.6, 0.2), high=(0.4, 0.9, 1.3)):
    """A mesh of triangles that share no corner."""
    corners = np.random.default_rng(seed).uniform(low, high, (count, 3, 3))
    faces = np.arange(3 * count).reshape(-1, 3)
    return trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)


ONE, OTHER = triangles(5, 1), triangles(3, 2)
HIDDEN = hidden_surfaces([(ONE, MIXED), (OTHER, Lambert(0.7))])
POINTS = np.array([[0.3, -0.4, 0.0], [0.5, 0.1, 0.0], [0.35, 0.25, 0.0]])


def test_meshes_are_joined_in_their_order():
    assert np.array_equal(HIDDEN.corners, np.concatenate([ONE.triangles, OTHER.triangles]))
    assert HIDDEN.spans.tolist() == [[0, 3]] * 5 + [[3, 4]] * 3
    wanted = np.concatenate([MIXED.lobe_table(), Lambert(0.7).lobe_table()])
    assert np.array_equal(HIDDEN.lobes, wanted)
    assert HIDDEN.alphas == pytest.approx([math.sqrt(2.0) * 0.08] * 5 + [1.0] * 3, rel=1e-15)


@pytest.mark.parametrize(
    ("material", "alpha"),
    [
        (OrenNayar(0.5, 0.3), 1.0),
        (Ward(0.5, 0.3), 0.3),
        (Ward(0.0, 0.3), 1.0),
        (SpecularMicrofacet(0.5, 0.3, distribution="ggx"), 0.3 * math.sqrt(2.0)),
        (SumMaterial(Ward(0.2, 0.4), SpecularMicrofacet(0.3, 0.25)), 0.25 * math.sqrt(2.0)),
        (SumMaterial(SpecularMicrofacet(0.3, 0.25), Ward(0.2, 0.34)), 0.34),
    ],
)
def test_the_narrowest_lobe_of_a_triangle(material, alpha):
    assert hidden_surfaces([(ONE, material)]).alphas == pytest.approx([alpha] * 5, rel=1e-15)


def test_hits_and_shadows_of_rays():
    around = bounce_surfaces(HIDDEN, POINTS, 0.4, (3.0, 3.0))
    draw = np.random.default_rng(3)
    starts = draw.uniform((-1.7, -0.6, 1.5), (0.4, 0.9, 1.6), (60, 3))
    ends = draw.uniform((-1.7, -0.6, 0.0), (0.4, 0.9, 0.1), (60, 3))
    met = trimesh.Trimesh(around.met.vertices, around.met.faces, process=False)
    wanted = intersect_mesh(met, starts, ends - starts)
    distance, triangle = around.first_hits(starts, ends - starts)
    np.testing.assert_allclose(distance, wanted.distance, rtol=1e-12)
    assert np.array_equal(triangle, wanted.triangle)
    assert {*triangle.tolist()} >= {8, 9}  # the wall behind
    # a ray that starts on a triangle, to rounding, does not meet it
    middle = HIDDEN.corners[0].mean(axis=0)
    near = middle + 0.5 * around.gap * around.kernel.normals[0]
    found = around.first_hits(near[None], -around.kernel.normals[:1])
    assert found[1][0] != 0
    near = middle + 2.0 * around.gap * around.kernel.normals[0]
    assert around.first_hits(near[None], -around.kernel.normals[:1])[1][0] == 0


def test_meshes_may_touch_the_wall_but_not_pass_it():
    """Up to 1e-9 of the extent, which is that of the farthest coordinate of either sign."""
    corners = np.array([[-2.0, 0.1, 0.0], [0.5, 0.2, 0.0], [0.4, -0.3, 0.7]])
    for low, high, told in (
        (-1.9e-9, 0.7, None),
        (-2.1e-9, 0.7, r"reaches behind the wall, to z = -2.1e-09 m at faces\[1\], limit 0"),
        (0.0, 2.1e-9, None),
        (0.0, 1.9e-9, r"surfaces\[0\] lies in the wall z = 0 at faces\[1\]"),
    ):
        moved = corners.copy()
        moved[0, 2], moved[2, 2] = low, high
        mesh = trimesh.Trimesh(
            [*(corners + np.array([0.0, 0.0, 0.3])), *moved], [[0, 1, 2], [3, 4, 5]], process=False
        )
        if told is None:
            assert len(hidden_surfaces([(mesh, MIXED)]).corners) == 2
        else:
            with pytest.raises(SceneError, match=told):
                hidden_surfaces([(mesh, MIXED)])


def test_triangles_need_an_area():
    """Over 1e-12 of the square of their longest side."""
    for height, told in ((1.1e-12, None), (0.9e-12, r"has 1 triangle without an area, .*\[1\]")):
        line = np.array([[0.0, 0.0, 0.5], [2.0, 0.0, 0.5], [1.0, 2.0 * height, 0.5]])
        mesh = trimesh.Trimesh([*ONE.triangles[0], *line], [[0, 1, 2], [3, 4, 5]], process=False)
        if told is None:
            assert len(hidden_surfaces([(mesh, MIXED)]).corners) == 2
        else:
            with pytest.raises(SceneError, match=told):
                hidden_surfaces([(mesh, MIXED)])
