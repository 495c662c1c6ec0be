"""Occluders: the light that they block, against lines of sight computed by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import nlosoptics as nlos
from nlosoptics.errors import SceneError
from nlosoptics.imaging import cast_shadows, diffuse_background, form_image
from nlosoptics.imaging.geometry import chief_rays, pixel_centres
from nlosoptics.scene import (
    ConcaveWall,
    FlatWall,
    Lambert,
    MeshObject,
    Occluder,
    SpecularMicrofacet,
    SumMaterial,
)


def spread(scene):
    return SimpleNamespace(
        intensity=np.ones((1, 1)), pitch=scene.camera.image_pitch, normalisation="unit-sum"
    )


def plate(x, y, z):
    """Rectangle across z, of x and y from low to high."""
    corners = [[a, b, z] for a, b in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def finer(scene, binning=16):
    return replace(scene, camera=replace(scene.camera, binning=binning))


# The spot is at the origin and the object's centre at (0.3798, 0, 1), 0.15 m to each side; at
# z = 0.2 its shadow cone is 0.03 m to each side of x = 0.076 and clear of beam and image.
WHOLE = plate((0.041, 0.111), (-0.035, 0.035), 0.2)
HALF = plate((0.076, 0.15), (-0.035, 0.035), 0.2)
FAR = plate((-3, -2.9), (2, 2.1), 3.0)


def object_points(scene, rays):
    """Where chief rays meet the plane z = 1 of the hidden picture."""
    t = (1.0 - rays.points[..., 2]) / rays.reflected[..., 2]
    return rays.points + t[..., None] * rays.reflected


@pytest.mark.parametrize("wall", [FlatWall(size=2.0), ConcaveWall(4.0)], ids=["flat", "concave"])
@pytest.mark.parametrize("mesh", [False, True], ids=["picture", "mesh"])
def test_an_occluder_out_of_the_way_changes_no_bit(flat_scene, wall, mesh):
    scene = replace(flat_scene.resized(32), wall=wall)
    if mesh:
        box = trimesh.creation.box((0.2, 0.2, 0.1))
        scene = replace(scene, hidden=MeshObject(box, position=(0.38, 0, 1)))
    shaded = replace(scene, occluders=(FAR, Occluder(FAR, scale=0.5, yaw=0.1)))
    one, two = (form_image(s, spread(s), seed=1) for s in (scene, shaded))
    for name in ("ideal", "background", "electrons"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_an_occluder_before_the_whole_object_leaves_no_light_of_it(flat_scene):
    scene = replace(flat_scene, occluders=(WHOLE,))
    image = form_image(scene, spread(scene))
    bare = form_image(flat_scene, spread(flat_scene))
    assert bare.ledger["ideal"] > 1000
    assert image.ledger["ideal"] == 0.0
    assert image.ledger["diffuse"] < 1e-9 * bare.ledger["diffuse"]
    assert image.ledger["spot"] == bare.ledger["spot"]
    assert diffuse_background(scene).max() < 1e-9 * diffuse_background(flat_scene).max()


@pytest.mark.thorough
@pytest.mark.parametrize("mesh", [False, True], ids=["picture", "mesh"])
def test_shadow_on_the_object_has_the_edge_of_the_plates_projection(flat_scene, mesh):
    scene = replace(finer(flat_scene), occluders=(HALF,))
    if mesh:
        sheet = plate((-0.15, 0.15), (-0.15, 0.15), 0.0)
        scene = replace(scene, hidden=MeshObject(sheet, position=(0.3798, 0, 1)))
    image = cast_shadows(scene).image
    x, y = pixel_centres(scene.camera)
    pitch, fine = scene.camera.image_pitch, (np.arange(32) + 0.5) / 32 - 0.5
    lit = np.zeros(image.shape)
    on_object = np.ones(image.shape, dtype=bool)
    for dx in fine * pitch:
        points = object_points(scene, chief_rays(scene, x + dx, y))
        at_plate = 0.2 * points[..., 0]
        lit += (at_plate < 0.076) | (at_plate > 0.15)
        on_object &= (abs(points[..., 0] - 0.3798) < 0.15) & (abs(points[..., 1]) < 0.15)
    lit /= 32
    assert on_object.sum() > 2000
    assert 0.3 < lit[on_object].mean() < 0.7
    # upright edge across columns of four sample paths: half of one of them, and the slant of
    # columns by perspective
    assert abs(image - lit)[on_object].max() < 0.16
    certain = on_object & ((lit == 0) | (lit == 1))
    np.testing.assert_array_equal(image[certain], lit[certain])


@pytest.mark.thorough
def test_a_plate_between_object_and_wall_hides_what_the_mirrored_rays_cross(flat_scene):
    """At z = 0.2 the image's light from the object to the wall passes x = -0.056 +- 0.08 m."""
    scene = replace(finer(flat_scene), occluders=(plate((-0.2, -0.056), (-0.2, 0.2), 0.2),))
    found = cast_shadows(scene)
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    points = object_points(scene, rays)
    crossing = 0.8 * rays.points[..., 0] + 0.2 * points[..., 0]
    on_object = (abs(points[..., 0] - 0.3798) < 0.15) & (abs(points[..., 1]) < 0.15)
    assert (found.view[on_object] == 1).all()
    # the lens of 12.5 mm, seen from the object, is 7 mm on the wall and 6 mm at the plate; a pixel
    # is 1.5 mm
    dark = on_object & (crossing < -0.056 - 0.008)
    bright = on_object & (crossing > -0.056 + 0.008)
    assert min(dark.sum(), bright.sum()) > 500
    assert not found.image[dark].any()
    assert (found.image[bright] == 1).all()
    between = found.image[on_object & ~dark & ~bright]
    assert ((between > 0.1) & (between < 0.9)).sum() > 50
    # the lens's two halves: the edge is as soft to either side, cut off by a pixel
    share = (crossing > -0.056)[on_object].mean()
    assert found.image[on_object].mean() == pytest.approx(share, abs=0.01)


