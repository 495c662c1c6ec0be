"""Hybrid of waves and rays: energies, positions in the image, and limits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.walls.hybrid import mirror_image
from nlosoptics.raytrace import trace_point
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    Laser,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)

POINT = (0.35, 0.05, 1.0)
MIRROR = SpecularMicrofacet(0.05, 0.0)
PAINT = SumMaterial(OrenNayar(0.6, 0.3), MIRROR)
LAYERS = SumMaterial(Lambert(0.6), SpecularMicrofacet(0.04, 0.01), SpecularMicrofacet(0.03, 0.0))
#: A window of 41 pixels of 18 um.
WINDOW = {"pitch": 18e-6, "shape": 41}


def wall_scene(material, wall=None, **camera):
    """A small stop, so that pixels are not many Airy discs wide."""
    options = {"pixels": (1024, 1024), "pixel_pitch": 36e-6, "binning": 64}
    options |= {"stop_diameter": 0.004, "aim": (-0.05, 0.0, 0.0), "focal_length": 0.05}
    return Scene(
        Laser(wavelength=633e-9, power=1.0, beam_diameter=1e-3, position=(-0.2, 0.1, 0.9)),
        FlatWall(size=(1.2, 0.9)) if wall is None else wall,
        PlanarObject(np.ones((3, 3)), 0.1, position=POINT),
        Camera(position=(-0.5, 0.0, 0.8), **options | camera),
        wall_material=material,
    )


def mirror(scene, normal):
    """Mirror image of the scene's reference point."""
    seen = psf.SceneOptics(scene).reference
    return mirror_image(seen, seen.first, normal)


def screen():
    """A black plate between wall and object that leaves the mirror image free."""
    return trimesh.creation.box(
        (0.3, 0.5, 0.01), transform=trimesh.transformations.translation_matrix((0.45, 0.0, 0.1))
    )


