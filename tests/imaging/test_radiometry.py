"""The radiance chain against closed forms and brute-force sums."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import SceneError
from nlosoptics.imaging.geometry import chief_rays, picture_points, pixel_centres
from nlosoptics.imaging.objects import mesh_hits, object_patches
from nlosoptics.imaging.radiometry import (
    background_radiance,
    electrons_per_joule,
    electrons_per_radiance,
    laser_spot,
    lit_patches,
    object_radiance,
    photon_rate,
    radiant_intensity,
    spot_irradiance,
    spot_power_through_lens,
)
from nlosoptics.imaging.stray import common_area, spot_image
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    MeshObject,
    OrenNayar,
    PlanarObject,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    WavyWall,
)


def lambert_scene(flat_scene, **changes):
    hidden = replace(flat_scene.hidden, material=Lambert(1.0))
    return replace(flat_scene, **{"wall_material": Lambert(1.0), "hidden": hidden, **changes})


def test_spot_is_a_lambert_source(flat_scene):
    """I = P rho cos/pi, and the irradiance of a patch I cos'/r^2."""
    scene = replace(flat_scene, wall_material=Lambert(0.6))
    spot = laser_spot(scene)
    for angle in (0.0, 0.5, 1.2):
        for distance in (0.1, 1.0, 10.0):
            toward = np.array([math.sin(angle), 0.0, math.cos(angle)])
            intensity = 5e-3 * 0.6 / math.pi * math.cos(angle)
            assert radiant_intensity(scene, spot, toward) == pytest.approx(intensity, rel=1e-14)
            for tilt in (0.0, 1.0):
                normal = -np.array([math.sin(angle + tilt), 0.0, math.cos(angle + tilt)])
                irradiance, _ = spot_irradiance(scene, spot, distance * toward, normal)
                expected = intensity * math.cos(tilt) / distance**2
                assert irradiance == pytest.approx(expected, rel=1e-14)
            behind, _ = spot_irradiance(scene, spot, distance * toward, toward)
            assert behind == 0.0