@pytest.mark.thorough
def test_half_the_object_is_dark_and_half_is_as_before(flat_scene):
    flat_scene = finer(flat_scene)
    bare = form_image(flat_scene, spread(flat_scene))
    scene = replace(flat_scene, occluders=(HALF,))
    image = form_image(scene, spread(scene))
    points = object_points(scene, chief_rays(scene, *pixel_centres(scene.camera)))
    width = 0.3 / 20  # more than a pixel on the object
    free = bare.ideal > 0
    dark, bright = free & (points[..., 0] > 0.38 + width), free & (points[..., 0] < 0.38 - width)
    assert dark.sum() > 50
    assert bright.sum() > 50
    assert not image.ideal[dark].any()
    np.testing.assert_array_equal(image.ideal[bright], bare.ideal[bright])
    # half of the light reaches the wall, a little more or less by the distances
    assert 0.4 < image.ledger["diffuse"] / bare.ledger["diffuse"] < 0.6


@pytest.mark.thorough
def test_a_scene_turned_over_casts_its_shadows_turned_over(flat_scene):
    over, under = (
        replace(
            flat_scene,
            laser=replace(flat_scene.laser, position=(0.6, sign * 0.3, 1.1)),
            occluders=(
                plate((0.0, 0.1), sorted((sign * 0.01, sign * -0.2)), 0.2),
                plate((-0.3, 0.5), sorted((sign * -0.1, sign * -0.4)), 0.4),
            ),
        )
        for sign in (1, -1)
    )
    one, two = cast_shadows(over), cast_shadows(under)
    assert one.veil.min() < 0.5
    assert one.image.min() < one.image.max()
    # the sample paths of a pixel are no mirror images
    assert abs(one.veil - two.veil[::-1]).max() < 0.02
    assert (one.veil - two.veil[::-1]).std() < 2e-3
    assert abs(one.image - two.image[::-1]).max() < 0.2
    assert abs(one.view - two.view[::-1]).max() < 0.2
    assert one.view.mean() == pytest.approx(two.view.mean(), abs=1e-3)


@pytest.mark.thorough
def test_an_edge_before_the_lens_hides_the_part_of_its_disc_beyond_the_chord(flat_scene):
    """At z/s of the way to the point in focus the cone has shrunk to 1 - z/s."""
    flat_scene = finer(flat_scene)
    camera = flat_scene.camera
    e1, e2, axis = camera.frame
    way, half = 0.2, camera.stop_diameter / 2
    corners = [np.array(camera.position) + way * axis + a * e1 + b * e2 for a, b in
               ((0, -1), (0.3, -1), (0.3, 1), (0, 1))]  # fmt: skip
    screen = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    scene = replace(flat_scene, occluders=(screen,))
    view = cast_shadows(scene).view
    x, _ = pixel_centres(camera)
    # the ray to pixel x leaves the lens toward -x
    middle = -x / scene.image_distance * way
    chord = np.clip(-middle / (half * (1 - way / scene.focus_distance)), -1, 1)
    share = 1 - (np.arccos(chord) - chord * np.sqrt(1 - chord**2)) / math.pi
    assert ((share > 0.1) & (share < 0.9)).sum() > 10
    error = view - share
    # sixteen points of the lens; the pixel's own width moves the chord by a fifth of that
    assert abs(error).max() < 0.1
    assert abs(error.mean()) < 0.01
    assert (view[:, chord == 1] == 1).all()
    assert not view[:, chord == -1].any()


def hits_rectangle(a, b, x, y, z):
    """Whether segments from a to b cross the rectangle at z."""
    t = (z - a[..., 2]) / (b[..., 2] - a[..., 2])
    px, py = (a[..., i] + t * (b[..., i] - a[..., i]) for i in (0, 1))
    inside = (t > 0) & (t < 1) & (px > x[0]) & (px < x[1]) & (py > y[0]) & (py < y[1])
    return inside


