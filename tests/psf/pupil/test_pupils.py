"""Exit pupil against the thin-lens closed forms, and the scene's wave front."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.scene import Camera, ConcaveWall, ConvexWall, FlatWall, Laser, PlanarObject, Scene

FOCAL = 0.018432 / math.tan(math.radians(20))


def facing_scene(wall, *, d1=1.0, d2=1.0, stop=0.025, **camera):
    """Object and camera on the wall's normal through its centre."""
    return Scene(
        Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.3, 0, 1.2)),
        wall,
        PlanarObject(np.ones((8, 8)), 0.1, position=(0, 0, d1)),
        Camera(
            position=(0, 0, d2), aim=(0, 0, 0), focal_length=FOCAL, stop_diameter=stop, **camera
        ),
    )


def test_focal_length_of_forty_degrees():
    """(sensor/2)/tan(FOV/2) = 50.64150379538759784 mm for 36.864 mm."""
    assert FOCAL == approx(0.05064150379538759784213, rel=1e-14)


def test_lens_as_stop():
    pupil = psf.exit_pupil(facing_scene(FlatWall(size=2.0), stop=0.025))
    image = 2 * FOCAL / (2 - FOCAL)
    assert pupil.stop == "lens"
    # a few roundings of float64
    assert pupil.radius == approx(0.0125, rel=1e-12)
    assert pupil.image_distance == approx(image, rel=1e-12)
    assert pupil.f_number == approx(image / 0.025, rel=1e-12)
    assert pupil.centre == approx([0, 0, 1.0], abs=1e-15)


def test_wall_as_stop():
    """s' = d2 f/(d2-f), a' = a f/(d2-f), d_i negative: the pupil lies behind the image."""
    pupil = psf.exit_pupil(facing_scene(FlatWall(size=0.01), stop=0.5))
    assert pupil.stop == "wall"
    assert 1.0 - pupil.centre[2] == approx(-0.0533428667861976828309, rel=1e-12)
    assert pupil.radius == approx(2.667143339309884141545e-4, rel=1e-12)
    assert pupil.image_distance == approx(-0.001385770239835115075287, rel=1e-12)
    assert pupil.f_number == approx(2.59785482731812838778, rel=1e-12)


def test_the_smaller_cone_limits():
    """The wall's edge takes over from the lens at a = r_lens d1/(d1 + d2) = 12.5 mm."""
    assert psf.exit_pupil(facing_scene(FlatWall(size=0.0249), stop=0.05)).stop == "wall"
    assert psf.exit_pupil(facing_scene(FlatWall(size=0.0251), stop=0.05)).stop == "lens"


def test_a_square_wall_as_stop_gives_the_pattern_of_a_square():
    """sinc^2 along both axes; the half width on the lens is 5 mm (d1 + d2)/d1 = 10 mm."""
    scene = facing_scene(FlatWall(size=0.01), stop=0.5)
    wave = psf.wavefront(scene, nodes="grid", samples=512)
    assert wave.image_distance < 0
    zero = 632.8e-9 * scene.image_distance / 0.02  # of the pattern
    spread = psf.point_spread(
        wave, method="mdft", pitch=zero / 8, shape=64, normalisation="ideal-peak"
    )
    expected = np.sinc(spread.x / zero) ** 2 * np.sinc(spread.y / zero)[:, None] ** 2
    # rays are a little sparser at the corners, (10 mm/2 m)^2, and cells of 1/450 carry the edge
    assert spread.intensity == approx(expected, abs=3e-4)


