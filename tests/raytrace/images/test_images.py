"""Traced images and histograms: waves, quadrature, a plain walk, totals, statistics, bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.ndimage
import trimesh
from pytest import approx

from nlosoptics import imaging, psf, views
from nlosoptics.errors import SceneError
from nlosoptics.imaging.geometry import chief_rays, pixel_centres
from nlosoptics.imaging.radiometry import laser_spot, spot_power_through_lens
from nlosoptics.imaging.stray import spot_image
from nlosoptics.psf.pupil.exit_pupil import working_f_number
from nlosoptics.raytrace import trace, trace_image
from nlosoptics.scene import (
    Camera,
    ConvexWall,
    FlatWall,
    Lambert,
    Laser,
    MeshWall,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    WavyWall,
)
from nlosoptics.transient import Scan, render
from nlosoptics.transient.rendering.scene import cut_out

#: No symmetry, so that a turned or mirrored image is seen.
PICTURE = np.array(
    [[1.0, 1.0, 1.0, 0.2], [1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.4, 0.0], [0.7, 0.0, 0.0, 0.0]]
)
PAINT = SumMaterial(Lambert(0.6), SpecularMicrofacet(0.2, 0.0))
BINS = {"t_start": 1.5, "delta_t": 0.25, "n_bins": 20}


def mesh_wall():
    """A shallow bowl of triangles, through which the wall fits a smooth surface."""
    x, y = np.meshgrid(*2 * [np.linspace(-1.25, 1.25, 41)])
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    lower = np.stack([corner, corner + 1, corner + 42], 1)
    upper = np.stack([corner, corner + 42, corner + 41], 1)
    points = np.stack([x, y, 0.02 * x**2 + 0.01 * x * y - 0.015 * y**2], -1).reshape(-1, 3)
    return MeshWall(trimesh.Trimesh(points, np.concatenate([lower, upper]), process=False))


WALLS = {
    "flat": lambda: FlatWall(size=2.4),
    "convex": lambda: ConvexWall(6.0, size=2.4),
    "wavy": lambda: WavyWall(2e-3, 0.5, size=2.4),
    "mesh": mesh_wall,
}


def room(wall, occluders=(), *, binning=16, spot=(0.0, 0.45), stop=4e-3, **changes):
    """A room whose camera sees letter and laser spot by the wall, with a small lens."""
    return Scene(
        Laser(
            wavelength=633e-9,
            power=0.5,
            beam_diameter=5e-3,
            position=(spot[0], 1.0, 0.9),
            aim=(*spot, 0.0),
        ),
        wall,
        PlanarObject(PICTURE, 0.6, position=(0.5, 0.0, 1.0), material=Lambert(0.8), **changes),
        Camera(
            position=(-0.55, 0.0, 1.0),
            aim=(0.0, 0.03, 0.0),
            focal_length=0.05,
            stop_diameter=stop,
            pixel_pitch=8e-5,
            pixels=(256, 256),
            binning=binning,
            dark_current=20.0,
        ),
        occluders=occluders,
        wall_material=PAINT,
    )


def plate(low, high, z):
    """A black rectangle parallel to the wall, from one corner (x, y) to the other."""
    corners = [(low[0], low[1], z), (high[0], low[1], z), (*high, z), (low[0], high[1], z)]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


#: One hides a part of the object from the wall, the other a part of the wall from the lens.
OCCLUDERS = (plate((0.25, -0.02), (0.4, 0.1), 0.5), plate((-0.35, -0.3), (-0.25, -0.15), 0.4))


def binned(values, n):
    """Sums over n x n pixels."""
    ny, nx = values.shape
    return values.reshape(ny // n, n, nx // n, n).sum(axis=(1, 3))


# waves


@pytest.mark.thorough
@pytest.mark.parametrize("occluders", [(), OCCLUDERS], ids=["free", "occluders"])
@pytest.mark.parametrize("wall", WALLS)
def test_every_pixel_agrees_with_the_image_by_waves(wall, occluders):
    scene = room(WALLS[wall](), occluders)
    found = trace_image(scene, n_rays=1 << 17, max_bounces=3, seed=2)
    # form_image takes shadows and edges at the centre of a pixel, so that it is computed on finer
    # pixels and summed
    fine = replace(scene, camera=replace(scene.camera, binning=4))
    spread = psf.scene_point_spread(fine, tol=1e-2).point_spread
    image = imaging.form_image(fine, spread)
    waves, signal = (binned(values, 4) for values in (image.expected, image.signal))
    # few rays find the part of the letter in a pixel that its edge barely touches, and their spread
    # may be too small; such pixels are compared as a sum
    around = scipy.ndimage.maximum_filter(signal, size=3)
    touched = (signal > 1e-3 * waves) & (signal < 0.3 * around)
    sound = ~touched & (found.expected_error > 0.0)
    assert sound.mean() > 0.8
    off = (found.expected - waves) / np.where(sound, found.expected_error, 1.0)
    # 1.0 +- 0.1 for some 220 squares in units of Student's distribution; the wave's image differs
    # by 2e-3 from its convergent one, a tenth of the error of most pixels
    assert np.mean(off[sound] ** 2) < 1.4
    assert np.abs(off[sound]).max() < 5.0
    error = math.sqrt((found.expected_error[touched] ** 2).sum())
    assert found.expected[touched].sum() == approx(waves[touched].sum(), abs=4 * error)


def test_spot_out_of_focus_is_a_disc_where_the_spot_is():
    """Light after one reflection, blurred by the stop: its power and its image in closed form."""
    scene = room(FlatWall(size=2.4), spot=(0.06, 0.12), stop=0.02, binning=8)
    scene = replace(scene, wall_material=Lambert(0.6))
    found = trace_image(scene, n_rays=1 << 17, max_bounces=1, seed=2)
    spot = laser_spot(scene)
    power = spot_power_through_lens(scene, spot)
    # the lens is near for its size: its corner angles change the power by (stop/4 distance)^2
    assert found.stray.sum() == approx(power, rel=1e-3)
    off = np.abs(found.stray - power * spot_image(scene, spot))
    # the closed form replaces the elliptic outline of the spot by a circle, which moves 1.2 % of
    # the light at the rim of the disc
    assert off.sum() < 0.02 * power
    assert not found.power.any()


# quadrature


@pytest.mark.thorough
@pytest.mark.parametrize("outer_legs", [True, False])
def test_histogram_of_three_reflections_agrees_with_the_quadrature(outer_legs):
    """To 1 % in every bin: wall points that the pixels see are the sensors of `render`."""
    scene = room(FlatWall(size=2.4), binning=32, stop=1e-3)
    laser = replace(scene.laser, beam_diameter=1e-4)
    hidden = PlanarObject(np.ones((1, 1)), 0.5, position=(0.45, 0.05, 0.8), material=Lambert(0.8))
    scene = replace(scene, laser=laser, hidden=hidden, wall_material=Lambert(0.6))
    camera = replace(scene.camera, pixels=(128, 128))
    scene = replace(scene, camera=camera)
    bins = {"t_start": 3.9 if outer_legs else 1.6, "delta_t": 0.05, "n_bins": 16}
    found = trace_image(scene, n_rays=1 << 19, max_bounces=3, outer_legs=outer_legs, seed=4, **bins)
    fine = replace(camera, binning=4)
    rays = chief_rays(scene, *pixel_centres(fine))
    capture = render(
        [(cut_out(hidden), hidden.material)],
        Scan(
            laser_points=laser.aim,
            sensor_points=rays.points,
            wall_albedo=0.6,
            outer_legs=outer_legs,
            laser_origin=laser.position,
            sensor_origin=camera.position,
            **bins,
        ),
        quantity="radiance",
        max_bounces=3,
        tol=1e-3,
    )
    f_number = working_f_number(camera.stop_diameter / 2, scene.image_distance)
    area = fine.image_pitch**2 * math.pi * camera.transmission / (4 * f_number**2)
    weights = laser.power * area * rays.cos_axis**4
    expected = (capture.H * weights).sum(axis=(1, 2))
    before = (capture.details["before"] * weights).sum()
    histogram = found.histogram
    filled = expected > 0.25 * expected.max()
    assert filled.sum() >= 6
    # the quadrature is good to 1e-3; the traced bins have standard errors of at most 4e-3
    assert (histogram.by_bounce_error[3][filled] < 4e-3 * expected[filled]).all()
    assert histogram.by_bounce[3][filled] == approx(expected[filled], rel=0.01)
    assert histogram.power.sum() == approx(expected.sum(), rel=2e-3)
    # the first bin starts later than the light if the outer legs are counted
    assert histogram.before == approx(before, rel=0.02, abs=1e-20)
    assert (before > 0.0) == outer_legs
    assert histogram.after < 1e-4 * expected.sum()


# a plain walk, in a room whose lens is so large that it finds it


CARD = Lambert(0.8)


def wide_room(wall=PAINT, thing=CARD):
    """A small room with nine pixels behind a lens of 0.3 m, which is far out of focus."""
    return Scene(
        Laser(wavelength=633e-9, power=2.0, beam_diameter=0.02, position=(-0.1, 0.8, 0.9)),
        FlatWall(size=2.0),
        PlanarObject(PICTURE, 0.6, position=(0.35, -0.05, 0.5), yaw=0.3, material=thing),
        Camera(
            position=(-0.45, 0.0, 0.6),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.3,
            focus_distance=0.9,
            pixel_pitch=1e-3,
            pixels=(120, 120),
            binning=40,
            dark_current=20.0,
        ),
        wall_material=wall,
    )


MIRROR = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.0))
GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.1))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "scene",
    [wide_room(Lambert(0.8)), wide_room(MIRROR), wide_room(GLOSS, GLOSS)],
    ids=["matt", "mirror", "glossy"],
)
def test_pixels_and_bins_agree_with_a_plain_walk(scene):
    """By number of reflections: connections, light from mirrors, stray light."""
    plain = trace_image(scene, n_rays=1 << 19, analog=True, sampler="philox", seed=5, **BINS)
    found = trace_image(scene, n_rays=1 << 15, seed=6, **BINS)
    for a, b in ((plain, found), (plain.histogram, found.histogram)):
        for name in ("by_bounce", "stray", "power"):
            values = [getattr(image, name) for image in (a, b)]
            errors = [getattr(image, f"{name}_error") for image in (a, b)]
            # where the walk found few rays, of a fifth of the initial power, its spread is no error
            known = values[0] > 3 * scene.laser.power / plain.paths.n_rays
            off = (values[1] - values[0])[known] / np.hypot(*errors)[known]
            assert np.abs(off).max(initial=0.0) < 5.0
            if name == "power":
                assert known.sum() >= 3


# totals


@pytest.mark.parametrize("analog", [False, True])
def test_sums_are_those_of_a_trace(analog):
    # a white object in the laser beam that the wall mirrors: mirrors alone light some pixels
    scene = wide_room(MIRROR, MIRROR)
    scene = replace(scene, hidden=replace(scene.hidden, image=np.ones((2, 2))))
    options = {"n_rays": 20_000, "max_bounces": 4, "analog": analog, "seed": 7}
    found, light = trace_image(scene, **options, **BINS), trace(scene, **options)
    assert light.stray > 0.0
    assert light.flux > 0.0
    assert found.paths.ledger == light.ledger
    assert found.paths.flux == light.flux
    histogram = found.histogram
    outside = histogram.before + histogram.after
    # to the rounding of some thousand additions
    assert found.power.sum() == approx(light.flux, rel=1e-12)
    assert histogram.power.sum() + outside == approx(light.flux, rel=1e-12)
    assert found.stray.sum() == approx(light.stray, rel=1e-12)
    assert found.by_bounce.sum(axis=(1, 2)) == approx(light.by_bounce, rel=1e-12, abs=1e-30)
    mean = (histogram.power * histogram.times).sum() / histogram.power.sum()
    # half a bin, and what lies outside the bins
    assert outside < 0.01 * light.flux
    assert mean == approx(light.mean_path_length, abs=0.13)


def test_electrons_are_those_of_power_exposure_and_dark_current():
    scene = wide_room()
    short, long = (
        trace_image(scene, n_rays=2048, max_bounces=3, exposure=t, seed=1) for t in (0.01, 0.03)
    )
    assert short.power.tobytes() == long.power.tobytes()
    camera = scene.camera
    dark = 20.0 * 0.01 * camera.binning**2
    photons = (short.power + short.stray) * 0.01 * 633e-9 / (6.62607015e-34 * 299_792_458.0)
    assert short.expected == approx(photons * camera.quantum_efficiency + dark, rel=1e-12)
    assert long.expected == approx(3.0 * short.expected, rel=1e-12)
    assert long.expected_error == approx(3.0 * short.expected_error, rel=1e-12)
    assert trace_image(scene, n_rays=32, max_bounces=3).exposure == camera.exposure


# statistics


# what is shown and what is refused


def test_dark_histogram_is_refused():
    dark = replace(wide_room(), hidden=PlanarObject(np.zeros((2, 2)), 0.3, position=(0, 0, 1)))
    found = trace_image(dark, n_rays=64, max_bounces=3, t_start=9.0, delta_t=1.0, n_bins=2)
    with pytest.raises(SceneError, match="no light"):
        views.path_lengths(found.histogram)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_bins": 5}, "t_start and delta_t missing for the histogram that n_bins = 5 asks for"),
        ({"t_start": 0.0, "delta_t": 0.1}, "n_bins missing for the histogram that t_start = 0.0"),
        ({**BINS, "n_bins": 0}, "n_bins = 0 is"),
        ({**BINS, "delta_t": -1.0}, "delta_t = -1"),
        ({**BINS, "t_start": math.nan}, "t_start = nan"),
        ({"exposure": 0.0}, "exposure = 0"),
        ({"n_rays": 0}, "n_rays = 0"),
        ({"tol": 2.0}, "tol = 2"),
        ({"max_bounces": 0}, "max_bounces = 0"),
        ({"sampler": "halton"}, "sampler = 'halton'"),
    ],
)
def test_bad_input_is_one_line(options, message):
    with pytest.raises(SceneError) as caught:
        trace_image(wide_room(), **options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