@pytest.mark.thorough
@pytest.mark.parametrize("binning", [64, 16])
def test_veil_is_the_sum_over_the_pictures_texels(flat_scene, binning):
    """Brute force over every texel and pixel, with a shadow on the object and one on the wall."""
    first, second = ((0.08, 0.2), (-0.2, 0.2), 0.2), ((0.0, 0.4), (0.0, 0.3), 0.4)
    material = SumMaterial(Lambert(0.7), SpecularMicrofacet(0.05, 0.0))
    scene = replace(
        flat_scene,
        laser=replace(flat_scene.laser, position=(-0.6, 0.3, 1.1)),
        camera=finer(flat_scene, binning).camera,
        wall_material=material,
        occluders=(plate(*first), plate(*second)),
    )
    veil = cast_shadows(scene).veil
    picture = scene.hidden.reflectance.repeat(8, 0).repeat(8, 1)
    n = len(picture)
    row, column = np.nonzero(picture)
    right, up, normal = scene.hidden.axes
    texels = (
        np.array(scene.hidden.position)
        + ((column[:, None] + 0.5) / n - 0.5) * 0.3 * right
        + (0.5 - (row[:, None] + 0.5) / n) * 0.3 * up
    )
    spot = np.zeros(3)
    square = (texels**2).sum(axis=1)
    received = texels[:, 2] * -(texels @ normal) / square**2
    lit = ~(hits_rectangle(texels, spot, *first) | hits_rectangle(texels, spot, *second))
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    draw = np.random.default_rng(0).integers(0, veil.shape[0], (100, 2))
    errors = []
    for i, j in draw:
        lines = texels - rays.points[i, j]
        light = received * lines[:, 2] * -(lines @ normal) / (lines**2).sum(axis=1) ** 2
        free = lit & ~hits_rectangle(texels, rays.points[i, j], *first)
        free &= ~hits_rectangle(texels, rays.points[i, j], *second)
        errors.append(veil[i, j] - (light * free).sum() / light.sum())
    assert np.ptp(veil) > 0.3
    # the brute force looks from the centre of a pixel, and takes texels as points: a column of them
    # appears at once
    assert abs(np.array(errors)).max() < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 0.003


def test_exact_shadows_interpolate_no_pixel():
    scene = nlos.example("letter_occluder").resized(32)
    exact, quick = (cast_shadows(scene, exact=one).veil for one in (True, False))
    # corners are never interpolated
    assert exact[::31, ::31] == pytest.approx(quick[::31, ::31], rel=1e-12)
    # five points of each block agree to 2e-3 of the mean
    assert 0.0 < abs(exact - quick).max() < 4e-3 * exact.mean()


@pytest.mark.thorough
def test_a_plate_before_the_lens_hides_the_spot_from_it(flat_scene):
    camera = replace(flat_scene.camera, glare_fraction=0.01)
    scene = replace(flat_scene, camera=camera)
    # where the line from the spot to the lens at (-0.6, 0, 0.8) passes z = 0.04
    near = plate((-0.05, -0.02), (-0.02, 0.02), 0.04)
    half = plate((-0.05, -0.02), (0.0, 0.02), 0.04)
    full, part = (replace(scene, occluders=(mesh,)) for mesh in (near, half))
    bare, dark, dim = (form_image(s, spread(s)).ledger for s in (scene, full, part))
    for name in ("spot", "glare"):
        assert bare[name] > 0
        assert dark[name] == 0.0
        # of sixteen points of the lens, one may be on the edge's wrong side
        assert dim[name] == pytest.approx(bare[name] / 2, rel=0.13)


def test_an_occluder_in_the_beam_is_refused(flat_scene):
    # the beam from (0.6, 0.3, 1.1) passes z = 0.55 at (0.3, 0.15), 1.5 mm wide to each side
    for x in ((0.25, 0.35), (0.3014, 0.35)):
        scene = replace(flat_scene, occluders=(plate(x, (0.1, 0.2), 0.55),))
        with pytest.raises(SceneError, match=r"occluders cut the laser's beam from \(0.6, 0.3, 1"):
            form_image(scene, spread(scene))
    beside = replace(flat_scene, occluders=(plate((0.302, 0.31), (0.1, 0.2), 0.55),))
    assert cast_shadows(beside).spot == 1.0


def test_shadows_of_another_camera_are_refused(flat_scene):
    scene = replace(flat_scene, occluders=(HALF,))
    with pytest.raises(SceneError, match=r"shadows are of \(32, 32\) pixels, .* \(64, 64\); give"):
        form_image(scene, spread(scene), shadows=cast_shadows(scene.resized(32)))


@pytest.mark.thorough
def test_what_is_left_of_the_object_is_reconstructed(examples):
    scene = nlos.Scene.load(examples / "scenes" / "letter_occluder.toml").resized(128)
    result = nlos.simulate(scene, reconstruct=True)
    truth = result.image.ideal
    found = result.reconstruction.object
    assert np.corrcoef(truth.ravel(), np.asarray(found).ravel())[0, 1] > 0.9
