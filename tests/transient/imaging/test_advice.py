"""Images with all settings from the capture: gate, background, wavelength, planes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics import transient
from nlosoptics.errors import SamplingError
from nlosoptics.scene import Lambert

WALL = transient.wall_grid(1.0, 32)
PLACE = (0.15, -0.2, 0.62)


def capture(photons=30.0, direct=0.0, dark=0.0, pairing="confocal", seed=0):
    """Echoes of a disc of 15 cm, direct light that decays over 10 cm, and dark counts."""
    rng = np.random.default_rng(seed)
    lasers = WALL if pairing == "confocal" else np.zeros(3)
    times = 0.012 * (np.arange(200) + 0.5)[:, None, None]
    light = np.zeros((200, 32, 32))
    for x, y in rng.uniform(-0.075, 0.075, (40, 2)):
        point = np.add(PLACE, (x, y, 0.0))
        path = np.linalg.norm(WALL - point, axis=-1) + np.linalg.norm(lasers - point, axis=-1)
        light += np.exp(-(((times - path) / 0.015) ** 2)) / path**4
    light *= photons / light.max()
    apart = 0.0 if pairing == "confocal" else np.linalg.norm(WALL, axis=-1)
    light += direct * np.exp(-(times - apart) / 0.1) * (times > apart) + dark
    return transient.TransientCapture(
        H=rng.poisson(light).astype(float),
        laser_points=lasers,
        sensor_points=WALL,
        delta_t=0.012,
        pairing=pairing,
    )


@pytest.mark.parametrize("pairing", ["confocal", "all"])
def test_an_object_is_found_behind_direct_light(pairing):
    """Weak light far below the laser's own is gated, imaged and placed within a pitch."""
    advice = transient.advise(capture(direct=1e3, dark=0.5, pairing=pairing))
    assert advice.status == "converged"
    facts = advice.light.details["hidden_light"]
    assert facts["background"] == pytest.approx(0.5, rel=0.1)
    assert 0.5 < facts["start"] < 1.25
    seen = np.isfinite(advice.depths.depth)
    x, y = np.meshgrid(advice.depths.x, advice.depths.y)
    place = [float(np.mean(values[seen])) for values in (x, y, advice.depths.depth)]
    assert place == pytest.approx(PLACE, abs=0.03)
    confidence = advice.depths.confidence
    assert np.mean(confidence[seen]) > 0.9 > np.mean(confidence[~seen]) + 0.2


@pytest.mark.parametrize("pairing", ["confocal", "all"])
def test_hot_and_dead_pixels_show_nothing(pairing):
    """Each pair has a background of its own, 1000 times that of others or none."""
    shot = capture(dark=1.0, pairing=pairing)
    pixels = np.random.default_rng(1).permutation(1024)
    H = shot.H.reshape(200, 1024).copy()
    H[:, pixels[:10]] += np.random.default_rng(2).poisson(1000.0, (200, 10))
    H[:, pixels[10:40]] = 0.0
    advice = transient.advise(replace(shot, H=H.reshape(shot.H.shape)))
    seen = np.isfinite(advice.depths.depth)
    x, y = np.meshgrid(advice.depths.x, advice.depths.y)
    place = [float(np.mean(values[seen])) for values in (x, y, advice.depths.depth)]
    assert place == pytest.approx(PLACE, abs=0.03)


def test_fewer_photons_take_a_longer_wave():
    waves = [transient.advise(capture(n, dark=0.2 * n)).image.wl_mean for n in (100, 1)]
    assert waves[0] < waves[1]


@pytest.mark.parametrize("seed", range(10))
def test_empty_rooms_show_nothing(seed):
    """Neither dark counts nor the end of the direct light is an object."""
    advice = transient.advise(capture(0.0, direct=1e4 * (seed % 2), dark=0.1 * 4**seed, seed=seed))
    assert advice.status == "no object above the noise"


def test_light_keeps_its_sum():
    """The subtracted background leaves the object's own photons, to their noise."""
    expected = capture(30.0).H.sum()
    light = transient.hidden_light(capture(30.0, dark=2.0)).H.sum()
    assert light == pytest.approx(expected, abs=5.0 * (expected + 2.0 * 200 * 1024) ** 0.5)