SCENES = {
    "flat": lambda m: wall_scene(m),
    "convex": lambda m: wall_scene(m, ConvexWall(3.0, size=(1.2, 0.9))),
    "concave": lambda m: wall_scene(m, ConcaveWall(4.0, size=(1.2, 0.9))),
    "occluder": lambda m: replace(wall_scene(m), occluders=(screen(),)),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("material", [PAINT, LAYERS], ids=["paint", "layers"])
def test_parts_add_to_what_a_trace_of_all_lobes_finds(name, material):
    found = psf.hybrid_point_spread(SCENES[name](material), n_rays=1 << 16, **WINDOW)
    assert found.coherent_flux + found.halo_flux + found.diffuse_flux == approx(1.0, rel=1e-12)
    assert found.coherent_flux > 0.02
    assert (found.halo_flux > 0.03) == (material is LAYERS)
    error = math.hypot(found.traced_flux_error, found.diffuse_flux_error)
    assert error < 4e-3
    # the halo's flux is that of a smooth mirror to 2 slope_rms^2 = 2e-4 of itself
    assert found.traced_flux == approx(1.0, abs=4 * error + 2e-5)


@pytest.mark.thorough
def test_concave_wall_has_its_interreflections():
    scene = SCENES["concave"](SumMaterial(Lambert(0.9), MIRROR))
    one, three = (
        psf.hybrid_point_spread(scene, max_bounces=n, n_rays=1 << 17, **WINDOW) for n in (1, 3)
    )
    more = three.flux * three.diffuse_flux - one.flux * one.diffuse_flux
    # the same seed sends the same rays to the first reflection, so they leave no difference
    traced = trace_point(scene, n_rays=1 << 17, max_bounces=3, shape=(1, 1), seed=1)
    error = math.sqrt(2.0) * np.linalg.norm(traced.by_bounce_error[2:])
    assert more > 8 * error
    assert more == approx(traced.by_bounce[2:].sum(), abs=4 * error)
    assert three.diffuse.sum() * three.flux > one.diffuse.sum() * one.flux


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["flat", "convex", "concave"])
def test_mirror_alone_is_its_wave(name):
    """Nothing but the wave, which carries what the rays do."""
    scene = SCENES[name](MIRROR)
    found = psf.hybrid_point_spread(scene, n_rays=1 << 17, **WINDOW)
    assert found.coherent_flux == approx(1.0, abs=2e-3 if name == "concave" else 1e-15)
    assert found.traced_flux == approx(1.0, abs=4 * found.traced_flux_error)
    assert found.traced_flux_error < 2e-3
    side = 9  # where the wave is above tol = 1e-3 of its peak
    wave = psf.point_spread(
        psf.wavefront(scene), pitch=18e-6, shape=side, pixel_integrated=True, tol=1e-3
    )
    middle = slice(20 - side // 2, 20 + side // 2 + 1)
    off = np.abs(found.coherent[middle, middle] / found.coherent_flux - wave.intensity)
    # both are within tol of the truth, and the window's edge leaves out as much
    assert off.max() < 2e-3 * wave.intensity.max()
    assert found.intensity.sum() == approx(found.enclosed_energy, rel=1e-12)
    relative = psf.hybrid_point_spread(scene, normalisation="flux", check=False, **WINDOW)
    assert relative.coherent_flux == approx(0.05, rel=1e-12)
    assert relative.traced_flux_error == math.inf


@pytest.mark.parametrize("height", [20e-9, 60e-9, 2e-6])
def test_roughness_shares_the_mirror(height):
    """``exp(-s^2)`` coherent, the rest in the closed-form halo."""
    scene, roughness = wall_scene(MIRROR), psf.Roughness(height, 100 * height)
    found = psf.hybrid_point_spread(scene, roughness=roughness, check=False, **WINDOW)
    s = 2 * math.pi / 633e-9 * psf.wall_view(scene).cos_sum * height
    assert found.coherent_flux == approx(math.exp(-(s**2)), rel=1e-12)
    assert found.halo_flux == approx(-math.expm1(-(s**2)), rel=1e-12)
    mean = psf.mean_point_spread(scene, roughness, pixel_integrated=True, tol=1e-4, **WINDOW)
    off = np.abs(found.intensity - mean.intensity)
    assert off.max() < 2e-3 * mean.intensity.max()  # tol of the hybrid, twice
    assert found.halo.sum() == approx(mean.diffuse.sum(), rel=5e-3)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "lobe", [SpecularMicrofacet(0.05, 0.01), Ward(0.05, 0.01 * math.sqrt(2.0))], ids=str
)
def test_halo_of_a_slope_is_where_the_rays_land(lobe):
    """The closed form of Gaussian slopes against rays that the microfacets scatter."""
    scene = wall_scene(lobe)
    found = psf.hybrid_point_spread(scene, pitch=2e-4, shape=41, check=False)
    image = mirror(scene, np.array([0.0, 0.0, -1.0])).image
    first = tuple(np.subtract(image, 20 * 2e-4))
    rays = trace_point(scene, n_rays=1 << 18, pitch=2e-4, shape=(41, 41), first=first)
    assert found.halo_flux == approx(1.0, rel=1e-12)
    landed = rays.energy / rays.flux
    axis = 2e-4 * (np.arange(41) - 20)
    for k in (0, 1):
        wave, ray = (part.sum(axis=k) for part in (found.halo, landed))
        widths = [math.sqrt((axis**2 * part).sum() / part.sum()) for part in (wave, ray)]
        # first order in slope and field angle: some sigma = 1 %; rays tell it to 0.5 %
        assert widths[0] == approx(widths[1], rel=0.02)
        # the lobes' cosines tilt the halo by some sigma of its width
        assert (axis * wave).sum() == approx((axis * ray).sum(), abs=0.03 * widths[0])
    bright = found.halo > 0.5 * found.halo.max()
    assert found.halo[bright].sum() == approx(landed[bright].sum(), rel=0.03)


#: So far from each wall's image that it is a disc of some 10 pixels across.
FOCUS = {"flat": 1.5, "convex": 1.3, "concave": 2.3}


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["flat", "convex", "concave"])
def test_rays_land_where_the_wave_does(name):
    """The centre pixel lies on the chief ray, for rays of the same camera's detector."""
    scene = SCENES[name](MIRROR)
    camera = replace(scene.camera, focus_distance=FOCUS[name], stop_diameter=0.015)
    scene = replace(scene, camera=camera)
    image = mirror(scene, None).image
    first = tuple(np.subtract(image, 20 * 18e-6))
    rays = trace_point(scene, pitch=18e-6, shape=(41, 41), first=first)
    axis = 18e-6 * (np.arange(41) - 20)
    found = psf.hybrid_point_spread(scene, check=False, **WINDOW)
    for k in (0, 1):
        ray, wave = rays.energy.sum(axis=k), found.coherent.sum(axis=k)
        centres = [(axis * part).sum() / part.sum() for part in (ray, wave)]
        assert centres[0] == approx(centres[1], abs=1e-6)
        # fringes of a disc of 5 pixels and more, and the wave's tails beyond the window
        shares = [np.cumsum(part) / part.sum() for part in (ray, wave)]
        assert np.abs(shares[0] - shares[1]).max() < 0.04


