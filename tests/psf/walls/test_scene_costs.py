"""Predicted memory of the point spread of a scene's point, against the memory that it takes."""

from dataclasses import replace

import pytest
from pytest import approx

import nlosoptics as nlos
from nlosoptics import psf
from nlosoptics.psf.transform.wide_pixels import detilted_wide_spread
from nlosoptics.psf.walls.scene_costs import smooth_cost
from nlosoptics.psf.wave.detilted import split
from nlosoptics.scene import ConvexWall, Lambert, SpecularMicrofacet, SumMaterial

SYSTEM = {"wavelength": 632.8e-9, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
PITCH = 632.8e-9 * 2 / 4  # a quarter of lambda N at F/2


@pytest.mark.thorough
@pytest.mark.parametrize(("cells", "side"), [(700, 60), (300, 400), (130, 600)])
def test_memory_of_a_wave_on_a_grid(cells, side, memory_of):
    """The largest part is the grid, the sums over its rows, or the window."""
    aberration = {4: 3e-8, 9: 2e-8}
    wave = psf.Wavefront.from_zernike(aberration, nodes="grid", samples=cells, **SYSTEM)
    options = {"pitch": PITCH, "shape": (side, side), "tol": 1e-3}
    stated = smooth_cost(split(wave), **options).n_bytes
    peak, _ = memory_of(lambda: detilted_wide_spread(split(wave), **options))
    assert 0.8 * stated < peak < 1.1 * stated
    # a finer grid that is not sampled yet
    finer = smooth_cost(split(wave), **options, cells=2 * cells)
    wave = psf.Wavefront.from_zernike(aberration, nodes="grid", samples=2 * cells, **SYSTEM)
    assert finer.n_bytes == approx(smooth_cost(split(wave), **options).n_bytes, rel=1e-12)


def spread_stage(scene, tol=1e-4):
    """Point spread's stage of a plan."""
    return next(s for s in nlos.plan(scene, tol=tol).stages if s.name == "point spread")


def blurred(scene, wall):
    lobe = SpecularMicrofacet(0.05, 2e-4)
    return replace(scene, wall=wall, wall_material=SumMaterial(Lambert(0.7), lobe))


@pytest.mark.parametrize("radius", [0.0, 40.0])
def test_plan_bounds_the_memory_of_a_blurred_image(flat_scene, radius, memory_of):
    """Pixels are much wider than the image, so that an aberration needs several lattices."""
    scene = blurred(flat_scene, ConvexWall(radius) if radius else flat_scene.wall)
    optics = psf.SceneOptics(scene)
    peak, _ = memory_of(lambda: psf.scene_point_spread(optics, tol=1e-4))
    stated = spread_stage(scene).memory
    assert 0.05 * stated < peak < stated
