"""Node counts, costs, bounds and choices of generic waves, on record, and against closed forms."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.pupil import paraxial
from nlosoptics.psf.rough import aberration, relief_rays, sample
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.psf.transform import costs, geometric, huygens, runners, selection, wide_pixels
from nlosoptics.psf.walls import rough_wall, scene_costs
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.regime import regime
from nlosoptics.psf.window import antialiased_disc, grids, rim_tails, window
from nlosoptics.psf.window.pixels import pixel_rule
from nlosoptics.scene import ConcaveWall, FacetWall, FlatWall, GaussianWall, WallRoughness

from ..records import attempt

SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
UNIT = 6e-7 * 7.5  # lambda N, m
LAYOUTS = ("polar", "ring", "cells", "grid", "dots")


def wave(layout="polar", scale=1.0, samples=None):
    """A tilted wave of defocus, astigmatism and coma, all but the tilt times ``scale``."""
    terms = {2: 3e-7, 3: -2e-7} | {n: scale * a for n, a in ((4, 6e-8), (5, 4e-8), (8, 3e-8))}
    if layout == "dots":
        return dots(terms)
    own = {"aperture": psf.Aperture.hexagons(1, 2e-3, 1e-4)} if layout == "cells" else {}
    own |= {"obscuration": 0.3} if layout == "ring" else {}
    nodes = "polar" if layout == "ring" else layout
    samples = 96 if layout == "grid" and samples is None else samples
    return psf.Wavefront.from_zernike(terms, nodes=nodes, samples=samples, **own, **SYSTEM)


def dots(terms, count=500):
    turn, r = 2.399963 * np.arange(count), np.sqrt((np.arange(count) + 0.5) / count)
    path = sum(a * psf.zernike(n, r, turn) for n, a in terms.items())
    u, v, ones = 4e-3 * r * np.cos(turn), 4e-3 * r * np.sin(turn), np.ones(count)
    given = {"aberration": path, "amplitude": ones, "weights": 5e-5 / count * ones}
    return psf.Wavefront(layout="scattered", u=u, v=v, **SYSTEM | given)


def task_of(front, pitch, shape, tol=1e-3, pixels=True):
    residual = split(front)
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape)) if pixels else None
    return runners.Task(residual, tol, pitch, shape, rule)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_transforms_considered(layout, on_record):
    """From few waves on fine samples to many waves on wide pixels, at several tolerances."""
    found = []
    for scale, share, pixels, tol in itertools.product(
        (1e-3, 1.0, 60.0), (0.3, 4.0), (False, True), (3e-2, 1e-6)
    ):
        front = wave(layout, scale) if layout != "grid" or scale < 9 else wave(layout, scale, 400)
        task = task_of(front, share * UNIT, (30, 41), tol, pixels)
        found.append(attempt(selection.candidates, task, regime(task.residual, task.pitch)))
        found.append(attempt(scene_costs.smooth_cost, task.residual, task.pitch, (30, 41), tol))
    on_record(found)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_and_windows(layout, on_record):
    found = []
    for scale in (1.0, 30.0):
        residual = split(wave(layout, scale))
        for pitch in (0.2 * UNIT, 3 * UNIT, 40 * UNIT):
            seen = window.Window.centred(pitch, (11, 20))
            found.append([costs.rays(residual, seen), geometric.least_error(residual, pitch)])
            found.append([window.peak_pixel(residual, pitch), window.ray_reach(residual)])
            found.append(attempt(window.window_side, residual, pitch, 1e-2))
            found.append(attempt(wide_pixels.inner_parts, residual, pitch, (90, 100), 1e-2))
            asked = {"pitch": pitch, "shape": (11, 20), "tol": 0.5, "method": "geometric"}
            spread = attempt(psf.point_spread, wave(layout, scale), pixel_integrated=True, **asked)
            found.append(spread if scale > 1 and pitch > 2 * UNIT else None)
    on_record(found)


@pytest.mark.parametrize("layout", ["polar", "ring"])
def test_grids_of_polar_waves(layout, on_record):
    """Transform sizes by the window, the rays, or the samples across the pupil."""
    found = []
    for scale, shape in ((1.0, (9, 14)), (1.0, (900, 30)), (80.0, (9, 14))):
        task = task_of(wave(layout, scale), 0.4 * UNIT, shape, pixels=False)
        size = runners.polar_size(task)
        found.append([size, runners.grid_period_pitch(task, size)])
    task = task_of(wave(layout), 0.4 * UNIT, (9, 14))
    grid = grids.pupil_grid_from_polar(task.residual, 8e-3 / 61)
    on_record([found, grid])
    assert np.abs(grid.values.sum()) <= 1


def test_samples_that_are_too_few(on_record):
    """Each refusal names how many samples suffice."""
    found = []
    for layout, scale, pixels in itertools.product(("grid", "dots"), (1.0, 40.0), (False, True)):
        for side in (9, 900):
            task = task_of(wave(layout, scale, 40), UNIT / 3, (side, 7), pixels=pixels)
            found.append(attempt(runners.check_sampling, task))
    many = psf.Wavefront.from_zernike({40: 2e-5}, nodes="polar", samples=(12, 64), **SYSTEM)
    asked = {"pitch": UNIT, "shape": (900, 900), "pixel_integrated": True}
    found.append(attempt(psf.point_spread, many, method="mdft", **asked))
    on_record(found)


@pytest.mark.parametrize("tol", [0.3, 1e-2, 1e-5])
@pytest.mark.parametrize("scale", [1.0, 25.0, 400.0])
def test_cells_of_a_cut_cone(scale, tol, on_record):
    """Cells across the grid by the jump between cells, the period or the rim, or too many."""
    residual = split(wave("grid", scale, 64))
    on_record([attempt(scene_costs.grid_samples, residual, UNIT * n, 40, tol) for n in (0.3, 9)])


def test_steps_toward_points(on_record):
    residual = split(wave("grid", 2.0, 200))
    points = np.array([[0.0, 0.0, 0.06], [2e-5, -4e-5, 0.0601], [-3e-4, 1e-4, 0.0598]])
    found = [attempt(huygens.surface_field, split(wave(one)), points) for one in LAYOUTS]
    slopes = [huygens.steepness(residual, points[:n]) for n in (1, 2, 3)]
    on_record([found, slopes, attempt(huygens.surface_field, residual, points, "plane")])


def test_soft_disc_is_a_convolved_disc():
    """The energy of the profile is the disc's area, for one block of radii or several."""
    few = antialiased_disc.SoftDisc(6.3)
    r = np.linspace(0.0, few.high + 1, 40001)
    assert np.trapezoid(2 * math.pi * r * few(r), r) == approx(math.pi * 6.3**2, rel=1e-6)
    radii, many = np.linspace(0.0, 9.0, 7), np.linspace(0.0, 9.0, 3001)
    found = antialiased_disc._hankel(np.append(radii, many), 6.3)
    assert found[:7] == approx(antialiased_disc._hankel(radii, 6.3), abs=1e-13)
    assert found[:7] == approx(few(radii), abs=1e-12)


