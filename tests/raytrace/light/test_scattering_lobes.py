"""Directions that are drawn from the lobes of a material follow the density that is claimed."""

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics.kernels.brdf import total_strength
from nlosoptics.raytrace.light import _lobe_kernels as kernels
from nlosoptics.scene import Lambert, SpecularMicrofacet, SumMaterial, Ward

PAINT = SumMaterial(Lambert(0.5), SpecularMicrofacet(0.2, 0.25), Ward(0.1, 0.3))
MIRROR = SumMaterial(Lambert(0.5), SpecularMicrofacet(0.1, 0.0), SpecularMicrofacet(0.3, 0.2))
NORMAL = np.array([0.48, -0.36, 0.8])
COMES = np.array([0.9, 0.1, 0.5]) / np.linalg.norm([0.9, 0.1, 0.5])


@pytest.mark.parametrize("z", [1.0, -1.0, 0.3, -0.6, 1e-9])
def test_tangents_and_normal_are_a_right_handed_frame(z):
    n = np.array([0.6, -0.8, 0.0]) * math.sqrt(1 - z * z) + (0.0, 0.0, z)
    a, b = np.array(kernels.tangents(tuple(n)))
    assert np.array([a, b, n]) @ np.array([a, b, n]).T == approx(np.eye(3), abs=1e-12)
    assert np.cross(a, b) == approx(n, abs=1e-12)


@pytest.mark.parametrize("eye", [False, True])
@pytest.mark.parametrize("material", [PAINT, MIRROR], ids=["paint", "mirror"])
def test_lobes_are_drawn_with_their_chances(material, eye):
    """In proportion to strength by light paths; half of eye paths choose evenly."""
    lobes = np.concatenate([material.lobe_table(), Lambert(0.0).lobe_table()])
    strength = lobes[:, 1] * lobes[:, 3]
    total = total_strength(lobes)
    assert total == approx(strength.sum())
    exact = strength / strength.sum()
    if eye:
        exact = np.where(strength > 0, exact / 2 + 0.5 / (strength > 0).sum(), 0.0)
    chances = [kernels.lobe_chance(lobes, j, total, eye) for j in range(len(lobes))]
    assert chances == approx(exact)
    if material is MIRROR:
        found = [
            kernels.lobe_direction(lobes, tuple(COMES), tuple(NORMAL), 0.3, 0.6, w, eye)
            for w in (np.arange(1000) + 0.5) / 1000
        ]
        sent = np.array([one[0] for one in found if one[1] > 0.0])
        assert len(sent) / 1000 == approx(exact[1], abs=1e-3)
        image = 2 * (COMES @ NORMAL) * NORMAL - COMES
        assert sent == approx(np.tile(image, (len(sent), 1)), abs=1e-12)
        weights = [one[1] for one in found if one[1] > 0.0]
        assert weights == approx([strength[1] / exact[1]] * len(sent))


@pytest.mark.parametrize("eye", [False, True])
def test_directions_are_as_dense_as_claimed(eye):
    """Means over stratified draws against integrals of the density over the hemisphere."""
    lobes = PAINT.lobe_table()
    places, choices = ((np.arange(count) + 0.5) / count for count in (16, 200))
    drawn = np.array(
        [
            kernels.lobe_direction(lobes, tuple(COMES), tuple(NORMAL), u, v, w, eye)[0]
            for u in places
            for v in places
            for w in choices
        ]
    )
    assert np.linalg.norm(drawn, axis=1) == approx(np.ones(len(drawn)))
    a, b = np.array(kernels.tangents(tuple(NORMAL)))
    n = 300  # disc of directions, whose area is the solid angle times the cosine
    r, turn = np.sqrt((np.arange(n) + 0.5) / n)[:, None], 2 * np.pi * (np.arange(n) + 0.5) / n
    x, y = (r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel()
    z = np.sqrt(1 - x * x - y * y)
    d = x[:, None] * a + y[:, None] * b + z[:, None] * NORMAL
    mu, between = COMES @ NORMAL, d @ COMES
    density = [kernels.lobe_density(lobes, mu, *one, eye) for one in zip(z, between, strict=True)]
    weight = np.array(density) * math.pi / n**2 / z
    above = drawn @ NORMAL > 0
    # light that a facet would send below the surface is lost to both
    assert weight.sum() == approx(above.mean(), abs=0.01)
    for moment in (
        lambda d: d @ NORMAL,
        lambda d: d @ a,
        lambda d: d @ b,
        lambda d: (d @ COMES) ** 2,
        lambda d: (d @ a) * (d @ b),
    ):
        assert (moment(drawn) * above).mean() == approx(float((weight * moment(d)).sum()), abs=0.01)


def test_narrow_lobes_are_mirrors_and_small_slopes():
    def narrow(material):
        return kernels.is_narrow(material.lobe_table(), 0)

    assert not narrow(Lambert(0.5))
    assert narrow(SpecularMicrofacet(0.2, 0.0))
    assert narrow(SpecularMicrofacet(0.2, 0.07))
    assert not narrow(SpecularMicrofacet(0.0, 0.07))
    assert not narrow(SpecularMicrofacet(0.2, 0.3))


def test_slope_of_a_facet_is_that_of_the_half_vector():
    d = np.array([-0.2, 0.7, 0.6])
    d /= np.linalg.norm(d)
    half = COMES + d
    across = half - (half @ NORMAL) * NORMAL
    exact = (across @ across) / (half @ NORMAL) ** 2
    found = kernels.facet_slope_sq(COMES @ NORMAL, d @ NORMAL, COMES @ d)
    assert found == approx(exact)
    assert kernels.facet_slope_sq(0.0, 0.0, 0.5) == math.inf
