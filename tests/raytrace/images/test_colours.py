"""Light of several wavelengths: by the same rays, with albedos that depend on the wavelength."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.raytrace import trace, trace_image
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    PlanarObject,
    Scene,
    Spectrum,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)

pytestmark = pytest.mark.thorough  # they compile kernels that few scenes need


BLUE, GREEN, RED = 450e-9, 550e-9, 650e-9
PAINT, SKIN = Spectrum((BLUE, RED), (0.2, 0.6)), Spectrum((BLUE, GREEN, RED), (0.1, 0.3, 0.8))
PAINTED = SumMaterial(Lambert(PAINT), SpecularMicrofacet(0.1, 0.08))


def room(**changes):
    scene = Scene(
        Laser(wavelength=GREEN, power=2.0, beam_diameter=0.02, position=(-0.1, 0.5, 0.9)),
        FlatWall(size=(1.6, 1.2)),
        PlanarObject(np.eye(3), 0.5, position=(0.35, 0.0, 0.6), material=Lambert(SKIN)),
        Camera(
            position=(-0.3, 0.1, 1.0),
            aim=(0.0, -0.1, 0.0),
            focal_length=0.1,
            stop_diameter=0.1,
            pixel_pitch=1e-3,
            pixels=(16, 16),
            binning=1,
            focus_distance=1.5,
        ),
        wall_material=Lambert(PAINT),
    )
    return replace(scene, **changes)


def plain(scene, wavelength):
    """Return the scene with numbers as albedos, those at a wavelength."""
    at = {BLUE: (0.2, 0.1), GREEN: (0.4, 0.3), RED: (0.6, 0.8)}[wavelength]
    wall = Lambert(at[0])
    if isinstance(scene.wall_material, SumMaterial):
        wall = SumMaterial(wall, SpecularMicrofacet(0.1, 0.08))
    hidden = replace(scene.hidden, material=Lambert(at[1]))
    laser = replace(scene.laser, wavelength=wavelength)
    return replace(scene, laser=laser, hidden=hidden, wall_material=wall)


def test_a_scene_has_the_albedos_at_its_wavelength():
    scene = room()
    assert scene.wall_material.rho == approx(0.4, rel=1e-15)
    assert scene.hidden.material.rho == 0.3
    red = replace(scene, laser=replace(scene.laser, wavelength=RED))
    assert (red.wall_material.rho, red.hidden.material.rho) == (0.6, 0.8)
    assert red.is_coloured
    assert not plain(red, RED).is_coloured


def test_three_matt_reflections_have_the_ratio_of_the_albedos():
    """Wall twice and object once: the power is proportional to rho_w^2 rho_h."""
    options = {"n_rays": 2000, "max_bounces": 3, "seed": 4}
    blue, *others = trace_image(room(), wavelengths=(BLUE, GREEN, RED), **options).colours
    for image, expected in zip(others, (4 * 3, 9 * 8), strict=True):
        ratio, error = image.ratio(blue)
        # rounding of sums of some 2000 terms
        assert ratio == approx(expected, rel=1e-12)
        assert error < 1e-12 * expected
        power = image.paths.by_bounce[3] / blue.paths.by_bounce[3]
        assert power == approx(expected, rel=1e-12)


def test_each_image_has_the_bits_of_its_own_trace():
    scene = room(wall_material=PAINTED)
    found = trace_image(scene, wavelengths=(BLUE, RED), n_rays=1000, seed=2)
    red = replace(scene, laser=replace(scene.laser, wavelength=RED))
    alone = trace_image(red, n_rays=1000, seed=2)
    assert np.array_equal(found.colours[1].power, alone.power)
    assert np.array_equal(found.colours[1].expected, alone.expected)
    assert np.array_equal(found.power, found.colours[0].power)


@pytest.mark.thorough
@pytest.mark.parametrize("wavelength", [BLUE, RED])
@pytest.mark.parametrize("analog", [False, True])
def test_choice_of_lobes_changes_no_result(wavelength, analog):
    """Samples choose lobes by the mean over wavelengths, and without colour by their albedo."""
    scene = room(wall_material=PAINTED)
    scene = replace(scene, laser=replace(scene.laser, wavelength=wavelength))
    options = {"n_rays": 1 << 20 if analog else 1 << 15, "analog": analog, "max_bounces": 4}
    mine = trace(scene, seed=5, **options)
    other = trace(plain(scene, wavelength), seed=6, **options)
    for name, error in (("flux", "standard_error"), ("stray", "stray_error")):
        spread = np.hypot(getattr(mine, error), getattr(other, error))
        # four standard errors of independent seeds
        assert abs(getattr(mine, name) - getattr(other, name)) < 4 * spread
        assert getattr(mine, name) > 0.0


def test_ratios_of_glossy_walls_have_smaller_errors_than_powers():
    scene = room(wall_material=PAINTED)
    options = {"wavelengths": (BLUE, RED), "max_bounces": 3}
    blue, red = trace_image(scene, n_rays=4096, seed=1, **options).colours
    ratio, error = red.ratio(blue)
    apart = np.hypot(*(one.paths.standard_error / one.paths.flux for one in (blue, red)))
    assert error / ratio < 0.6 * apart
    blue, red = trace_image(scene, n_rays=1 << 16, seed=2, **options).colours
    exact, rest = red.ratio(blue)
    assert abs(ratio - exact) < 4 * np.hypot(error, rest)


def test_rays_take_the_same_paths_at_all_wavelengths():
    """Also on a wall with two lobes, whose shares depend on the wavelength."""
    scene = room(wall_material=PAINTED)
    found = []
    for wavelength in (BLUE, RED):
        one = replace(scene, laser=replace(scene.laser, wavelength=wavelength))
        found.append(trace(one, n_rays=1000, max_bounces=4, keep_paths=True, seed=8))
    assert len(found[0].points) > 1000
    assert np.array_equal(found[0].points, found[1].points, equal_nan=True)
    assert (found[0].weight < found[1].weight).all()


def test_a_file_restores_the_table(tmp_path):
    wall = SumMaterial(Lambert(PAINT), SpecularMicrofacet(SKIN, 0.02), Ward(0.1, 0.3))
    scene = room(wall_material=Lambert(0.1))
    scene = replace(scene, wall_material=replace_parts(wall))
    scene.save(tmp_path / "room.toml")
    assert Scene.load(tmp_path / "room.toml") == scene
    red = Scene.load(tmp_path / "room.toml", {"laser.wavelength": "650 nm"})
    assert red.hidden.material.rho == 0.8
    table = {"wavelengths": ["0.6 um", "0.7 um"], "values": [0.5, 0.7]}
    other = {"hidden.material": {"lobe": "lambert", "albedo": table}}
    loaded = Scene.load(tmp_path / "room.toml", {"laser.wavelength": "650 nm", **other})
    assert loaded.hidden.material.rho == approx(0.6, rel=1e-12)
    with pytest.raises(SceneError, match=r"hidden\.material.*albedo at the wavelength 550 nm"):
        Scene.load(tmp_path / "room.toml", other)
    table["values"] = [0.5, 1.7]
    with pytest.raises(SceneError, match=r"hidden\.material\.albedo\.values\[1\] = 1\.7"):
        Scene.load(tmp_path / "room.toml", other)


def replace_parts(wall):
    """Return a sum whose albedos add up to less than 1 at all wavelengths."""
    return SumMaterial(*wall.parts[:1], SpecularMicrofacet(0.1, 0.02), wall.parts[2])


def test_what_cannot_be_evaluated_is_refused():
    with pytest.raises(SceneError, match=r"wavelengths\[1\]: .*700 nm is unknown, .*450 to 650 nm"):
        trace_image(room(), wavelengths=(BLUE, 700e-9), n_rays=100)
    with pytest.raises(SceneError, match="wavelengths is 5e-07; give a list"):
        trace_image(room(), wavelengths=500e-9)
    blue, red = trace_image(room(), wavelengths=(BLUE, RED), n_rays=64, max_bounces=2).colours
    with pytest.raises(SceneError, match="a ratio needs light of the object"):
        red.ratio(blue)
    with pytest.raises(SceneError, match="limit 1"):
        room(
            wall_material=SumMaterial(Lambert(SKIN), Lambert(Spectrum((BLUE, RED), (0.2, 0.9)))),
            laser=replace(room().laser, wavelength=RED),
        )
