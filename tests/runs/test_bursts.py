"""Bursts: exposures of one object through several parts of one rough wall."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest import approx

import nlosoptics as nlos
from nlosoptics import psf, reconstructing
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.runs.patterns import power_errors
from nlosoptics.runs.stages import Look
from nlosoptics.scene import Burst, Scene

FILE = Path(__file__).parents[2] / "examples" / "scenes" / "letter_burst.toml"
#: One pattern holds for all of so small a letter, and few pixels are quickly read.
SMALL = {"hidden.size": "0.8 mm", "camera.pixels": [32, 32], "burst.images": 4}


@pytest.fixture(scope="module")
def result() -> nlos.Result:
    return nlos.simulate(Scene.load(FILE, SMALL), 1e-2, seed=3)


@pytest.mark.thorough
def test_each_exposure_is_the_image_from_its_place_with_its_own_noise(result) -> None:
    """The third one is that of its scene alone but for the noise, and unlike the first."""
    moved = nlos.simulate(result.scene.exposures[2], 1e-2, seed=3)
    noise = (result.burst[2] - moved.image.expected) / moved.image.noise_sigma
    assert noise.std() == approx(1.0, abs=0.1)
    assert np.std((result.burst[0] - moved.image.expected) / moved.image.noise_sigma) > 3.0
    assert np.array_equal(result.burst[0], result.image.electrons)
    own = moved.image.electrons - moved.image.expected
    assert abs(np.corrcoef(own.ravel(), (noise * moved.image.noise_sigma).ravel())[0, 1]) < 0.15


def test_a_burst_travels(result, tmp_path: Path) -> None:
    result.save(tmp_path / "burst")
    for other in (nlos.load_result(tmp_path / "burst"), pickle.loads(pickle.dumps(result))):
        assert other.scene.burst == result.scene.burst
        assert np.array_equal(other.burst, result.burst)
        assert not other.burst.flags.writeable


@pytest.mark.thorough
def test_the_same_seed_gives_the_same_bits(result) -> None:
    again = nlos.simulate(result.scene, 1e-2, seed=3)
    assert again.burst.tobytes() == result.burst.tobytes()
    assert tuple(again.timings) == tuple(stage.name for stage in again.plan.stages)


def test_the_camera_keeps_its_focus_on_the_object() -> None:
    """All exposures: one point in focus, other places, the first unmoved."""
    scene = Scene.load(FILE)
    places = np.array([one.camera.position for one in scene.exposures])
    focus = np.array(scene.camera.position) + scene.focus_distance * scene.camera.axis
    for one in scene.exposures:
        line = focus - np.array(one.camera.position)
        assert line @ one.camera.axis == approx(np.linalg.norm(line), rel=1e-12)
    assert places[0] == approx(scene.camera.position)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)[np.triu_indices(16, 1)]
    assert apart.min() == approx(scene.burst.camera_step)
    assert apart.max() < 5 * scene.burst.camera_step
    assert (places - places[0]) @ scene.camera.axis == approx(np.zeros(16), abs=1e-12)


def test_independent_patterns() -> None:
    """As many as exposures if no two parts of the wall overlap, one if all are the same."""
    burst = Burst(images=9, camera_step=2e-3)
    assert burst.independent(2e-3) == approx(9.0)
    assert burst.independent(1e3) == approx(1.0, rel=1e-4)
    # half a stop apart: the overlap of the discs is 2/pi (pi/3 - sqrt(3)/4)
    overlap = (2 / math.pi * (math.pi / 3 - math.sqrt(3) / 4)) ** 2
    far = (2 / math.pi * (math.acos(2**-0.5) - 0.5)) ** 2
    pairs = np.array([[1, overlap, overlap], [overlap, 1, far], [overlap, far, 1]])
    three = [[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]
    assert Burst(images=4, camera_step=1.0).offsets[:3].tolist() == three
    own = Burst(images=4, camera_step=1.0)
    # the fourth lies at (0, 1), opposite to the third
    total = pairs.sum() + 1 + 2 * (overlap + far)
    assert own.independent(2.0) == approx(16 / total, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"burst.images": 3}, "burst.images = 3 is out of range"),
        ({"burst.camera_step": "-1 mm"}, "burst.camera_step = -0.001 m is out of range"),
        ({"burst.camera_step": "3 mm"}, r"dependent speckle, limit 0.00347 m \(0.231 camera.stop"),
        (
            {"burst.camera_step": "5 mm", "wall.roughness.cell": "5 mm"},
            "dependent speckle, limit 0.00636 m .the correlation length",
        ),
        ({"burst.camera_step": "1.1 m"}, r"a camera that is refused .camera.position has z"),
        ({"wall.roughness.realisation": "mean"}, "the wall has no speckle to change"),
    ],
)
def test_bursts_that_do_not_help_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        assert Scene.load(FILE, changes).exposures


def test_a_burst_needs_one_pattern_over_the_object() -> None:
    with pytest.raises(SamplingError, match="holds within 4.3 mm; use a smaller hidden.size"):
        nlos.plan(Scene.load(FILE, {"hidden.size": "0.2 m", "camera.binning": 8}), 1e-2)


def test_methods_refuse_images_that_they_cannot_use(result, tmp_path: Path) -> None:
    files = [tmp_path / f"{k}.npy" for k in range(2)]
    for file, image in zip(files, result.burst, strict=False):
        np.save(file, image)
    smooth = replace(result.scene, wall_roughness=None, burst=None)
    for scene, method, words in (
        (result.scene, "tv", "2 exposures of a burst show different speckle"),
        (smooth, "burst", r"add \[wall.roughness\]"),
    ):
        with pytest.raises(SceneError, match=words):
            reconstructing.prepared(scene, files, method=method)


@pytest.mark.thorough
def test_patterns_are_as_similar_as_the_parts_of_the_wall_overlap() -> None:
    """Correlation against the overlap of the shifted stop, over 6 walls and two directions.

    Pixels are half a speckle wide, which raises the correlation by at most 0.05.
    """
    scene = Scene.load(FILE)
    stop, side = scene.camera.stop_diameter, 127
    smooth = psf.mean_point_spread(
        scene,
        scene.wall_roughness.heights,
        pitch=scene.camera.image_pitch,
        shape=side,
        pixel_integrated=True,
    ).intensity
    correlations: dict[float, list[float]] = {}
    for seed in range(6):
        rough = replace(scene.wall_roughness.heights, seed=seed)
        wall = replace(scene, wall_roughness=replace(scene.wall_roughness, heights=rough))
        for step in (5e-3, 10e-3):
            seen = replace(wall, burst=Burst(images=4, camera_step=step)).exposures[:3]
            first, *others = (
                psf.scene_point_spread(one, 1e-2, shape=side).point_spread.intensity / smooth
                for one in seen
            )
            for other in others:
                value = np.corrcoef(first.ravel(), other.ravel())[0, 1]
                correlations.setdefault(step, []).append(value)
    for step, values in correlations.items():
        t = step / stop
        expected = (2 / math.pi * (math.acos(t) - t * math.sqrt(1 - t * t))) ** 2
        assert -0.03 < np.mean(values) - expected < 0.06


@pytest.mark.thorough
def test_the_mean_power_is_the_predicted_one() -> None:
    """<|Y|^2> = |O|^2 T + N, and the power of an exposure varies by its mean.

    The formula takes the envelope of facets for a Gaussian one, and all light as within the frame.
    """
    scene = Scene.load(FILE, {"hidden.size": "0.9 mm"})
    found = nlos.simulate(scene, 1e-2, seed=5)
    look = Look.at(psf.SceneOptics(scene), 1e-2)
    power, error, _ = power_errors(scene, look)
    spectra = np.abs(np.fft.fft2(found.burst - found.image.background)) ** 2
    noise = float(found.image.ideal.sum() + found.burst[0].size * scene.camera.read_noise**2)
    predicted = noise * error / (error - 1.0)
    frequency = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n) for n in power.shape), indexing="ij"))
    for low, high in ((0.05, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.4)):
        ring = (low < frequency) & (frequency < high)
        assert spectra.mean(axis=0)[ring].sum() == approx(predicted[ring].sum(), rel=0.3)
        scatter = spectra.std(axis=0)[ring] / spectra.mean(axis=0)[ring]
        assert scatter.mean() == approx(1.0, abs=0.15)


@pytest.mark.thorough
def test_the_letter_is_found() -> None:
    """The scene of the examples, by the run with its reconstruction."""
    found = nlos.simulate(Scene.load(FILE), 4e-3, seed=1, reconstruct=True)
    from nlosoptics.inverse import registered_correlation

    assert registered_correlation(found.reconstruction, found.image.ideal) > 0.93