def test_spot_lies_on_the_curved_wall(flat_scene):
    laser = replace(flat_scene.laser, aim=(0.2, 0.1, 0.0))
    wall = ConvexWall(2.0)
    spot = laser_spot(replace(flat_scene, wall=wall, laser=laser))
    assert spot.point[2] == pytest.approx(wall.height(*spot.point[:2]), abs=1e-15)
    beam = np.array(laser.position) - spot.point
    np.testing.assert_allclose(np.cross(beam, spot.incident), 0, atol=1e-15)
    cosine = spot.incident @ spot.normal
    assert spot.area == pytest.approx(np.pi / 4 * 9e-6 / cosine, rel=1e-14)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"position": (1e6, 0.0, 1e-10)},
            r"meets the wall at 90 deg from its normal, limit 89 deg",
        ),
        ({"position": (1.2 * 60, 0.0, 1.2)}, r"at 89.05 deg from its normal, limit 89 deg"),
        # 3 mm/cos(60 deg) = 6 mm is fine, 0.6 m/cos(60 deg) = 1.2 m is longer than 1.07 m
        (
            {"position": (math.sqrt(3), 0, 1), "beam_diameter": 0.6},
            "beam_diameter = 0.6 m lights 1.2 m of the wall, longer than the 1.07 m to the object",
        ),
    ],
)
def test_grazing_beam_is_refused(flat_scene, changes, message):
    laser_spot(replace(flat_scene, laser=replace(flat_scene.laser, position=(math.sqrt(3), 0, 1))))
    with pytest.raises(SceneError, match=message) as caught:
        laser_spot(replace(flat_scene, laser=replace(flat_scene.laser, **changes)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("azimuth", "across"), [(0.0, 2.0), (math.pi / 2, 1.0), (math.pi / 4, math.sqrt(2.5))]
)
def test_spot_that_passes_the_edge_is_refused(flat_scene, azimuth, across):
    """At 60 degrees the disc is drawn out twofold, along the beam alone."""
    start = np.array([math.sqrt(3) * math.cos(azimuth), math.sqrt(3) * math.sin(azimuth), 1.0])
    for spare, fits in ((1e-9, True), (-1e-9, False)):
        aim = np.array([0.5 - 1.5e-3 * across - spare, 0.0, 0.0])
        laser = replace(flat_scene.laser, position=start + aim, aim=aim)
        scene = replace(flat_scene, wall=FlatWall(size=1.0), laser=laser)
        if fits:
            laser_spot(scene)
            continue
        with pytest.raises(SceneError, match=r"reaches \|x\| = 0.5 m, past the wall's edge at 0.5"):
            laser_spot(scene)


def one_pixel_background(scene, target):
    """Background radiance of the pixel that looks at ``target`` on the wall."""
    camera = replace(
        scene.camera, position=(target[0] + 0.3, target[1], 1.0), aim=(*target, 0.0),
        pixels=(3, 3), binning=1,
    )  # fmt: skip
    scene = replace(scene, camera=camera)
    rays = chief_rays(scene, *pixel_centres(camera))
    patches = object_patches(scene.hidden)
    seen = np.ones((3, 3), dtype=bool)
    return background_radiance(scene, laser_spot(scene), patches, rays, seen)[1, 1]


@pytest.mark.parametrize(
    ("patch", "laser", "sensor"),
    [((0.4, 0.2, 0.8), (0.1, -0.2), (0.1, -0.2)), ((0.4, 0.2, 0.8), (0.0, 0.0), (0.3, 0.4))],
)
def test_three_bounces_of_a_small_patch(flat_scene, patch, laser, sensor):
    """E = P z^4/(pi^2 r1^4 r2^4) dA for a patch parallel to the wall, all albedos 1."""
    side = 1e-3
    hidden = PlanarObject(np.ones((2, 2)), side, position=patch, material=Lambert(1.0))
    beam = replace(flat_scene.laser, aim=(*laser, 0.0), position=(0.5, 0.5, 1.0))
    scene = lambert_scene(flat_scene, hidden=hidden, laser=beam)
    r1, r2 = (math.dist(patch, (*end, 0.0)) for end in (laser, sensor))
    irradiance = 5e-3 * 0.8**4 / (math.pi**2 * r1**4 * r2**4) * side**2
    radiance = one_pixel_background(scene, sensor)
    # the patch's second moment, (side/r)^2
    assert radiance == pytest.approx(irradiance / math.pi, rel=5e-6)


@pytest.mark.parametrize(
    ("sensor", "total"),
    [
        # (1/pi^2) Int z^4/(r1^4 r2^4) dA over [-.25, .25]^2 at z = 1, laser at 0, by quadrature
        ((0.0, 0.0), 0.02164950017775576123636),
        ((-0.9375, -0.9375), 0.00315867710767716798068),
        ((0.5625, -0.5625), 0.008833782656805163244381),
    ],
)
def test_three_bounces_of_a_square(flat_scene, sensor, total):
    hidden = PlanarObject(np.ones((8, 8)), 0.5, position=(0, 0, 1.0), material=Lambert(1.0))
    scene = lambert_scene(flat_scene, hidden=hidden)
    radiance = one_pixel_background(scene, sensor)
    # 25 patches a side: (0.02/1)^2 times a second derivative of order 1
    assert radiance == pytest.approx(5e-3 * total / math.pi, rel=3e-4)


WALLS = {
    "flat": FlatWall(),
    "concave": ConcaveWall(2.0),
    "convex cylinder": ConvexWall(2.0, shape="cylinder"),
    "wavy": WavyWall(2e-3, 0.05, 0.3, size=1.5),
    "two waves on a sphere": SumWall(
        WavyWall(1e-3, 0.05), WavyWall(5e-4, 0.04, direction=1.3), ConvexWall(3.0), size=1.5
    ),
}
MATERIALS = {
    "lambert": Lambert(0.8),
    "oren-nayar": OrenNayar(0.8, 0.35),
    "painted": SumMaterial(OrenNayar(0.6, 0.2), SpecularMicrofacet(0.05, 0.0)),
}


@pytest.mark.thorough
@pytest.mark.parametrize("distance", [0.4, 1.0])
@pytest.mark.parametrize("material", MATERIALS.values(), ids=MATERIALS)
@pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS)
def test_background_against_the_sum_over_all_texels(flat_scene, wall, material, distance):
    """Every texel, cut in 4 x 4, against 40 pixels on their own, without interpolation."""
    picture = np.random.default_rng(0).random((24, 24)) ** 4
    hidden = PlanarObject(
        picture, 0.3, position=(0.35 * distance, 0.05, distance), yaw=0.2,
        material=OrenNayar(0.8, 0.3),
    )  # fmt: skip
    scene = replace(flat_scene, wall=wall, wall_material=material, hidden=hidden)
    spot = laser_spot(scene)
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    seen = np.isfinite(rays.distance)
    assert seen.mean() > 0.5
    background = background_radiance(scene, spot, object_patches(hidden), rays, seen)
    right, up, normal = hidden.axes
    fine = (np.arange(96) + 0.5) / 96 - 0.5
    points = (
        hidden.position
        + fine[None, :, None] * hidden.size[0] * right
        - fine[:, None, None] * hidden.size[1] * up
    )
    weight = np.repeat(np.repeat(picture, 4, 0), 4, 1) * np.prod(hidden.size) / 96**2
    draw = np.random.default_rng(1)
    worst = 0.0
    for i, j in draw.permutation(np.argwhere(seen))[:40]:
        wall_point, wall_normal = rays.points[i, j], rays.normals[i, j]
        leg = points - wall_point
        r = np.linalg.norm(leg, axis=-1)
        leg /= r[..., None]
        light = object_radiance(scene, spot, points, normal, -leg)
        lobe = material.diffuse.evaluate(leg, -rays.directions[i, j], wall_normal)
        cosines = np.maximum(leg @ wall_normal, 0) * np.maximum(-leg @ normal, 0)
        total = (light * lobe * cosines * weight / r**2).sum()
        worst = max(worst, abs(background[i, j] / total - 1))
    assert worst < 1e-3


