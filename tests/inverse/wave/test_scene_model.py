"""The differentiable image of a scene against images that are formed anew."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics import Scene, imaging, psf
from nlosoptics.errors import SceneError
from nlosoptics.inverse import SceneModel

thorough = pytest.mark.thorough


def scene_of(name, size=16):
    return Scene.load(f"examples/scenes/{name}.toml").resized(size)


def expected(scene, tol=1e-3):
    """Mean image by the public functions; of shadows without interpolation."""
    mirror = scene.wall_material.specular_reflectance > 0.0
    spread = psf.scene_point_spread(scene, tol).point_spread if mirror else None
    shadows = imaging.cast_shadows(scene, exact=True) if scene.occluders else None
    return imaging.form_image(scene, spread, shadows=shadows).expected


#: Scale of each free value, SI units.
CASES = [
    ("letter_concave", {"wall.radius": 5.0, "laser.power": 5e-3}),
    pytest.param(
        "letter_concave", {"camera.stop_diameter": 0.01, "hidden.position[2]": 0.1}, marks=thorough
    ),
    pytest.param(
        "letter_flat", {"wall.curvature": 0.4, "wall.material[0].albedo": 0.5}, marks=thorough
    ),
    pytest.param(
        "letter_wavy", {"wall.amplitude": 1e-3, "hidden.position[1]": 0.07}, marks=thorough
    ),
    pytest.param("letter_rough", {"hidden.position[2]": 0.1, "laser.aim[0]": 3.0}, marks=thorough),
    pytest.param(
        "shadows", {"occluder[0].position[0]": 0.2, "hidden.position[2]": 0.4}, marks=thorough
    ),
]


@pytest.mark.parametrize(("name", "free"), CASES)
def test_gradients_of_values_are_central_differences(name, free):
    scene = scene_of(name)
    if name == "letter_rough":
        scene = scene.with_values({"wall.roughness.realisation": "mean"})
    model = SceneModel(scene, free)
    image = model()
    assert np.array_equal(image.detach().numpy(), expected(scene))
    model.offsets.data += 1e-3
    image = model()
    weight = torch.from_numpy(np.random.default_rng(0).standard_normal(image.shape))
    (weight * image).sum().backward()
    for k, (address, scale) in enumerate(free.items()):
        up, down = (
            expected(scene.with_values(model.values | {address: model.values[address] + h}))
            for h in (1e-5 * scale, -1e-5 * scale)
        )
        change = (up - down) / 2e-5
        # the angle between weight and change may be small; rounding of 1e-14/1e-8
        error = float(model.offsets.grad[k]) - float((weight.numpy() * change).sum())
        assert abs(error) < 1e-4 * np.linalg.norm(change)


def test_a_jump_of_the_image_is_no_gradient():
    """At 1 m the number of patches of the object changes, and with it the image by 1e-4."""
    scene, rates = scene_of("letter_concave"), []
    for distance in (1.0 - 5e-10, 1.0 - 1e-6):  # a step of 1e-9 crosses 1 m from the first
        moved = scene.with_values({"hidden.position[2]": distance})
        model = SceneModel(moved, {"hidden.position[2]": 0.1})
        model().sum().backward()
        rates.append(float(model.offsets.grad[0]))
    assert rates[0] == pytest.approx(rates[1], rel=1e-4)


@pytest.mark.parametrize("name", ["letter_flat", pytest.param("shadows", marks=thorough)])
def test_gradient_of_the_object_is_that_of_the_image(name):
    random = np.random.default_rng(0)
    picture = torch.from_numpy(random.uniform(0.2, 0.8, (24, 32))).requires_grad_()
    # light from plane to wall is that of pixel centres, and its shadows are those of pixels
    model = SceneModel(scene_of(name, 64 if name == "shadows" else 16))
    image = model(picture)
    weight = torch.from_numpy(random.standard_normal(image.shape))
    (weight * image).sum().backward()
    step = 0.2 * torch.from_numpy(random.choice([-1.0, 0.0, 1.0], picture.shape))
    change = (model(picture + step) - model(picture - step)).detach() / 2.0
    error = float((picture.grad * step).sum() - (weight * change).sum())
    assert abs(error) < 1e-4 * float(change.norm() * weight.norm())


@thorough
def test_point_spreads_of_a_field():
    scene = scene_of("letter_concave")
    field = psf.point_spread_field(scene, 2)
    picture = torch.full((8, 8), 0.5, dtype=torch.float64, requires_grad=True)
    model = SceneModel(scene, nodes=2)
    image = model(picture)
    formed = imaging.form_image(scene, field, picture.detach().numpy())
    assert np.array_equal(image.detach().numpy(), formed.expected)
    image.sum().backward()
    # the image is linear in the picture, but for constant light and dark current
    dark = imaging.form_image(scene, field, np.zeros((8, 8))).expected
    assert float(0.5 * picture.grad.sum()) == pytest.approx(
        (formed.expected - dark).sum(), rel=1e-3
    )


def test_noise_and_full_well():
    scene = scene_of("letter_flat")
    model = SceneModel(scene, {"laser.power": 5e-3})
    formed = imaging.form_image(scene)
    draws = torch.stack(
        [model.reading(generator=torch.Generator().manual_seed(k)) for k in range(100)]
    ).detach()
    # 25600 squares of normal variates
    ratio = ((draws.numpy() - formed.expected) / formed.noise_sigma) ** 2
    assert ratio.mean() == pytest.approx(1.0, abs=5 * (2 / ratio.size) ** 0.5)
    full = scene.camera.full_well * scene.camera.binning**2
    model.offsets.data += 1e6
    bright = model.reading()
    assert float(bright.detach().max()) == full
    bright[bright == full].sum().backward()
    assert float(model.offsets.grad[0]) == 0.0


@thorough
@pytest.mark.parametrize("variation", [0.0, 0.5])
@pytest.mark.parametrize("name", ["letter_flat", "shadows"])
def test_gradients_through_a_solver(name, variation):
    """The implicit function theorem against differences of whole solutions."""
    address = "hidden.position[2]" if name == "letter_flat" else "occluder[0].position[0]"
    model = SceneModel(scene_of(name), {address: 0.2})
    model.offsets.data += 1e-3
    image = model().detach().requires_grad_()
    damping = 0.05 * float(image.detach().std())
    variation *= damping**2
    found = model.tikhonov(image, damping, (8, 8), variation=variation)
    weight = torch.from_numpy(np.random.default_rng(0).standard_normal(found.shape))
    (weight * found).sum().backward()

    def weighted(step, change):
        model.offsets.data += step
        given = image.detach() + change
        result = model.tikhonov(given, damping, (8, 8), variation=variation).detach()
        model.offsets.data -= step
        return float((weight * result).sum())

    slope = (weighted(1e-4, 0.0) - weighted(-1e-4, 0.0)) / 2e-4
    assert float(model.offsets.grad[0]) == pytest.approx(slope, rel=1e-3)  # truncation
    size = damping * (10.0 if variation == 0.0 else 1e-3)  # the variation is not quadratic
    change = size * torch.from_numpy(np.random.default_rng(1).standard_normal(image.shape))
    slope = (weighted(0.0, change) - weighted(0.0, -change)) / 2.0
    # the minimum with variation is found to 1e-10 of its right side
    within = 1e-5 if variation == 0.0 else 1e-3
    assert float((image.grad * change).sum()) == pytest.approx(slope, rel=within)


def test_a_large_weight_of_the_variation_leaves_a_uniform_object():
    """It has the least residual of all uniform objects, which a tiny damping shifts by 1e-6."""
    model = SceneModel(scene_of("letter_flat"))
    image, damping = model().detach(), 1.0
    weight = 100.0 * float(image.square().sum())
    found = model.tikhonov(image, damping, (6, 6), variation=weight).detach().numpy()
    assert np.ptp(found) < 1e-3 * found.mean()
    black, grey = (
        model(torch.full((6, 6), v, dtype=torch.float64)).detach().numpy() for v in (0.0, 0.5)
    )
    light = (grey - black) / 0.5
    best = (light * (image.numpy() - black)).sum() / (light * light).sum()
    # diffuse light of the operator is that of the image to 1e-4
    assert found.mean() == pytest.approx(best, rel=1e-3)


def test_figures_have_gradients():
    scene = scene_of("letter_concave")
    model = SceneModel(scene, {"wall.radius": 5.0, "camera.stop_diameter": 0.01})

    def sizes(scene):
        return [3.0 * scene.wall.radius**2, scene.camera.stop_diameter]

    model.evaluate(sizes).sum().backward()
    assert model.offsets.grad.tolist() == pytest.approx([5.0 * 6.0 * 5.0, 0.01], rel=1e-6)


def test_refusals_name_the_remedy():
    scene = scene_of("letter_flat")
    for free, text in (
        ("wall.radius", "is no list of addresses; give"),
        (["wall.radius", "wall.radius"], "names a value twice; give"),
        (["wall.shape"], "wall.shape is 'flat' in the scene, must be a number; give"),
        (["laser.beam_diameter"], "has no effect on the image, must have one"),
    ):
        with pytest.raises(SceneError, match=text):
            SceneModel(scene, free)
    with pytest.raises(SceneError, match="is not a tensor; give"):
        SceneModel(scene)(np.ones((4, 4)))