@pytest.mark.parametrize("count", [1, 3, 5, 8])
@pytest.mark.parametrize("parts", [1, 3, 5])
def test_fine_samples_summed_over_pixels(count, parts):
    """The middle sample lies in the middle pixel; samples outside the shape are dropped."""
    n, shape = 11, (count, 6)
    fine = np.random.default_rng(count).random((n, n))
    known = np.zeros(shape)
    for (i, j), value in np.ndenumerate(fine):
        row, column = (
            (k - n // 2 + parts // 2) // parts + size // 2
            for k, size in zip((i, j), shape, strict=True)
        )
        if 0 <= row < shape[0] and 0 <= column < shape[1]:
            known[row, column] += value
    assert wide_pixels.binned(fine, parts, shape) == approx(known, abs=1e-12)


def test_spikes_and_arcs(on_record):
    """A disc's bound is its perimeter's arcs at high frequencies, and their lengths at low ones."""
    disc, f = psf.Aperture.round(2e-3), np.array([0.0, 10.0, 4e4, 4e5])
    found = rim_tails.tail(disc, f, 0 * f)
    arcs = len(disc.rims.turn)
    high = arcs * rim_tails.ARC * np.sqrt(2e-3 / f[2:]) / (2 * math.pi * f[2:] * disc.area)
    assert found[2:] == approx(high, rel=1e-9)
    true = 2 * np.sqrt(2 / math.pi / (2 * math.pi * 2e-3 * f[2:]) ** 3)
    assert np.all(found[2:] >= true)  # the envelope of the Airy pattern's field
    assert np.all(found[2:] <= 3 * true)
    assert found[:2] == approx([1.0, 1.0])
    shapes = [psf.Aperture.regular(5, 1e-3, angle=0.2), psf.Aperture.hexagons(1, 1e-3, 1e-4)]
    shapes.append(psf.Aperture.round(2e-3, 0.3, vanes=3, vane_width=2e-4))
    places = np.linspace(-3e3, 9e4, 7)
    on_record(
        [
            [
                rim_tails.tail(one, places, 0.4 * places + 50),
                [rim_tails.reach(one, 3.6e-8, p, 1e-4) for p in (1e-6, 1e-4)],
                rim_tails.edge_ratio(wave(), one),
            ]
            for one in shapes
        ]
    )


RELIEFS = {"facets": FacetWall(1e-3, 2e-3, seed=3), "bumps": GaussianWall(2e-7, 1e-3, seed=3)}
SEEN = {
    "footprint": np.array([[0.5, 0.05], [0.02, 0.6]]),
    "cos_sum": 1.8,
    "effective_distance": np.array([[0.4, 0.03], [0.03, 0.5]]),
}


@pytest.fixture(params=RELIEFS)
def relief(request):
    return lambda front: rough_source(front, RELIEFS[request.param], *SEEN.values(), pattern=True)


@pytest.mark.parametrize("layout", ["polar", "ring"])
def test_rays_from_a_relief(relief, layout, monkeypatch, on_record):
    """All light of an even lens arrives within the pixels, about the tilt's image point."""
    monkeypatch.setattr(relief_rays, "RAYS", 2**14)
    source = relief(wave(layout, 9.0))
    residual, view = source.residual, source.view
    wide = window.Window.centred(2e-4, (24, 30))
    energy, error = relief_rays.ray_image(residual, view, wide)
    assert energy.sum() == approx(1.0, abs=0.2)  # the facets that are seen are few
    narrow = window.Window.centred(3e-5, (5, 8))
    on_record(
        [
            energy,
            error,
            relief_rays.ray_image(residual, view, narrow),
            [relief_rays.ray_counts(view, r, 6e-7) for r in (1e-4, 4e-3, 0.1)],
            [relief_rays.neglected_diffraction(view, residual.wavefront, p) for p in (1e-6, 1e-3)],
            aberration.aberration_error(view, 6e-7),
        ],
        1e-4,
    )


def test_most_rays_of_a_steep_relief(relief):
    """Few rays of a steep relief reach a small pupil, and no more than a limit are started."""
    view = relief(wave()).view
    n, half = relief_rays.ray_counts(view, 1e-5, 6e-7)
    assert n == 2**12
    assert n == math.isqrt(relief_rays.MOST_RAYS)
    assert np.all(half > np.linalg.norm(view.footprint, axis=1) * 1e-5)
    smooth = replace(view, rayleigh_parameter=0.0)
    assert aberration.aberration_error(smooth, 6e-7) == 0
    n, half = relief_rays.ray_counts(smooth, 4e-3, 6e-7)
    assert half == approx(np.linalg.norm(view.footprint, axis=1) * 4e-3, rel=1e-12)
    assert n == math.isqrt(relief_rays.RAYS)


def test_patterns_are_averaged():
    """Two patterns are the mean of the first and of another that is drawn after it."""
    asked = {"footprint": 0.5, "cos_sum": 1.8, "effective_distance": 0.4, "seed": 5}
    front, rough = wave("grid", 1.0, 128), psf.Roughness(1e-7, 2e-3)
    one, two, three = (
        psf.sample_point_spread(
            front, rough, **asked, independent_patterns=n, pitch=2e-6, shape=(28, 29)
        ).intensity
        for n in (1, 2, 3)
    )
    second, third = 2 * two - one, 3 * three - 2 * two
    assert min(second.min(), third.min()) >= -1e-12
    assert np.abs(second - one).max() > 0.1 * one.max()
    assert np.abs(third - second).max() > 0.1 * one.max()
    assert second.sum() == approx(one.sum(), rel=0.5)


def test_pitches_of_speckle():
    """A lattice divides the finest pitch, and a smooth wall needs none."""
    front = wave()
    widest = 8e-3 / 256
    assert sample.grid_pitch(front, math.inf, 1e-6) == approx(widest)
    assert sample.grid_pitch(front, math.inf, 1e-3) == approx(6e-7 * 0.06 / 3e-3)
    assert sample.grid_pitch(front, 5e-5, 1e-6) == approx(2.5e-5)
    assert sample.grid_pitch(front, 3e-5, 1e-6) == approx(3e-5)
    assert sample.grid_pitch(front, 3e-5, 1e-3) == approx(1e-5)


def test_change_over_a_picture(flat_scene, on_record):
    """By phase, by the tail within a pixel, or by moved energy, whichever bounds it best."""
    near = replace(flat_scene, camera=replace(flat_scene.camera, focus_distance=1.3))
    pupil, found = psf.SceneOptics(near).exit_pupil, []
    for wall, size in itertools.product((FlatWall(), ConcaveWall(30.0, size=3.0)), (0.01, 0.3)):
        hidden = replace(flat_scene.hidden, size=(size, 0.5 * size))
        scene = replace(near, wall=wall, hidden=hidden)
        for share in (0.02, 0.3, 4.0, 60.0):
            seen = replace(pupil, radius=share * pupil.radius)
            found.append(paraxial.change_over_object(scene, seen))
    on_record(found)


@pytest.mark.parametrize("size", [None, 0.02], ids=["whole", "cut"])
def test_cost_of_a_mean_over_walls(flat_scene, size, on_record):
    """The mean itself is costed by its parts; a wall that cuts the cone gives a grid of nodes."""
    rough = WallRoughness(GaussianWall(5e-8, 2e-3), "mean")
    scene = replace(flat_scene, wall=FlatWall(size=size), wall_roughness=rough)
    if size:
        middle = replace(scene.hidden, position=(0.6, 0.0, 0.8))
        camera = replace(scene.camera, aim=(0.0, 0.0, 0.0))
        scene = replace(scene, hidden=middle, camera=camera)
    seen = psf.SceneOptics(scene).at()
    pitch = scene.camera.image_pitch
    choice = rough_wall.rough_choice(seen, pitch, (20, 24), 1e-3)
    assert (choice.regime, choice.seconds, choice.n_bytes) == ("mean", 0.0, 0.0)
    assert choice.error == 1e-3
    on_record(
        [
            attempt(scene_costs.point_cost, seen, share * pitch, (20, 24), tol, cells)
            for share, tol, cells in itertools.product((0.1, 1.0), (1e-2, 1e-5), (0, 300))
        ]
    )


def test_largest_windows():
    """A side is below 2^31, since transforms count samples by 32 bits."""
    assert window.shape_of(2**31 - 1) == (2**31 - 1, 2**31 - 1)
    assert window.shape_of((1, 2**31 - 1)) == (1, 2**31 - 1)
    for shape in (2**31, (2**31, 1), (1, 0)):
        with pytest.raises(SceneError, match="shape"):
            window.shape_of(shape)


def test_nodes_of_as_many_patches_as_there_are():
    front = wave("cells")
    n = len(front.u)
    assert front.nodes(n, 3, 4)[0].shape == (n, 3, 4)
    for other in (n - 1, n + 1):
        with pytest.raises(SceneError, match="number of patches"):
            front.nodes(other, 3, 4)