@pytest.mark.parametrize("size", [(0.004, 1.0), (1.0, 0.004)])
def test_a_slit_of_wall_is_as_long_as_the_lens(flat_scene, size):
    """The true pupil is the lens's disc between two lines, not the circle inscribed in them."""
    hit = np.array(flat_scene.camera.aim)
    slit = replace(
        flat_scene,
        wall=FlatWall(size=(size[0] + 2 * abs(hit[0]) if size[0] < 0.1 else 1.0, size[1])),
    )
    pupil = psf.exit_pupil(slit)
    wave = psf.wavefront(slit, nodes="grid", samples=256)
    o, c = slit.object_point, np.array(slit.camera.position)
    e1, e2, _ = slit.camera.frame
    # brute force: points of the lens whose straight line to the mirrored object meets the wall
    rng = np.random.default_rng(0)
    r, t = 0.0125 * np.sqrt(rng.random(40000)), 2 * math.pi * rng.random(40000)
    p = c + (r * np.cos(t))[:, None] * e1 + (r * np.sin(t))[:, None] * e2
    meets = o + (o[2] / (o[2] + p[:, 2]))[:, None] * (p - o)
    share = slit.wall.contains(meets[:, 0], meets[:, 1]).mean()
    area = share * math.pi * 0.0125**2
    zoom = pupil.image_distance / slit.image_distance
    # 40000 points, three standard errors
    error = 3 * math.sqrt(share * (1 - share) / 40000) * math.pi * 0.0125**2
    assert wave.weights.sum() / zoom**2 == approx(area, abs=error + 0.002 * area)


def test_edge_seen_from_a_skewed_axis():
    """Distance of the axis from the wall's edge, minimised along both lines."""
    from scipy.optimize import minimize

    camera = Camera(position=(-0.5, 0.5, 0.6), aim=(0, 0, 0), focal_length=FOCAL, stop_diameter=0.5)
    scene = replace(facing_scene(FlatWall(size=(0.012, 1.0))), camera=camera)
    scene = replace(scene, hidden=replace(scene.hidden, position=(0.5, -0.5, 0.6)))
    pupil = psf.exit_pupil(scene)
    n = camera.axis

    def square(x):
        return float(np.sum((np.array([0.006, x[0], 0.0]) - x[1] * n) ** 2))

    edge = math.sqrt(minimize(square, (0.0, 0.0), tol=1e-16).fun)
    d2 = float(np.linalg.norm(camera.position))
    d1 = scene.focus_distance - d2
    # what the minimiser leaves of a quadratic bowl
    assert pupil.entrance_radius == approx(edge * (d1 + d2) / d1, rel=1e-6)


def test_vignetting_counts_what_misses_the_wall(flat_scene):
    # the camera looks beside the object, whose own cone then overlaps the wall's edge
    beside = replace(flat_scene.camera, aim=(-0.1, 0.0, 0.0))
    narrow = replace(flat_scene, wall=FlatWall(size=(0.34, 1.0)), camera=beside)
    pupil = psf.exit_pupil(narrow)
    assert pupil.stop == "lens"
    assert 0.02 < pupil.vignetting < 0.5
    wave = psf.wavefront(narrow, nodes="grid", samples=128)
    lost = 1 - wave.weights.sum() / (math.pi * wave.pupil_radius**2)
    # 2048 sample points of the disc, 64 along the edge's chord
    assert lost == approx(pupil.vignetting, abs=0.02)
    with pytest.raises(SamplingError, match="nodes='grid'"):
        psf.wavefront(narrow, nodes="polar")
    assert psf.wavefront(narrow).layout == pupil.layout == "grid"


def test_fast_cone_obeys_the_sine_condition(flat_scene):
    """N = 1/(2 sin) at any aperture, up to the half space."""
    camera = replace(flat_scene.camera, stop_diameter=0.09)
    pupil = psf.exit_pupil(replace(flat_scene, camera=camera))
    half = math.asin(0.045 / pupil.image_distance)
    assert pupil.f_number == approx(0.5 / math.sin(half), rel=1e-12)
    wide = replace(flat_scene, camera=replace(flat_scene.camera, stop_diameter=0.12))
    with pytest.raises(SceneError, match=r"limit F/0.5.*use a smaller camera.stop_diameter"):
        psf.exit_pupil(wide)


def test_flat_wall_is_aberration_free(flat_scene):
    wave = psf.wavefront(flat_scene)
    assert abs(wave.aberration).max() < 1e-9 * flat_scene.laser.wavelength
    assert wave.removed.tilt == (0.0, 0.0)


@pytest.mark.parametrize("wall", [ConcaveWall(5.0), ConvexWall(3.0)])
def test_tilt_is_where_the_chief_ray_lands(flat_scene, wall):
    """Removing the chief tilt leaves a residual with zero slope at the pupil's centre."""
    scene = replace(flat_scene, wall=wall)
    step = 1e-6
    near = psf.wavefront(scene, nodes=[[step, 0.0], [0.0, step], [-step, 0.0], [0.0, -step]])
    slopes = (near.aberration[:2] - near.aberration[2:]) / (2 * step)
    # the third order of W over 1 um, and W's own 1e-17 m over 2 um
    assert abs(slopes).max() < 1e-10
    assert np.hypot(*near.removed.tilt) > 1e-3