@pytest.mark.parametrize("seed", range(5))
def test_few_pairs_at_the_begin_of_a_window_do_not_decide(seed):
    """Beyond the straight path, the first bins are those of the farthest points alone."""
    sensors = np.linspace((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), 400)
    beyond = 2.1 + 0.01 * np.arange(300)[:, None] - sensors[:, 0]
    mean = 10.0 + 3.0 * ((beyond > 0.9) & (beyond < 1.2))
    shot = transient.TransientCapture(
        H=np.random.default_rng(seed).poisson(mean).astype(float),
        laser_points=np.zeros(3),
        sensor_points=sensors,
        delta_t=0.01,
        t_start=2.1,
    )
    facts = transient.hidden_light(shot).details["hidden_light"]
    assert facts["start"] < 0.9
    assert facts["stop"] == pytest.approx(1.2, abs=0.03)
    # 5 standard deviations of the mean of 100 bins of 200 points
    assert facts["background"] == pytest.approx(10.0, abs=0.1)


def test_dark_captures_are_refused():
    with pytest.raises(SamplingError, match="no light of 5 standard deviations above"):
        transient.hidden_light(capture(0.0, dark=1.0))


def test_a_line_of_points_is_imaged_as_the_error_says():
    """The section of the disc above the row of points next to its centre."""
    shot = capture()
    row = replace(shot, H=shot.H[:, 9], laser_points=WALL[9], sensor_points=WALL[9])
    with pytest.raises(SamplingError, match=r"no grid .*line of n points as \(1, n, 3\)"):
        transient.advise(row)
    points = WALL[9][None]
    row = replace(row, H=row.H[:, None], laser_points=points, sensor_points=points)
    depths = transient.advise(row).depths
    seen = np.isfinite(depths.depth)
    assert np.mean(depths.x[seen[0]]) == pytest.approx(PLACE[0], abs=0.03)
    assert np.mean(depths.depth[seen]) == pytest.approx(PLACE[2], abs=0.03)


def covered(boxes, count, photons, seeds):
    """Which 95 % intervals of depth hold the truth: matt boxes (x, y, width, height) at 0.7 m."""
    bars = [
        trimesh.creation.box((width, height, 1e-3)).apply_translation((x, y, 0.7))
        for x, y, width, height in boxes
    ]
    grid = transient.wall_grid(1.0, count)
    scan = transient.Scan(
        laser_points=grid,
        sensor_points=grid,
        pairing="confocal",
        t_start=1.3,
        delta_t=0.01,
        n_bins=200,
    )
    light = transient.render([(bar, Lambert(0.8)) for bar in bars], scan, max_bounces=3, tol=2e-2)
    hits = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        H = rng.poisson(photons * (light.H / light.H.max() + 0.2)).astype(float)
        advice = transient.advise(replace(light, H=H, by_bounce={}, standard_error=None))
        off = advice.depths.depth - transient.true_depths(bars, advice.image.volume)
        seen = np.isfinite(off)
        assert seen.sum() > 0.01 * seen.size
        hits.append(np.abs(off[seen]) < 1.96 * advice.depths.standard_error[seen])
    return np.concatenate(hits)


LETTERS = {
    "L": [(-0.15, 0.0, 0.1, 0.4), (0.05, -0.15, 0.3, 0.1)],
    "T": [(0.0, 0.15, 0.4, 0.08), (0.0, -0.05, 0.08, 0.32)],
    "H": [(-0.16, 0.0, 0.08, 0.42), (0.16, 0.0, 0.08, 0.42), (0.0, 0.0, 0.24, 0.08)],
}


def test_depths_lie_within_their_error_bars():
    """95 % intervals hold 92 to 98 % of the depths, at 10 and 3 photons in the peak bin."""
    hits = [covered(LETTERS["L"], 32, photons, 4) for photons in (10.0, 3.0)]
    assert 0.92 < np.mean(np.concatenate(hits)) < 0.98


@pytest.mark.thorough
@pytest.mark.parametrize(("photons", "most"), [(100.0, 1.0), (10.0, 0.98), (3.0, 0.98)])
def test_error_bars_hold_for_fine_grids(photons, most):
    """With many photons the allowance for wide surfaces decides, which straight bars need less."""
    hits = [covered(LETTERS[name], 64, photons, 4) for name in "TH"]
    assert 0.92 < np.mean(np.concatenate(hits)) <= most
