"""The trained network: its pairs, its training, its file, and the command that makes it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import torch

import nlosoptics
from nlosoptics import cli, inverse, psf
from nlosoptics.errors import NlosError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.published.training_pairs import _picture
from nlosoptics.scene import ConcaveWall, Lambert, Ward

SIDE = 16


@pytest.fixture(scope="module")
def scene(examples):
    return nlosoptics.Scene.load(examples / "scenes" / "letter_speckle.toml")


@pytest.fixture(scope="module")
def pairs(scene):
    return inverse.training_pairs(scene, 24, size=SIDE, waves=0.3)


@pytest.fixture(scope="module")
def training(pairs):
    return inverse.train_cnn(pairs, base=8, depth=2, epochs=4, batch=4, validation=0.25)


def test_pairs_are_decided_by_their_seed(scene, pairs):
    fewer = inverse.training_pairs(scene, 3, size=SIDE, waves=0.3)
    assert fewer.images.tobytes() == pairs.images[:3].tobytes()
    assert fewer.objects.tobytes() == pairs.objects[:3].tobytes()
    other = inverse.training_pairs(scene, 3, size=SIDE, waves=0.3, seed=1)
    assert not np.array_equal(other.images, fewer.images)
    assert not np.array_equal(fewer.images[0], fewer.images[1])


def test_pairs_are_exposures_of_their_objects(scene):
    """A strong wall blurs its picture more than a weak one; the pictures are the same."""
    weak, strong = (
        inverse.training_pairs(scene, 4, size=SIDE, waves=waves) for waves in (0.01, 1.0)
    )
    np.testing.assert_array_equal(weak.objects, strong.objects)
    assert weak.objects.max(axis=(1, 2)).tolist() == [1.0] * 4
    for picture, sharp, blurred in zip(weak.objects, weak.images, strong.images, strict=True):
        alike = inverse.registered_correlation(sharp, picture)
        # diffraction at two pixels, and noise of a few per cent
        assert alike > 0.8
        assert alike > inverse.registered_correlation(blurred, picture)


def test_each_pair_is_one_wave_and_one_picture(scene, monkeypatch):
    """Of a picture that is not square; one that the camera does not see is drawn again."""
    binning, sides, dark = scene.camera.binning, scene.hidden.size, {5}
    wide = replace(scene, camera=replace(scene.camera, pixels=(14 * binning, 11 * binning)))
    waves, pictures, told, seeds = [], [], [], set()

    def spread(wave, **options):
        waves.append(wave)
        enough = psf.window_shape(wave, pitch=wide.camera.image_pitch, tol=0.01)
        least = 19 if max(framed) == 9 else 29
        assert options == {
            "model": "scalar",
            "pixel_integrated": True,
            "pitch": wide.camera.image_pitch,
            "shape": max(least, enough),
            "tol": 0.01,
        }
        return "spread"

    def image(seen, given, picture, seed):
        assert (given, seen.camera.shape) == ("spread", framed)
        share = 9 / 14 if max(framed) == 9 else 1.0
        assert seen.hidden.size == pytest.approx((share * sides[0], share * sides[1]))
        k = len(pictures)
        pictures.append(picture)
        seeds.add(seed)
        ideal = np.full(framed, 0.0 if k in dark else 2.0 + k)
        ideal[1, 2] *= 2.0
        return SimpleNamespace(ideal=ideal, electrons=np.full(framed, 10.0 + k))

    monkeypatch.setattr(psf, "point_spread", spread)
    monkeypatch.setattr("nlosoptics.inverse.published.training_pairs.form_image", image)
    options = {"waves": 0.3, "modes": (5, 8, 11), "progress": lambda *said: told.append(said)}
    framed = (9, 9)
    found = inverse.training_pairs(wide, 23, size=9, **options)
    assert found.images[:, 3, 4].tolist() == [10.0 + k for k in range(24) if k != 5]
    assert found.objects.shape == (23, 9, 9)
    assert (found.objects[:, 1, 2] == 1.0).all()
    assert (found.objects[:, 2, 1] == 0.5).all()
    assert told == [
        ("training pairs: 20 of 23", 20 / 23),
        ("training pairs: 23 of 23", 1.0),
    ]
    assert len(seeds) == len(pictures) == len(waves) == 24
    pupil, strengths = psf.exit_pupil(wide), []
    for wave in waves:
        assert (wave.pupil_radius, wave.image_distance) == (pupil.radius, pupil.image_distance)
        assert wave.wavelength == scene.laser.wavelength
        polar = np.hypot(wave.u, wave.v) / pupil.radius, np.arctan2(wave.v, wave.u)
        terms = np.stack([psf.zernike(j, *polar).ravel() for j in (5, 8, 11)], axis=1)
        path = wave.aberration.ravel() / wave.wavelength
        fit = np.linalg.lstsq(terms, path, rcond=None)[0]
        assert np.abs(terms @ fit - path).max() < 1e-12
        strengths.append(np.linalg.norm(fit))
    assert 0.0 < min(strengths) < 0.05
    assert 0.25 < max(strengths) < 0.3
    pictures.clear()
    framed, dark = (11, 14), {0}
    with pytest.raises(SceneError, match=r"sees nothing of the object; move hidden\.position"):
        inverse.training_pairs(wide, 2, **options)


class Scripted:
    """A generator of numbers that are given."""

    def __init__(self, integers, uniforms):
        self._integers, self._uniforms = iter(integers), iter(uniforms)

    def integers(self, *_):
        return next(self._integers)

    def uniform(self, *_, size=None):
        return next(self._uniforms)


@pytest.mark.parametrize("angle", [0.0, 0.6, 2.5])
@pytest.mark.parametrize(
    ("kind", "area", "along", "across"),
    [
        (0, 4 * 0.4 * 0.1, 0.4**2 / 3, 0.1**2 / 3),  # a bar
        (1, np.pi * 0.2**2, 0.2**2 / 4, 0.2**2 / 4),  # a disc
        (2, np.pi * (0.34**2 - 0.22**2), (0.34**2 + 0.22**2) / 4, (0.34**2 + 0.22**2) / 4),
    ],
)
def test_pictures_hold_bars_discs_and_rings(kind, area, along, across, angle):
    """Of half lengths 0.4 and widths 0.1 about a centre, by their moments."""
    centre = np.array([0.2, -0.3])
    picture = _picture(Scripted([1, kind], [centre, angle, 0.4, 0.1, 0.9, 0.5]))
    assert {*np.unique(picture)} == {0.0, 0.5}
    side = len(picture)
    axis = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    y, x = (axis[k] for k in np.nonzero(picture))
    # pixels at the rim count whole or not
    assert len(x) * (2 / side) ** 2 == pytest.approx(area, rel=0.05)
    assert np.array([x.mean(), y.mean()]) == pytest.approx(centre, abs=1 / side)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moments = turn @ np.cov(x, y) @ turn.T
    expected = np.diag([along, across])
    assert np.abs(moments - expected).max() < 0.06 * max(along, across)


@pytest.mark.parametrize(
    ("draws", "shades"),
    [([0.699], [1.0]), ([0.7, 0.45], [0.45]), ([0.3, 0.75, 0.6], [1.0, 0.6])],
)
def test_shades_of_pictures(draws, shades):
    """White by 0.7, else as bright as is drawn; a later figure lies upon the former."""
    spans = []

    class Spanned(Scripted):
        def uniform(self, *span, size=None):
            spans.append((span, size))
            return super().uniform()

    numbers, rest = [], list(draws)
    for k in range(len(shades)):
        numbers += [np.array([0.3 * k, -0.1]), 0.0, 0.3, 0.1, rest.pop(0)]
        numbers += [rest.pop(0)] if shades[k] < 1.0 else []
    picture = _picture(Spanned([len(shades), *[0] * len(shades)], numbers))
    assert {*np.unique(picture)} == {0.0, *shades}
    side = len(picture)
    row, column = int(0.45 * side), int((0.5 + 0.15 * (len(shades) - 1)) * side)
    assert picture[row, column] == shades[-1]
    first = [((-0.45, 0.45), 2), ((0.0, np.pi), None), ((0.15, 0.45), None), ((0.04, 0.15), None)]
    assert spans[:5] == [*first, ((), None)]
    assert [span for span in spans if span == ((0.3, 1.0), None)] == [((0.3, 1.0), None)] * sum(
        shade < 1.0 for shade in shades
    )


def test_training_learns(pairs, training):
    """Better than the mean picture on pairs that were not shown."""
    held = pairs.objects[18:]
    constant = ((held - pairs.objects[:18].mean()) ** 2).mean()
    assert training.history["validation"].min() < constant
    assert training.history["training"].shape == (4,)
    assert not training.interrupted


def test_training_is_decided_by_its_seed(pairs, training):
    again = inverse.train_cnn(pairs, base=8, depth=2, epochs=4, batch=4, validation=0.25)
    for name, values in training.network.state_dict().items():
        assert torch.equal(again.network.state_dict()[name], values)


def test_best_epoch_is_kept(pairs, monkeypatch):
    errors, states = [0.3, 0.1, 0.2], []

    def validation(made, *_):
        states.append({name: values.clone() for name, values in made.state_dict().items()})
        return errors[len(states) - 1]

    monkeypatch.setattr("nlosoptics.inverse.published.cnn._validation", validation)
    found = inverse.train_cnn(pairs, base=8, depth=2, epochs=3, batch=8)
    assert found.history["validation"].tolist() == errors
    for name, values in found.network.state_dict().items():
        assert torch.equal(values, states[1][name])
    assert not torch.equal(states[1]["network.head.weight"], states[2]["network.head.weight"])


def interrupting(epoch):
    """Progress that is Ctrl-C in the middle of an epoch."""

    def progress(text, _):
        if f"epoch {epoch} " in text:
            raise KeyboardInterrupt

    return progress


def test_interrupted_training_keeps_the_best(pairs):
    options = {"base": 8, "depth": 2, "epochs": 3, "batch": 4}
    found = inverse.train_cnn(pairs, progress=interrupting(2), **options)
    assert found.interrupted
    assert len(found.history["validation"]) == 1
    with pytest.raises(KeyboardInterrupt):
        inverse.train_cnn(pairs, progress=interrupting(1), **options)


def test_file_holds_the_network(tmp_path, pairs, training):
    file = tmp_path / "network.safetensors"
    training.network.save(file)
    images = torch.from_numpy(pairs.images)
    read = inverse.CnnBaseline.load(file)
    assert torch.equal(read(images), training.network(images))
    first = file.read_bytes()
    read.save(file)
    assert file.read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == ["network.safetensors"]


def test_other_files_are_refused(tmp_path, training):
    file = tmp_path / "network.safetensors"
    with pytest.raises(SceneError, match="cannot be read"):
        inverse.CnnBaseline.load(file)
    file.write_bytes(b"no network")
    with pytest.raises(SceneError, match="is no safetensors file"):
        inverse.CnnBaseline.load(file)
    training.network.save(file)
    content = file.read_bytes()
    file.write_bytes(content[:-10])
    with pytest.raises(SceneError, match="is no safetensors file"):
        inverse.CnnBaseline.load(file)
    file.write_bytes(content.replace(b"CnnBaseline 1", b"CnnBaseline 9"))
    with pytest.raises(SceneError, match="has format 'nlosoptics CnnBaseline 9'"):
        inverse.CnnBaseline.load(file)
    file.write_bytes(content.replace(rb"\"depth\": 2", rb"\"depth\": 3"))
    with pytest.raises(SceneError, match="does not hold its network's weights"):
        inverse.CnnBaseline.load(file)
    with pytest.raises(SceneError, match="there is no folder"):
        training.network.save(tmp_path / "nowhere" / "network.safetensors")


def test_reconstruction_is_like_those_of_the_solvers(pairs, training):
    model = ForwardModel(np.full((3, 3), 1 / 9), shape=(SIDE, SIDE))
    image = 50.0 + 3.0 * pairs.images[0].astype(np.float64)
    found = training.network.reconstruct(Measurement(image, noise_sigma=300.0), model)
    assert found.object.max() == 1.0
    assert found.status in ("converged", "unconverged")
    # neither level nor unit of the image tells the network anything
    plain = training.network.reconstruct(Measurement(pairs.images[0], noise_sigma=100.0), model)
    np.testing.assert_allclose(found.object, plain.object, atol=1e-4)
    gain = found.physical_parameters["gain"]
    explained = gain * model.forward(found.object) + found.physical_parameters["background"]
    assert found.score == pytest.approx(np.sqrt(((image - explained) ** 2).mean()) / 300, rel=1e-9)
    dark = training.network.reconstruct(np.full((SIDE, SIDE), 4.0), model)
    assert dark.status == "too_few_photons"


def test_scenes_without_training_walls_are_refused(scene):
    curved = replace(scene, wall=ConcaveWall(5.0, size=scene.wall.size))
    with pytest.raises(SceneError, match="wall of type ConcaveWall"):
        inverse.training_pairs(curved, 2)
    rough = replace(scene, wall_material=Ward(0.3, 0.1))
    with pytest.raises(SceneError, match="lobe of slope_rms"):
        inverse.training_pairs(rough, 2)
    matt = replace(scene, wall_material=Lambert(0.3))
    with pytest.raises(SceneError, match="no mirror-like lobe"):
        inverse.training_pairs(matt, 2)
    with pytest.raises(SceneError, match="size = 1024 is out of range"):
        inverse.training_pairs(scene, 2, size=1024)
    with pytest.raises(SceneError, match="size = 7 is out of range"):
        inverse.training_pairs(scene, 2, size=7)
    with pytest.raises(SceneError, match="waves = 0"):
        inverse.training_pairs(scene, 2, waves=0.0)


def test_weights_that_overflow_are_refused(pairs):
    with pytest.raises(SceneError, match=r"learning_rate = 1e\+30 gave weights .* lower it"):
        inverse.train_cnn(pairs, base=8, depth=2, epochs=1, learning_rate=1e30)


def test_one_pair_is_too_few(pairs):
    one = inverse.TrainingPairs(images=pairs.images[:1], objects=pairs.objects[:1])
    with pytest.raises(SceneError, match="1 pair, must be at least 2"):
        inverse.train_cnn(one)


class Answer(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def train(capsys, examples, tmp_path, monkeypatch):
    """Call ``nlosoptics train`` on a tiny frame."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        scene = examples / "scenes" / "letter_speckle.toml"
        words = ["train", str(scene), "--pairs", "6", "--epochs", "2", "--base", "8"]
        with pytest.raises(SystemExit) as ended:
            cli.main([*words, "--frame", str(SIDE), *map(str, arguments)])
        captured = capsys.readouterr()
        return Answer(int(ended.value.code or 0), captured.out, captured.err)

    return call