def test_matt_wall_needs_no_wave_part():
    scene = wall_scene(Lambert(0.6))
    found = psf.hybrid_point_spread(scene, n_rays=1 << 16)
    assert found.diffuse_flux == 1.0
    assert found.error_estimate == 0.0
    assert not found.coherent.any()
    assert not found.halo.any()
    rays = trace_point(scene, mirror_image=False, n_rays=1 << 16)
    assert found.flux == rays.flux
    # the windows' centres differ, their light overlaps
    assert found.diffuse.sum() == approx(rays.energy.sum() / rays.flux, rel=0.3)
    assert (found.standard_error[found.diffuse > 0] > 0).all()


def test_occluded_image_leaves_the_rest():
    """A plate close to where the wall shows the point takes the image and a little more."""
    scene = wall_scene(PAINT)
    hit = mirror(scene, None)
    assert hit.flux > 0.0
    line = np.subtract(scene.camera.position, POINT)
    spot = np.add(POINT, line * 1.0 / 1.8)
    x, y = float(spot[0]), float(spot[1])
    plate = trimesh.creation.box((0.04, 0.04, 1e-3))
    plate.apply_translation((x, y, 0.01))
    found = psf.hybrid_point_spread(replace(scene, occluders=(plate,)), **WINDOW)
    assert found.coherent_flux == 0.0
    error = math.hypot(found.traced_flux_error, found.diffuse_flux_error)
    assert found.traced_flux == approx(1.0, abs=4 * error)
    half = trimesh.creation.box((0.04, 0.04, 1e-3))
    # its edge meets the middle of the light on its way to the wall
    half.apply_translation((x + 0.02 + 0.01 * (POINT[0] - x), y, 0.01))
    with pytest.raises(SceneError, match="occluders cut"):
        psf.hybrid_point_spread(replace(scene, occluders=(half,)), **WINDOW)


@pytest.mark.thorough
def test_field_stop_takes_all_or_nothing():
    scene = wall_scene(PAINT, field_stop=0.6)
    assert psf.hybrid_point_spread(scene, **WINDOW).coherent_flux > 0.0
    away = wall_scene(PAINT, aim=(0.25, 0.0, 0.0), field_stop=0.3)
    found = psf.hybrid_point_spread(away, check=False, **WINDOW)
    assert found.coherent_flux == 0.0
    with pytest.raises(SceneError, match="'flux' needs a mirror image"):
        psf.hybrid_point_spread(away, normalisation="flux", check=False, **WINDOW)


@pytest.mark.thorough
def test_threads_change_no_bit(on_threads):
    options = {"pitch": 36e-6, "shape": 21, "n_rays": 20000}
    one, two = (
        on_threads(n, lambda: psf.hybrid_point_spread(SCENES["concave"](LAYERS), **options))
        for n in (1, 2)
    )
    assert one.intensity.tobytes() == two.intensity.tobytes()
    for name in ("flux", "diffuse_flux", "traced_flux", "traced_flux_error"):
        assert getattr(one, name) == getattr(two, name)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"object_point": (0.0, np.nan, 1.0)}, "not finite"),
        ({"object_point": (0.0, 0.0, -1.0)}, "behind the wall"),
        ({"n_rays": 0}, "n_rays"),
        ({"max_bounces": 0}, "max_bounces"),
        ({"tol": 0.0}, "tol"),
        ({"pitch": 0.0}, "pitch"),
        ({"shape": 0}, "shape"),
        ({"seed": -1}, "seed"),
        ({"emission": "laser"}, "emission"),
        ({"normalisation": "ideal-peak"}, "normalisation"),
    ],
)
def test_bad_input_is_told(options, message):
    with pytest.raises(SceneError, match=message):
        psf.hybrid_point_spread(wall_scene(PAINT), **options)
