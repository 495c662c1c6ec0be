"""The whole image: energy, linearity, bookkeeping, point spread, seeds and bad input."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.imaging import diffuse_background, form_image
from nlosoptics.imaging.detector import speckles_per_pixel
from nlosoptics.imaging.geometry import chief_rays, picture_positions, pixel_centres
from nlosoptics.imaging.radiometry import photon_rate
from nlosoptics.psf import PointSpreadField
from nlosoptics.scene import (
    ConcaveWall,
    FlatWall,
    Lambert,
    MeshObject,
    PlanarObject,
    SpecularMicrofacet,
    SumMaterial,
    WavyWall,
)


def spread(scene, kernel=((1.0,),), **changes):
    """A point spread with the fields that an image needs."""
    fields = {"pitch": scene.camera.image_pitch, "normalisation": "unit-sum", **changes}
    fields = {"pixel_integrated": False, **fields}
    return SimpleNamespace(intensity=np.array(kernel, dtype=float), **fields)


def gaussian(width, count=15):
    offset = np.arange(count) - count // 2
    g = np.exp(-(offset**2) / (2 * width**2))
    return np.outer(g, g) / g.sum() ** 2


def test_signal_is_the_power_that_a_small_object_sends_through_the_lens(flat_scene):
    """rho_s L dA cos times the lens's solid angle from the mirrored object: no pixel in it."""
    side = 4e-3
    hidden = replace(flat_scene.hidden, image=np.ones((4, 4)), size=side, yaw=0.3)
    scene = replace(flat_scene, hidden=hidden)
    image = form_image(scene, spread(scene))
    centre, normal = np.array(hidden.position), hidden.axes[2]
    r = np.linalg.norm(centre)
    to_spot = -centre / r
    irradiance = 5e-3 * 0.7 / math.pi * centre[2] / r * (to_spot @ normal) / r**2
    leg = centre * (1, 1, -1) - np.array(scene.camera.position)
    path = np.linalg.norm(leg)
    leg /= path
    facing = leg @ -(normal * (1, 1, -1))
    solid = math.pi / 4 * scene.camera.stop_diameter**2 * (leg @ scene.camera.axis) / path**2
    power = 0.05 * 0.8 / math.pi * irradiance * side**2 * facing * solid
    camera = scene.camera
    electrons = photon_rate(
        power * camera.transmission * camera.exposure * camera.quantum_efficiency, 632.8e-9
    )
    # distances change by side/r across the object, in square: 1e-5; the pixel's are longer
    assert image.ledger["ideal"] == pytest.approx(electrons, rel=2e-3)


@pytest.mark.parametrize("wall", [FlatWall(), ConcaveWall(3.0), WavyWall(5e-5, 0.1)])
def test_expected_electrons_are_linear_in_power_exposure_and_camera(flat_scene, wall):
    scene = replace(flat_scene, wall=wall, camera=replace(flat_scene.camera, glare_fraction=1e-3))
    reference = form_image(scene, spread(scene)).expected
    brighter = replace(scene, laser=replace(scene.laser, power=3 * scene.laser.power))
    cases = [(brighter, 3.0, {}), (scene, 2.0, {"exposure": 2 * scene.camera.exposure})]
    for name, factor in (("quantum_efficiency", 0.5), ("transmission", 0.9), ("exposure", 1.7)):
        camera = replace(scene.camera, **{name: factor * getattr(scene.camera, name)})
        cases.append((replace(scene, camera=camera), factor, {}))
    for case, factor, options in cases:
        # products in another order round differently
        np.testing.assert_allclose(
            form_image(case, spread(case), **options).expected,
            factor * reference, rtol=1e-11, atol=1e-12 * reference.max(),
        )  # fmt: skip


def test_blur_keeps_energy_and_the_ledger_adds_up(flat_scene):
    kernel = 0.97 * gaussian(2.0)  # 3 % lie outside its window
    image = form_image(flat_scene, spread(flat_scene, kernel))
    book = image.ledger
    assert book["ideal"] == pytest.approx(image.ideal.sum(), rel=1e-13)
    assert book["beyond_window"] == pytest.approx(0.03 * book["ideal"], rel=1e-12)
    # the letter keeps off the edges: what is missing is the window's loss, and FFT rounding
    assert book["signal"] == pytest.approx(0.97 * book["ideal"], rel=1e-12)
    assert abs(book["beyond_detector"]) < 1e-11 * book["ideal"]
    parts = book["diffuse"] + book["spot"] + book["glare"] + book["dark"]
    assert image.background.sum() == pytest.approx(parts, rel=1e-12)
    np.testing.assert_allclose(image.expected, image.signal + image.background, rtol=1e-12)