def test_command_writes_a_network(train, tmp_path):
    answer = train("--out", "first.safetensors")
    assert answer.code == 0
    assert answer.err == ""
    assert "first.safetensors: mean squared error" in answer.out
    train("--out", "second.safetensors")
    assert (tmp_path / "first.safetensors").read_bytes() == (
        tmp_path / "second.safetensors"
    ).read_bytes()
    assert inverse.CnnBaseline.load(tmp_path / "first.safetensors").network.base == 8


def test_interrupted_command_keeps_the_best(train, tmp_path, monkeypatch):
    real = inverse.train_cnn
    monkeypatch.setattr(
        inverse,
        "train_cnn",
        lambda pairs, **given: real(pairs, **{**given, "progress": interrupting(2)}),
    )
    answer = train("--out", "best.safetensors")
    assert answer.code == 1
    assert "interrupted; the best network so far is in best.safetensors" in answer.err
    assert inverse.CnnBaseline.load(tmp_path / "best.safetensors")


def test_command_interrupted_at_once_writes_nothing(train, tmp_path, monkeypatch):
    real = inverse.train_cnn
    monkeypatch.setattr(
        inverse,
        "train_cnn",
        lambda pairs, **given: real(pairs, **{**given, "progress": interrupting(1)}),
    )
    answer = train()
    assert answer.code == 1
    assert answer.err == "nlosoptics: interrupted; no partial result was written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "nowhere/network.safetensors"], "no folder"),
        (["--out", "."], "is a folder; name a file"),
        (["--base", "12"], "base = '12' is unknown"),
        (["--waves", "0"], "waves = 0"),
        (["--frame", "4096"], "size = 4096 is out of range"),
        (["--pairs", "1"], "--pairs"),
        (["--size", "100"], "size = 100"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(train, tmp_path, arguments, words):
    answer = train(*arguments)
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert words in answer.err
    assert list(tmp_path.iterdir()) == []


FEW = np.random.default_rng(0).random((4, 9, 10), dtype=np.float32)
SMALL = {"base": 8, "depth": 1, "epochs": 1, "batch": 2}


def test_pairs_of_any_precision_train_and_half_may_be_held_out():
    single = inverse.train_cnn(inverse.TrainingPairs(images=FEW, objects=FEW), **SMALL)
    doubles = inverse.TrainingPairs(images=FEW.astype(float), objects=FEW.astype(float))
    found = inverse.train_cnn(doubles, **SMALL)
    np.testing.assert_array_equal(found.history["training"], single.history["training"])
    two = inverse.TrainingPairs(images=FEW[:2], objects=FEW[:2])
    # nine tenths of two pairs are both, and one is to be shown
    assert len(inverse.train_cnn(two, validation=0.9, **SMALL).history["validation"]) == 1


@pytest.mark.parametrize(
    ("images", "objects", "words"),
    [
        (FEW, FEW[:3], "give .N, H, W. both"),
        (FEW[:, 0], FEW[:, 0], "give .N, H, W. both"),
        (np.where(FEW > 0.9, np.nan, FEW), FEW, "pairs.images has .* not finite; remove"),
    ],
)
def test_bad_pairs_are_refused(images, objects, words):
    with pytest.raises(NlosError, match=words):
        inverse.train_cnn(inverse.TrainingPairs(images=images, objects=objects), **SMALL)
