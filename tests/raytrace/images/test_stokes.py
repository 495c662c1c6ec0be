"""Groups, limits and refusals of polarised images, of few rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SceneError
from nlosoptics.raytrace import trace, trace_polarised
from nlosoptics.scene import Lambert, SpecularMicrofacet, SumMaterial, Ward

from ..light.draws import scene

GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.3, 0.2, index=0.4 + 2j))
CAMERA = {"pixels": (7, 5), "binning": 1, "pixel_pitch": 6e-3}
UP = (0.0, 0.0, 1.0)


def room(paint=GLOSS, material=GLOSS):
    return replace(scene(paint=paint, material=material, **CAMERA), occluders=())


@pytest.fixture(scope="module")
def seen():
    return trace_polarised(room(), laser_axis=UP, n_rays=4096, max_bounces=4, seed=2)


def error_of(groups):
    """Standard error of the mean of groups, with the factor of Student's distribution."""
    count = len(groups)
    square = ((groups - groups.mean(axis=0)) ** 2).sum(axis=0)
    return np.sqrt(square / (count * (count - 3)))


@pytest.mark.parametrize("rays", [4096, 20, 5])
def test_images_are_means_of_groups_and_errors_their_spread(rays):
    found = trace_polarised(room(), laser_axis=UP, n_rays=rays, max_bounces=4, seed=2)
    groups = min(rays, 32)
    assert found.groups.shape == (32, 2, 5, 7, 4)
    assert not found.groups[groups:].any()
    parts = ((found.stray, found.stray_error), (found.power, found.power_error))
    for k, (mean, error) in enumerate(parts):
        used = np.moveaxis(found.groups[:groups, k], -1, 1)
        assert mean.shape == error.shape == (4, 5, 7)
        np.testing.assert_allclose(mean, used.mean(axis=0), rtol=1e-12, atol=1e-20)
        np.testing.assert_allclose(error, error_of(used), rtol=1e-9, atol=1e-20)
        if rays == 4096:
            assert mean[0].sum() > 0.0
            assert (np.abs(mean[1:]).sum(axis=(1, 2)) > 0.0).all()
    assert found.paths.n_rays == rays
    assert found.pitch == 6e-3


def test_three_rays_have_no_error():
    found = trace_polarised(room(), n_rays=3, max_bounces=2)
    assert np.isinf(found.power_error).all()
    assert np.isinf(found.through(0.3)[1]).all()


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
@pytest.mark.parametrize("stray", [False, True])
def test_an_analyser_passes_half_of_the_light_and_of_what_is_along_it(seen, angle, stray):
    i, q, u, _ = seen.stray if stray else seen.power
    power, error = seen.through(angle, stray=stray)
    wanted = 0.5 * (i + q * math.cos(2 * angle) + u * math.sin(2 * angle))
    np.testing.assert_allclose(power, wanted, rtol=1e-10, atol=1e-20)
    groups = seen.groups[:, 0 if stray else 1]
    each = 0.5 * (
        groups[..., 0] + groups[..., 1] * math.cos(2 * angle) + groups[..., 2] * math.sin(2 * angle)
    )
    np.testing.assert_allclose(error, error_of(each), rtol=1e-9, atol=1e-20)


def test_total_light_is_that_of_the_unpolarised_trace():
    """Of matt surfaces, ray by ray, on a detector that holds all of it."""
    matt = room(Lambert(0.6), Lambert(0.7))
    found = trace_polarised(matt, n_rays=2048, max_bounces=4, seed=5)
    wanted = trace(matt, n_rays=2048, max_bounces=4, seed=5)
    assert found.paths.flux == approx(wanted.flux, rel=1e-12)
    assert found.power[0].sum() == approx(wanted.flux, rel=1e-9)
    assert found.stray[0].sum() == approx(wanted.stray, rel=1e-9)
    assert not found.power[1:].any()
    assert not found.stray[1:].any()


def test_arrays_are_read_only(seen):
    for name in ("power", "power_error", "stray", "stray_error", "groups"):
        assert not getattr(seen, name).flags.writeable


def test_progress_is_told_to_the_end():
    told = []
    trace_polarised(room(), n_rays=64, max_bounces=2, progress=lambda *step: told.append(step))
    assert told[-1] == ("rays", 1.0)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"paint": SumMaterial(Lambert(0.3), Ward(0.1, 0.2))}, "wall_material"),
        ({"paint": SumMaterial(Lambert(0.3), SpecularMicrofacet(0.1, 0.0))}, "wall_material"),
        ({"material": SpecularMicrofacet(0.1, 0.3)}, "hidden.material"),
    ],
)
def test_lobes_of_unknown_polarisation_are_named(changes, name):
    with pytest.raises(SceneError, match=f"{name} has a glossy lobe without a refractive index"):
        trace_polarised(room(**changes), n_rays=16)


def test_lobes_that_reflect_nothing_need_no_index():
    dark = SumMaterial(Lambert(0.3), Ward(0.0, 0.2))
    clear = SpecularMicrofacet(0.3, 0.2, index=1.5)  # and a real one suffices
    for paint in (dark, clear):
        found = trace_polarised(room(paint=paint), n_rays=1, max_bounces=1)
        assert found.power.shape == (4, 5, 7)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(("away", "refused"), [(0.9e-6, True), (1.1e-6, False)])
def test_the_field_may_lean_to_the_beam_but_not_lie_along_it(size, away, refused):
    one = room()
    beam = np.subtract(one.laser.aim, one.laser.position)
    beam = beam / np.linalg.norm(beam)
    across = np.cross(beam, UP)
    axis = tuple(size * (beam + away * across / np.linalg.norm(across)))
    if refused:
        with pytest.raises(SceneError, match=r"laser_axis = .* is parallel to the beam or zero"):
            trace_polarised(one, laser_axis=axis, n_rays=8, max_bounces=1)
    else:
        assert trace_polarised(one, laser_axis=axis, n_rays=8, max_bounces=1).paths.n_rays == 8


def test_no_field_and_no_rays_are_refused():
    with pytest.raises(SceneError, match="is parallel to the beam or zero"):
        trace_polarised(room(), laser_axis=(0.0, 0.0, 0.0), n_rays=8)
    with pytest.raises(SceneError, match="n_rays = 0"):
        trace_polarised(room(), n_rays=0)


def test_sums_of_pixels_must_fit_the_memory():
    """Eight numbers for each of 32 groups, twice, and as many as eight of the image."""
    need = 8.0 * 8 * (2 * 32 + 8) * 7 * 5
    with within(Budget(memory=need, seconds=60.0)):
        trace_polarised(room(), n_rays=8, max_bounces=1)
    with (
        within(Budget(memory=need - 1, seconds=60.0)),
        pytest.raises(MemoryLimitError, match=r"a polarised image of 7 x 5 pixels .* bin more"),
    ):
        trace_polarised(room(), n_rays=8, max_bounces=1)