def test_object_at_the_edge_loses_blurred_light(flat_scene):
    camera = replace(flat_scene.camera, pixels=(2048, 2048))
    hidden = replace(flat_scene.hidden, size=1.5)
    scene = replace(flat_scene, camera=camera, hidden=hidden)
    book = form_image(scene, spread(scene, gaussian(3.0))).ledger
    assert 0.005 < book["beyond_detector"] / book["ideal"] < 0.2
    assert book["ideal"] == pytest.approx(book["signal"] + book["beyond_detector"], rel=1e-12)


def test_noise_averages_to_the_expected_image(flat_scene):
    camera = replace(flat_scene.camera, field_stop=math.radians(20), dark_current=1.0)
    laser = replace(flat_scene.laser, aim=(-0.4, 0.3, 0.0), independent_patterns=3)
    scene = replace(flat_scene, camera=camera, laser=laser)
    images = [form_image(scene, spread(scene), seed=s) for s in range(24)]
    first = images[0]
    deviation = np.mean([i.electrons for i in images], axis=0) - first.expected
    scaled = deviation / first.noise_sigma * math.sqrt(24)
    # 4096 normal deviates: mean and variance within five standard errors
    assert abs(scaled.mean()) < 5 / 64
    assert scaled.var() == pytest.approx(1, abs=5 * math.sqrt(2) / 64)
    single = (first.electrons - first.expected) / first.noise_sigma
    assert single.var() == pytest.approx(1, abs=5 * math.sqrt(2) / 64)
    assert first.ledger["dark"] == pytest.approx(64**2 * 40e-3 * 64**2, rel=1e-12)


def test_speckle_contrast_counts_patterns_and_polarisations(flat_scene):
    camera = replace(flat_scene.camera, pixels=(64, 64), binning=1)
    scene = replace(flat_scene, camera=camera)
    assert form_image(scene, spread(scene)).speckle_contrast == 0.0
    f_number = scene.image_distance / camera.stop_diameter
    per_pixel = speckles_per_pixel(9e-6, 632.8e-9, f_number)
    assert 30 < per_pixel < 60
    for patterns in (1, 5):
        laser = replace(scene.laser, independent_patterns=patterns)
        image = form_image(replace(scene, laser=laser), spread(scene))
        assert image.speckle_contrast == pytest.approx(
            (2 * per_pixel * patterns) ** -0.5, rel=1e-12
        )
        light = image.expected
        quiet = light + 3.6**2 + (70e3 / 2**16) ** 2 / 12
        np.testing.assert_allclose(
            image.noise_sigma**2, quiet + light**2 / (2 * per_pixel * patterns), rtol=1e-12
        )


def test_field_stop_blocks_spot_and_glare(flat_scene):
    camera = replace(flat_scene.camera, glare_fraction=0.01)
    laser = replace(flat_scene.laser, aim=(-0.4, 0.2, 0.0))
    scene = replace(flat_scene, camera=camera, laser=laser)
    bare = form_image(scene, spread(scene))
    assert bare.saturated_fraction > 0
    assert bare.ledger["glare"] == pytest.approx(0.01 / 0.99 * bare.ledger["spot"], rel=1e-12)
    stopped = replace(scene, camera=replace(camera, field_stop=math.radians(16)))
    image = form_image(stopped, spread(stopped))
    assert image.ledger["spot"] == image.ledger["glare"] == 0.0
    assert image.saturated_fraction == 0.0
    assert image.background[0, 0] == 0.0
    assert image.background[32, 32] > 0


def test_wall_without_a_mirror_lobe_forms_no_image(flat_scene):
    scene = replace(flat_scene, wall_material=Lambert(0.7))
    image = form_image(scene, spread(scene))
    assert image.signal.max() == image.ideal.max() == 0.0
    assert image.ledger["diffuse"] > 0
    with_lobe = form_image(flat_scene, spread(flat_scene))
    np.testing.assert_array_equal(image.background, with_lobe.background)


def test_other_picture_and_exposure_replace_the_scenes_own(flat_scene):
    picture = np.zeros((16, 16))
    picture[4:12, 2:6] = 0.5
    hidden = replace(flat_scene.hidden, image=picture)
    camera = replace(flat_scene.camera, exposure=0.01)
    scene = replace(flat_scene, hidden=hidden, camera=camera)
    want = form_image(scene, spread(scene), seed=3)
    got = form_image(flat_scene, spread(flat_scene), picture, exposure=0.01, seed=3)
    np.testing.assert_array_equal(want.electrons, got.electrons)
    assert got.exposure == 0.01
    assert got.seed == 3


