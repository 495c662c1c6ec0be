"""Differentiable scene parameters, against the aimed wave and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from nlosoptics import Scene, psf
from nlosoptics.errors import CausticError, SamplingError, SceneError
from nlosoptics.inverse import SceneLeaves
from nlosoptics.inverse.wave.scene_parameters import _frame
from nlosoptics.inverse.wave.wall_paths import WallPaths, height_by_radius
from nlosoptics.psf.pupil.aiming import pupil_points
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    SpecularMicrofacet,
    SumMaterial,
)
from nlosoptics.scene.parts.camera import pupil_frame

SIZE = (1.4, 1.0)
PATHS = ("wall_radius", "object_position", "object_tilt", "camera_position", "focus_distance")
WALLS = [
    ConcaveWall(1.5, size=SIZE),
    ConvexWall(2.0, size=SIZE),
    ConcaveWall(1.8, size=SIZE, shape="cylinder", axis="x"),
    ConvexWall(1.8, size=SIZE, shape="cylinder", axis="y"),
]
FIELD = [[0.02, 0.03], [-0.05, 0.01]]


@pytest.fixture(scope="module")
def speckle(examples):
    return Scene.load(examples / "scenes" / "letter_speckle.toml")


def leaves_of(scene, names=PATHS, *, shape=64, dtype=torch.float64, **options):
    return SceneLeaves(scene, names, pitch=4.5e-6, shape=shape, dtype=dtype, **options)


def nodes_of(optics):
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    inside = (optics.share > 0) & (np.hypot(u, v) <= optics.pupil_radius)
    return inside, np.stack([u[inside], v[inside]], axis=-1)


@pytest.mark.parametrize("wall", WALLS)
def test_paths_are_psf_wall_aberration(speckle, wall):
    camera = speckle.camera
    nodes = np.random.default_rng(0).uniform(-0.6e-3, 0.6e-3, (40, 2))
    expected = psf.wall_aberration(wall, speckle.object_point, camera.position, camera.aim, nodes)
    centre, axis = np.array(camera.position), camera.axis
    points = pupil_points(centre, axis, np.concatenate([np.zeros((1, 2)), nodes]))
    excess, hits = WallPaths.apply(
        torch.tensor(wall.radius, dtype=torch.float64),
        torch.from_numpy(speckle.object_point),
        torch.from_numpy(points),
        torch.from_numpy(axis),
        wall,
    )
    np.testing.assert_array_equal((excess[1:] - excess[0]).numpy(), expected)
    np.testing.assert_allclose(hits[:, 2], wall.height(*hits[:, :2].numpy().T), rtol=1e-12)


@pytest.mark.parametrize("wall", WALLS)
def test_paths_pass_gradcheck(speckle, wall):
    camera = speckle.camera
    nodes = np.array([[0.0, 0.0], [0.01, 0.004], [-0.006, 0.012]])
    points = pupil_points(camera.position, camera.axis, nodes)
    axis = torch.from_numpy(camera.axis)
    inputs = (
        torch.tensor(wall.radius, dtype=torch.float64, requires_grad=True),
        torch.tensor(speckle.object_point, requires_grad=True),
        torch.tensor(points, requires_grad=True),
    )

    def excess(radius, o, p):
        return WallPaths.apply(radius, o, p, axis, wall)[0]

    # differences over 2e-5 m of paths good to 1e-17 m, third derivatives of some 1/m^2
    assert torch.autograd.gradcheck(excess, inputs, eps=1e-5, atol=1e-8, rtol=1e-7)


@pytest.mark.parametrize("wall", WALLS)
def test_height_by_radius_is_the_difference_of_heights(wall):
    hits = np.random.default_rng(1).uniform(-0.4, 0.4, (20, 3))
    step = 1e-5
    high, low = (
        replace(wall, radius=wall.radius + s).height(*hits[:, :2].T) for s in (step, -step)
    )
    # central differences: step^2 times a third derivative of some 0.1, and roundings over 2 steps
    np.testing.assert_allclose(
        height_by_radius(wall, wall.radius, hits), (high - low) / (2 * step), rtol=0, atol=1e-10
    )


@pytest.mark.parametrize("wall", [*WALLS, FlatWall(size=SIZE)])
@pytest.mark.parametrize("defocus", [0.0, 0.05])
def test_the_start_is_psf_wavefront_without_its_plane(speckle, wall, defocus):
    camera = replace(speckle.camera, focus_distance=speckle.focus_distance + defocus)
    scene = replace(speckle, wall=wall, camera=camera)
    module = leaves_of(scene, ["object_position"])
    inside, nodes = nodes_of(module.optics)
    found = module.aberration().detach().numpy()[inside]
    expected = psf.wavefront(scene, nodes=nodes).aberration
    terms = np.column_stack([np.ones(len(nodes)), nodes / 1e-3])
    rest = found - expected
    rest -= terms @ np.linalg.lstsq(terms, rest, rcond=None)[0]
    # both keep some 1e-17 m
    assert np.abs(rest).max() < 1e-16
    if not wall.is_flat or defocus:
        assert found.std() > 1e-9


def test_the_fitted_plane_is_out(speckle):
    module = leaves_of(replace(speckle, wall=WALLS[0]), ["wall_radius"])
    optics = module.optics
    path = module.aberration().detach().numpy()
    for term in (np.ones_like(path), *np.meshgrid(optics.u, optics.v)):
        share = np.sum(term * path * optics.amplitude)
        # roundings of a sum of 700
        assert abs(share) < 1e-11 * np.sum(np.abs(term * path * optics.amplitude))


@pytest.mark.parametrize("wall", [ConcaveWall(2.5, size=SIZE), *WALLS[1:3]])
def test_gradients_are_differences_of_the_wave(speckle, wall):
    scene = replace(speckle, wall=wall)
    module = leaves_of(scene, shape=32)
    probe = torch.randn(
        (2, *module.optics.share.shape), dtype=torch.float64, generator=torch.manual_seed(0)
    )
    (module.aberration(FIELD) * probe).sum().backward()
    step = 1e-4
    for name, leaf in module.leaves.items():
        gradient = leaf.grad.reshape(-1)
        assert gradient.abs().max() > 0, name
        for i in range(leaf.numel()):
            sums = []
            for change in (step, -step):
                with torch.no_grad():
                    leaf.view(-1)[i] += change
                    sums.append(float((module.aberration(FIELD) * probe).sum()))
                    leaf.view(-1)[i] -= change
            difference = (sums[0] - sums[1]) / (2 * step)
            # step^2 against the metre on which waves change, and 1e-17 m a cell over 2 steps
            tolerance = 1e-5 * float(gradient.abs().max()) + 1e-11
            assert float(gradient[i]) == pytest.approx(difference, rel=1e-5, abs=tolerance), name


def test_tilt_moves_points_beside_the_centre_alone(speckle):
    scene = replace(speckle, wall=WALLS[1], hidden=replace(speckle.hidden, yaw=0.1, pitch=-0.2))
    module = leaves_of(scene, ["object_tilt"], shape=32)
    right, up, _ = scene.hidden.axes
    for place, found in zip(FIELD, module.aberration(FIELD), strict=True):
        point = scene.object_point + place[0] * right + place[1] * up
        moved = replace(scene, hidden=replace(scene.hidden, position=tuple(point)))
        camera = replace(scene.camera, focus_distance=scene.focus_distance)
        alone = leaves_of(replace(moved, camera=camera), ["wall_radius"], shape=32)
        # both keep some 1e-17 m; amplitudes of the plane's fit differ by 1e-4 of the wave
        torch.testing.assert_close(
            found.detach(), alone.aberration().detach(), rtol=1e-3, atol=1e-12
        )
    assert not module.aberration().requires_grad


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_point_spreads_of_places_and_their_transfer(speckle, dtype):
    module = leaves_of(replace(speckle, wall=WALLS[0]), dtype=dtype)
    stack = module(FIELD)
    assert tuple(stack.shape) == (2, 64, 64)
    assert stack.dtype == dtype
    spectrum = torch.fft.rfft2(stack.roll((-32, -32), (-2, -1)))
    # roundings of one transform of what sums to 1
    tolerance = 1e-13 if dtype == torch.float64 else 1e-5
    torch.testing.assert_close(module.transfer(FIELD), spectrum, rtol=0, atol=tolerance)
    stack[0, 32, 32].backward()
    assert all(leaf.grad.dtype == torch.float64 for leaf in module.leaves.values())
    assert all(bool(torch.isfinite(leaf.grad).all()) for leaf in module.leaves.values())


def glossy(scene, slope):
    lobes = [
        replace(part, slope_rms=slope) if isinstance(part, SpecularMicrofacet) else part
        for part in scene.wall_material.parts
    ]
    return replace(scene, wall_material=SumMaterial(*lobes))


def test_a_lobe_blurs_as_its_point_spread(speckle):
    scene = glossy(replace(speckle, wall=WALLS[0]), 2e-4)
    module = leaves_of(scene, ["lobe_slope"], shape=96, pixel_integrated=True)
    expected = psf.scene_point_spread(scene, pitch=4.5e-6, shape=96).point_spread.intensity
    found = module().detach().numpy() * expected.sum()  # 98 % of the plane is in the window
    # the rim's tails, 2 % of the light, come back in the period; cells at the rim, 24 to the radius
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.01 * expected.max())
    smooth = leaves_of(replace(speckle, wall=WALLS[0]), ["wall_radius"], shape=96)()
    assert found.max() < 0.5 * float(smooth.detach().max())
    probe = torch.rand(96, 96, dtype=torch.float64, generator=torch.manual_seed(0))
    slope = torch.tensor(2e-4, dtype=torch.float64, requires_grad=True)

    def weighted(value):
        spread = torch.func.functional_call(module, {"leaves.lobe_slope": value}, ())
        return (spread * probe).sum()

    # central differences over 1 % of the slope
    assert torch.autograd.gradcheck(weighted, slope, eps=1e-6, rtol=1e-3)


def test_adam_finds_the_radius_of_the_wall(speckle):
    truth = leaves_of(replace(speckle, wall=ConcaveWall(1.5, size=SIZE)), ["wall_radius"])
    target = truth.transfer().detach()
    module = leaves_of(replace(speckle, wall=ConcaveWall(1.6, size=SIZE)), ["wall_radius"])
    optimiser = torch.optim.Adam(module.parameters(), lr=0.01)
    for _ in range(60):
        optimiser.zero_grad()
        (module.transfer() - target).abs().square().sum().backward()
        optimiser.step()
    # what steps of 0.01 m leave
    assert float(module.leaves["wall_radius"].detach()) == pytest.approx(1.5, abs=5e-3)


@pytest.mark.parametrize(
    ("names", "change", "kind", "text"),
    [
        (["radius"], {}, SceneError, "leaf = 'radius' is unknown"),
        ([], {}, SceneError, "at least one"),
        (["focus_distance"] * 2, {}, SceneError, "each leaf once"),
        (["wall_radius"], {"wall": FlatWall(size=SIZE)}, SceneError, "but a FlatWall has none"),
        (["lobe_slope"], {}, SceneError, "lobe_slope starts at 0"),
        (["wall_radius"], {"wall": ConcaveWall(1.1, size=SIZE)}, CausticError, "wall"),
        (["wall_radius"], {"wall": ConcaveWall(1.5, size=1e-3)}, SamplingError, "is the stop"),
    ],
)
def test_bad_leaves_are_refused_in_one_line(speckle, names, change, kind, text):
    with pytest.raises(kind, match=text) as caught:
        leaves_of(replace(speckle, **({"wall": WALLS[0]} | change)), names)
    assert "\n" not in str(caught.value)


def test_blur_needs_a_period_and_field_a_plane(speckle):
    with pytest.raises(SamplingError, match="must be .fft. for a lobe"):
        leaves_of(glossy(speckle, 1e-3), ["lobe_slope"], method="mdft")
    module = leaves_of(replace(speckle, wall=WALLS[0]), ["wall_radius"])
    with pytest.raises(SceneError, match=r"give finite positions \(K, 2\)"):
        module([0.1, 0.2])
    with pytest.raises(SceneError, match=r"give finite positions \(K, 2\)"):
        module([[0.1, np.nan]])


@pytest.mark.parametrize("field", ["a", np.zeros((0, 2)), [[1.0, np.nan]]])
def test_bad_fields_are_refused(speckle, field):
    leaves = leaves_of(speckle, ("object_position",))
    with pytest.raises(SceneError, match="field .*; give"):
        leaves(field)


@pytest.mark.parametrize("axis", [(0.6, 0.0, -0.8), (0.48, -0.6, -0.64), (0, 1, 0), (0, -1, 0)])
def test_frames_of_the_pupil_are_the_scenes(axis):
    axis = np.array(axis, dtype=float)
    found = _frame(torch.from_numpy(axis)).numpy()
    np.testing.assert_allclose(found, pupil_frame(axis)[:2], atol=1e-15)


def test_a_plane_wall_has_no_radius_to_change():
    found = height_by_radius(FlatWall(size=SIZE), 1.5, np.ones((4, 3)))
    assert found.tolist() == [0.0] * 4


def test_axes_of_a_turned_object_are_the_scenes(speckle):
    hidden = replace(speckle.hidden, yaw=0.3, pitch=-0.2, roll=0.5)
    module = leaves_of(replace(speckle, hidden=hidden), ["object_tilt"])
    right, up, _ = hidden.axes
    np.testing.assert_allclose(module._object_axes().detach(), [right, up], atol=1e-14)