def test_background_needs_a_diffuse_wall(flat_scene):
    scene = replace(flat_scene, wall_material=SpecularMicrofacet(0.9, 0.0))
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    seen = np.ones(rays.distance.shape, dtype=bool)
    patches = object_patches(scene.hidden)
    assert background_radiance(scene, laser_spot(scene), patches, rays, seen).max() == 0.0


def test_patches_hold_the_area_and_centre_of_the_picture():
    picture = np.random.default_rng(2).random((37, 53))
    hidden = PlanarObject(picture, (0.5, 0.3), position=(0.1, 0.2, 1.0), roll=0.4)
    patches = object_patches(hidden)
    assert patches.areas.sum() == pytest.approx(picture.mean() * 0.15, rel=1e-13)
    rows, columns = (np.arange(n) + 0.5 for n in picture.shape)
    column = (picture.sum(0) * columns).sum() / picture.sum()
    row = (picture.sum(1) * rows).sum() / picture.sum()
    right, up, normal = hidden.axes
    centre = hidden.position + (column / 53 - 0.5) * 0.5 * right + (0.5 - row / 37) * 0.3 * up
    mean = (patches.points * patches.areas[:, None]).sum(0) / patches.areas.sum()
    np.testing.assert_allclose(mean, centre, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(patches.normals[0], normal)


@pytest.mark.parametrize("slope", [0.004, 0.02])
def test_patches_of_a_highlight_reflect_all_of_its_light(flat_scene, slope):
    """The lobe's highlight is narrower than a patch; one sample per patch may miss it."""
    material = SumMaterial(Lambert(0.75), SpecularMicrofacet(0.05, slope))
    spot = laser_spot(flat_scene)
    along = spot.incident * (1.0, 1.0, -1.0)
    hidden = replace(
        flat_scene.hidden,
        image=np.random.default_rng(3).random((16, 16)),
        size=0.6,
        position=tuple(spot.point + 0.8 / along[2] * along + (0.1, 0.05, 0.0)),
    )
    scene = replace(flat_scene, wall_material=material, hidden=hidden)
    side = 16 * 75
    row, column = (np.mgrid[:side, :side] + 0.5).reshape(2, -1) / 75
    points = picture_points(hidden, column, row)
    light = spot_irradiance(scene, spot, points, hidden.axes[2])[0]
    light *= hidden.reflectance[row.astype(int), column.astype(int)] * (0.6 / side) ** 2
    patches = lit_patches(scene, spot)
    found = patches.areas * spot_irradiance(scene, spot, patches.points, hidden.axes[2])[0]
    assert found.sum() == pytest.approx(light.sum(), rel=1e-3)
    centre = (found @ patches.points) / found.sum()
    np.testing.assert_allclose(centre, light @ points / light.sum(), rtol=0, atol=1e-3)


def test_mesh_patches_hold_its_area_and_centre():
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    for shape in (mesh, trimesh.creation.icosphere(subdivisions=5, radius=0.2)):
        hidden = MeshObject(shape, position=(0.1, 0.0, 1.0))
        patches = object_patches(hidden)
        assert len(patches.areas) <= 4096
        assert patches.areas.sum() == pytest.approx(shape.area, rel=1e-12)
        mean = (patches.points * patches.areas[:, None]).sum(0) / shape.area
        # even sampling of a list of triangles in no special order
        np.testing.assert_allclose(mean, hidden.position, rtol=0, atol=2e-3)


@pytest.mark.parametrize(("x", "expected"), [(0.4, True), (0.5, False), (0.6, False)])
def test_mesh_is_lit_from_its_front_only(x, expected):
    """Light that grazes a triangle in its plane does not light it."""
    corners = [[0.5, -1.0, 0.5], [0.5, 0.0, 2.5], [0.5, 1.0, 0.5]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2]])
    assert mesh.face_normals[0].tolist() == [-1.0, 0.0, 0.0]
    ray = (np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    assert mesh_hits(mesh, np.array([x, 0.1, 0.0]), *ray)[2].tolist() == [expected]


def test_sensor_gain_follows_the_camera_equation(flat_scene):
    """E = pi L T cos^4/(4 N^2 (1+m)^2), electrons E A t QE lambda/(hc)."""
    camera = flat_scene.camera
    n = camera.focal_length / camera.stop_diameter
    m = camera.focal_length / (flat_scene.focus_distance - camera.focal_length)
    irradiance = math.pi * camera.transmission / (4 * n**2 * (1 + m) ** 2)
    electrons = irradiance * camera.image_pitch**2 * 0.02 * camera.quantum_efficiency
    expected = photon_rate(electrons, flat_scene.laser.wavelength)
    gain = electrons_per_radiance(flat_scene, np.array([1.0, 0.9]), 0.02)
    np.testing.assert_allclose(gain, expected * np.array([1.0, 0.9**4]), rtol=1e-14)


@pytest.mark.parametrize("stop", [0.025, 0.06, 0.1])
def test_no_cone_gathers_more_than_a_half_space(flat_scene, stop):
    """E/L = pi sin^2 of the cone, at most pi; a wider cone than the half space is refused."""
    camera = replace(flat_scene.camera, focal_length=0.05, stop_diameter=stop)
    scene = replace(flat_scene, camera=camera)
    gain = float(electrons_per_radiance(scene, np.array(1.0), 1.0))
    ratio = gain / camera.image_pitch**2 / camera.transmission / electrons_per_joule(scene)
    sine = stop / 2 / scene.image_distance
    assert ratio == pytest.approx(math.pi * sine**2, rel=1e-13)
    assert ratio <= math.pi
    wide = replace(scene, camera=replace(camera, stop_diameter=0.2))
    with pytest.raises(SceneError, match=r"F/0.256, limit F/0.5"):
        electrons_per_radiance(wide, np.array(1.0), 1.0)


# --- the laser's spot seen directly


@pytest.mark.parametrize("aim", [(0.0, 0.0, 0.0), (0.12, -0.07, 0.0)])
def test_spot_power_is_that_into_the_lens_cone(flat_scene, aim):
    laser = replace(flat_scene.laser, aim=aim)
    scene = replace(flat_scene, wall_material=Lambert(0.7), laser=laser)
    spot = laser_spot(scene)
    camera = scene.camera
    toward = np.array(camera.position) - aim
    r = np.linalg.norm(toward)
    solid = np.pi / 4 * camera.stop_diameter**2 * (-(toward / r) @ camera.axis) / r**2
    expected = 5e-3 * 0.7 / np.pi * toward[2] / r * solid * camera.transmission
    assert spot_power_through_lens(scene, spot) == pytest.approx(expected, rel=1e-13)
    hidden = replace(scene, camera=replace(camera, field_stop=np.radians(2)))
    assert spot_power_through_lens(hidden, spot) == 0.0


@pytest.mark.parametrize(("beam", "farther"), [(3e-3, 1.0), (4e-2, 1.3)])
def test_spot_image_has_its_place_size_and_energy(flat_scene, beam, farther):
    """Defocus is most of the narrow beam's image, and a small part of the wide one's."""
    camera = replace(
        flat_scene.camera,
        position=tuple(farther * np.array(flat_scene.camera.position)),
        aim=(0.02, 0.01, 0.0),
        pixels=(512, 512),
        binning=2,
    )
    laser = replace(flat_scene.laser, beam_diameter=beam)
    scene = replace(flat_scene, camera=camera, laser=laser)
    spot = laser_spot(scene)
    shares = spot_image(scene, spot)
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    u, v, depth = camera.frame @ (spot.point - np.array(camera.position))
    x, y = pixel_centres(camera)
    d = scene.image_distance
    # symmetric about the spot's pinhole image but for the sampling of 16 parts per radius
    assert (shares.sum(0) * x).sum() == pytest.approx(-d * u / depth, abs=1e-7)
    assert (shares.sum(1) * y).sum() == pytest.approx(-d * v / depth, abs=1e-7)
    image_distance = 1 / (1 / camera.focal_length - 1 / depth)
    blur = camera.stop_diameter / 2 * abs(d - image_distance) / image_distance
    toward = -spot.point + np.array(camera.position)
    facing = toward[2] / np.linalg.norm(toward)
    disc_sq = spot.area * facing / np.pi * (d / depth) ** 2
    # variances of uniform discs add: R^2/4 each; plus the pixels', and half of a subsample
    spread = (shares.sum(0) * x**2).sum() - (shares.sum(0) * x).sum() ** 2
    assert spread == pytest.approx((blur**2 + disc_sq) / 4 + camera.image_pitch**2 / 12, rel=0.01)


def test_area_common_to_two_circles():
    # equal unit circles at distance d: 2 acos(d/2) - d/2 sqrt(4 - d^2)
    d = np.array([0.3, 1.0, 1.9])
    expected = 2 * np.arccos(d / 2) - d / 2 * np.sqrt(4 - d**2)
    np.testing.assert_allclose(common_area(d, 1.0, 1.0), expected, rtol=1e-13)  # cancels
    areas = common_area(np.array([0.0, 0.5, 4.0]), 3.0, 1.0)
    # arccos near +-1 loses half the digits
    np.testing.assert_allclose(areas, [np.pi, np.pi, 0.0], atol=1e-7)
    r = (np.arange(4000) + 0.5) * 1e-3
    total = (2 * np.pi * r * common_area(r, 2.0, 0.7)).sum() * 1e-3
    # the integral is the product of the areas; midpoint rule
    assert total == pytest.approx(np.pi * 4 * np.pi * 0.49, rel=1e-6)