def test_seed_gives_the_bits_and_arrays_are_read_only(flat_scene):
    first, again, other = (form_image(flat_scene, spread(flat_scene), seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.electrons, again.electrons)
    assert (first.electrons != other.electrons).any()
    with pytest.raises(ValueError, match="read-only"):
        first.electrons[0, 0] = 1.0
    with pytest.raises(TypeError):
        first.ledger["ideal"] = 0.0


def test_mesh_of_a_plane_looks_like_the_picture(flat_scene):
    """A white square as a mesh and as a picture, in the flat wall and in a hollow one."""
    flat_square = trimesh.Trimesh(
        [[0.1, -0.1, 0], [-0.1, -0.1, 0], [-0.1, 0.1, 0], [0.1, 0.1, 0]],
        [[0, 1, 2], [0, 2, 3]], process=False,
    )  # fmt: skip
    pose = {"position": (0.38, 0.02, 1.0), "yaw": 0.2}
    picture = PlanarObject(np.ones((8, 8)), 0.2, **pose)
    mesh = MeshObject(flat_square, **pose)
    facing = mesh.surface.face_normals[0] @ picture.axes[2]
    assert facing == pytest.approx(1.0, abs=1e-12)
    for wall in (FlatWall(), ConcaveWall(4.0)):
        a, b = (
            form_image(s, spread(s))
            for s in (replace(flat_scene, wall=wall, hidden=h) for h in (picture, mesh))
        )
        inner = a.ideal > 0.9 * a.ideal.max()
        assert inner.sum() > 20
        # at the pixel's centre or at four points about it: second order in a pixel
        np.testing.assert_allclose(b.ideal[inner].mean(), a.ideal[inner].mean(), rtol=0.02)
        # edges are sampled by four rays a pixel
        assert b.ledger["ideal"] == pytest.approx(a.ledger["ideal"], rel=0.05)
        # 512 patches each
        assert b.ledger["diffuse"] == pytest.approx(a.ledger["diffuse"], rel=2e-3)


def test_mesh_casts_a_shadow_on_itself(flat_scene):
    """A small plate between the spot and a large one darkens its middle."""

    def plate(half, x, z):
        corners = half * np.array([[1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])
        return trimesh.Trimesh(corners + np.array([x, 0, z]), [[0, 1, 2], [0, 2, 3]], process=False)

    # where the line from the spot at the origin to (0.38, 0, 1) passes z = 0.7
    both = trimesh.util.concatenate([plate(0.2, 0.0, 0.0), plate(0.04, 0.7 * 0.38 - 0.38, -0.3)])
    pose = {"position": (0.38, 0.0, 1.0)}
    flat_scene = replace(flat_scene, camera=replace(flat_scene.camera, binning=32))
    alone = replace(flat_scene, hidden=MeshObject(plate(0.2, 0.0, 0.0), **pose))
    shaded = replace(flat_scene, hidden=MeshObject(both, **pose))
    a, b = (form_image(s, spread(s)).ideal for s in (alone, shaded))
    lost = (a > 0) & (b == 0)
    # the small plate's shadow on the large one: 0.08 m grown by 1/0.7, in part seen
    assert 10 < lost.sum() < 0.3 * (a > 0).sum()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"pitch": 9e-6}, SamplingError, "point_spread.pitch = 9e-06 m, camera pixels are"),
        ({"normalisation": "ideal-peak"}, SamplingError, "normalisation='unit-sum'"),
        ({"kernel": [[3.0]]}, SamplingError, "sums to 3, limit 1"),
        ({"kernel": [[3.0]], "pixel_integrated": True}, SamplingError, "sums to 3, limit 1"),
        ({"kernel": [[0.8, -0.1]]}, SamplingError, "is negative, down to -0.1 with a peak of 0.8"),
        ({"exposure": -1.0}, SceneError, "exposure"),
        ({"exposure": math.nan}, SceneError, "exposure"),
        ({"seed": -1}, SceneError, "seed = -1 is out of range, must be from 0 to 184467"),
        ({"seed": 2**64}, SceneError, f"seed = {2**64} is out of range, must be .* to {2**64 - 1}"),
        ({"seed": 10**23 - 1}, SceneError, f"seed = {'9' * 23} is out of range"),
        ({"seed": 1 << 20000}, SceneError, "seed = an int of 20001 bits is out of range"),
        ({"seed": True}, SceneError, "seed = True is not a whole number"),
        ({"seed": "1"}, SceneError, "seed = '1' is not a whole number"),
        ({"picture": "abc"}, SceneError, r"object_image has shape \(\); give a greyscale image"),
        ({"picture": [[1.0], [1.0, 0.0]]}, SceneError, "object_image has rows of unequal length"),
        ({"picture": [[2.0]]}, SceneError, "object_image spans"),
        ({"picture": [1.0]}, SceneError, "object_image has shape"),
        ({"picture": [[math.nan]]}, SceneError, "object_image holds NaN"),
    ],
)
def test_bad_input_is_refused(flat_scene, change, error, message):
    kernel = change.pop("kernel", [[1.0]])
    picture = change.pop("picture", None)
    options = {k: change.pop(k) for k in ("exposure", "seed") if k in change}
    with pytest.raises(error, match=message) as caught:
        form_image(flat_scene, spread(flat_scene, kernel, **change), picture, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("arrow", [lambda s: form_image(s, spread(s)), diffuse_background])
def test_image_beyond_memory_is_refused(flat_scene, arrow):
    camera = replace(flat_scene.camera, pixels=(300000, 300000), binning=1)
    named = r"300000 x 300000 pixels \(camera.pixels, camera.binning\) needs .* GiB, limit .*; read"
    with pytest.raises(MemoryLimitError, match=named) as caught:
        arrow(replace(flat_scene, camera=camera))
    assert "\n" not in str(caught.value)


def test_photon_budget_of_the_diffuse_background(flat_scene):
    """25 mm stop, albedo 0.8, 512^2 pixels of 72 um, 10 ms: about 20, 43 and 110 electrons in the
    middle for objects of 0.2, 0.3 and 0.5 m with a mean reflectance of 0.35, parallel to the
    wall. (f 50.6 mm, QE 0.7, transmission 0.9, camera and object 1 m away.)"""
    position = (0.2, 0.0, 0.98)
    camera = replace(
        flat_scene.camera, position=(-0.2, 0.0, 0.98), aim=(0, 0, 0), binning=8, exposure=0.01
    )
    laser = replace(flat_scene.laser, aim=(0.0, 0.06, 0.0))
    material = SumMaterial(Lambert(0.8), SpecularMicrofacet(0.05, 0.0))
    for size, electrons in ((0.2, 20), (0.3, 43), (0.5, 110)):
        hidden = PlanarObject(np.full((8, 8), 0.35), size, position=position)
        scene = replace(
            flat_scene, camera=camera, laser=laser, hidden=hidden, wall_material=material
        )
        image = form_image(scene, spread(scene))
        # budgets in two digits: half a unit of the last of them
        assert image.background[256, 256] == pytest.approx(electrons, rel=0.025)


def test_diffuse_background_hardly_depends_on_the_picture(flat_scene):
    """A white plate's veil has the shape of a letter's, scaled by their light."""
    veil = diffuse_background(flat_scene)
    white = diffuse_background(flat_scene, np.ones((4, 4)))
    seen = veil > 0
    ratio = veil[seen] / white[seen]
    # the object subtends 0.3 rad from the wall, and its light's centre moves by a tenth of that
    assert np.ptp(ratio) / ratio.mean() < 0.1
    longer = diffuse_background(flat_scene, exposure=2 * flat_scene.camera.exposure)
    assert longer == pytest.approx(2 * veil, rel=1e-12)


def test_windows_of_a_field_hold_the_light_of_each_point(flat_scene):
    """Beyond the window: what the kernels' sums lack, by the image at each point of the picture."""
    draw, scene = np.random.default_rng(3), flat_scene.resized(16)
    field = PointSpreadField(
        modes=draw.uniform(0.0, 0.02, (3, 5, 3)),
        weights=draw.uniform(0.5, 1.0, (3, 3, 4)),
        across=np.cos(np.pi * np.arange(7, 0, -2) / 8),
        up=np.cos(np.pi * np.arange(5, 0, -2) / 6),
        pitch=scene.camera.image_pitch,
        truncation_error=0.0,
        error_estimate=0.0,
    )
    found = form_image(scene, field)
    across, up = picture_positions(scene.hidden, chief_rays(scene, *pixel_centres(scene.camera)))
    total, kept = 0.0, 0.0
    for light, x, y in zip(found.ideal.flat, across.flat, up.flat, strict=True):
        total += light
        kept += light * field.point_spread(x, y).sum() if light > 0.0 else 0.0
    assert 0.3 < kept / total < 0.9
    assert found.ledger["beyond_window"] == pytest.approx(total - kept, rel=1e-9)
    black = form_image(scene, field, np.zeros((4, 4)))
    assert black.ledger["beyond_window"] == black.ledger["beyond_detector"] == 0.0