def test_defocus_has_the_sign_of_a_detector_short_of_focus(flat_scene):
    """Camera focused beyond the object: detector too near, W > 0; value r^2/2 (1/s - 1/s_f)."""
    s = flat_scene.focus_distance
    camera = replace(flat_scene.camera, focus_distance=1.05 * s)
    rim = psf.wavefront(replace(flat_scene, camera=camera), nodes=[[0.0125, 0.0]])
    expected = 0.0125**2 / 2 * (1 / s - 1 / (1.05 * s))
    # next order r^4/8 s^3, and the object is a little off the axis
    assert rim.aberration[0] == approx(expected, rel=5e-3)
    assert rim.aberration[0] > 0


def test_amplitude_carries_the_energy_of_ray_tubes(flat_scene):
    """Int A^2 over the pupil is the solid angle at the object that reaches it, by tracing back."""
    scene = replace(flat_scene, wall=ConvexWall(3.0))
    from nlosoptics.psf.pupil.aiming import aim, pupil_points

    centre, axis = np.array(scene.camera.position), scene.camera.axis
    u, v, weights = psf.polar_nodes(0.0125, 12, 24)
    nodes = np.stack([u.ravel(), v.ravel()], axis=1)
    o = scene.object_point
    rays = aim(scene.wall, o, pupil_points(centre, axis, nodes), axis)
    flux = float(rays.spreading @ weights.ravel())
    # the rim of the cone at the object: Gauss-Bonnet-free, by a fan of thin triangles
    angles = 2 * math.pi * np.arange(720) / 720
    rim = 0.0125 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    out = aim(scene.wall, o, pupil_points(centre, axis, rim), axis).points - o
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    middle = out.mean(axis=0)
    middle /= np.linalg.norm(middle)
    after = np.roll(out, -1, axis=0)
    solid = 0.5 * np.abs(np.cross(out - middle, after - middle) @ middle).sum()
    # chords of 0.5 degree cut 1.3e-5 off a circle; the cone is 6 mrad wide
    assert flux == approx(solid, rel=5e-5)


def test_same_bits_for_any_number_of_threads(flat_scene, on_threads):
    scene = replace(flat_scene, wall=ConcaveWall(5.0))
    one, two = (on_threads(n, lambda: psf.wavefront(scene)) for n in (1, 2))
    assert np.array_equal(one.aberration, two.aberration)
    assert np.array_equal(one.amplitude, two.amplitude)


def test_cells_follow_the_edge_of_a_flat_wall():
    """Squares of a grid carry the edge as seen at the pupil's centre, cells carry it as it is."""
    scene = facing_scene(FlatWall(size=0.01), stop=0.5)
    wave = psf.wavefront(scene, nodes="cells")
    zero = 632.8e-9 * scene.image_distance / 0.02  # of the pattern
    spread = psf.point_spread(
        wave, pitch=zero / 8, shape=64, normalisation="ideal-peak", tol=1e-9, model="scalar"
    )
    assert spread.error_estimate <= 1e-9
    expected = np.sinc(spread.x / zero) ** 2 * np.sinc(spread.y / zero)[:, None] ** 2
    # rays are a little sparser at the corners, (10 mm/2 m)^2
    assert spread.intensity == approx(expected, abs=5e-5)


@pytest.mark.parametrize("aim", [(-0.1, 0.0, 0.0), (-0.1, 0.02, 0.0)])
def test_a_cone_that_an_edge_cuts(flat_scene, aim):
    camera = replace(flat_scene.camera, aim=aim)
    narrow = replace(flat_scene, wall=FlatWall(size=(0.34, 1.0)), camera=camera)
    wave = psf.wavefront(narrow, nodes="cells")
    grid = psf.wavefront(narrow, nodes="grid", samples=512)
    # the squares' footprint across the edge is that at the pupil's centre
    assert wave.flux == approx(grid.flux, rel=2e-4)
    assert wave.pupil_radius == grid.pupil_radius
    # W of a flat wall is the defocus of where the camera looks: smooth, and held to rounding
    path, amplitude = wave.truncation()
    assert 2 * math.pi / wave.wavelength * path < 1e-9
    assert amplitude < 1e-9
    pitch = wave.wavelength * wave.f_number / 4
    spread = psf.point_spread(wave, pitch=pitch, shape=64, tol=1e-6, model="scalar")
    squares = psf.point_spread(grid, method="mdft", pitch=pitch, shape=64)
    change = np.abs(spread.intensity - squares.intensity).max() / spread.intensity.max()
    assert change < 1e-3


def test_cells_of_an_uncut_cone_are_the_disc(flat_scene):
    polar, cells = (psf.wavefront(flat_scene, nodes=nodes) for nodes in ("polar", "cells"))
    assert cells.flux == approx(polar.flux, rel=1e-12)
    assert psf.strehl(cells) == approx(psf.strehl(polar), rel=1e-10)


def test_cells_of_a_curved_wall_are_refused(flat_scene):
    with pytest.raises(SamplingError, match="this one is curved"):
        psf.wavefront(replace(flat_scene, wall=ConcaveWall(5.0, size=1.0)), nodes="cells")


def edge_on_lens(scene, o):
    """Where rays that the corners reflect meet the lens's plane, along the camera's axes."""
    half = np.array(scene.wall.size) / 2
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
    corners = np.append(corners, np.zeros((4, 1)), axis=1)
    outward = corners - o
    outward[:, 2] *= -1
    centre, axis = np.array(scene.camera.position), scene.camera.axis
    met = corners + ((centre - corners) @ axis / (outward @ axis))[:, None] * outward - centre
    return met @ np.stack(scene.camera.frame[:2], axis=1)


def test_a_wall_as_stop_is_its_outline_projected_from_the_object(flat_scene):
    """Area and centroid of the cells are those of the quadrangle on the lens, by the shoelace."""
    camera = replace(flat_scene.camera, stop_diameter=0.9, aim=(0.004, -0.003, 0.0))
    scene = replace(flat_scene, wall=FlatWall(size=(0.03, 0.05)), camera=camera)
    o = np.array([0.85, 0.12, 1.0])
    wave = psf.wavefront(scene, o, nodes="cells")
    zoom = wave.image_distance / scene.image_distance
    corners = edge_on_lens(scene, o) * zoom
    x, y = corners.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = cross.sum() / 2
    middle = [((a + np.roll(a, -1)) * cross).sum() / (6 * area) for a in (x, y)]
    # Gauss's rule on quadrangles is exact for both
    assert wave.weights.sum() == approx(abs(area), rel=1e-10)
    found = [(wave.weights * a).sum() / wave.weights.sum() for a in (wave.u, wave.v)]
    assert found == approx(middle, abs=1e-10 * wave.pupil_radius)


@pytest.mark.parametrize("more", [(1e-3, 5e-3), (2e-3, 3e-4), (1.3e-3, 3.7e-3)])
@pytest.mark.parametrize("y", [0.0, 0.3])
def test_squares_that_an_edge_cuts_count_by_their_part(flat_scene, y, more):
    """The area of a grid is that of the cells, wherever two edges fall among the squares."""
    x, z = -0.6, 0.8
    # where the chief ray meets the wall
    hit = np.array([x, y]) + 0.8 / 1.8 * (np.array(flat_scene.hidden.position[:2]) - (x, y))
    size = tuple((2 * abs(hit) + more).tolist()) if y else (2 * abs(hit[0]) + more[0], 0.008)
    camera = replace(flat_scene.camera, position=(x, y, z), aim=(*hit, 0.0))
    scene = replace(flat_scene, wall=FlatWall(size=size), camera=camera)
    exact = psf.wavefront(scene, nodes="cells").weights.sum()
    grid = psf.wavefront(scene, nodes="grid", samples=128)
    disc = math.pi * grid.pupil_radius**2
    assert 0.1 < exact / disc < 0.9
    # a footprint as at the pupil's centre, and the corner of two edges as a product
    assert grid.weights.sum() == approx(exact, abs=5e-4 * disc)
    assert grid.weights.min() >= 0.0
    assert grid.weights.max() <= (grid.u[0, 1] - grid.u[0, 0]) ** 2 * (1 + 1e-12)
