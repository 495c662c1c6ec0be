"""Steps, errors and files of the trained network, and the U-net by plain convolutions."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from pytest import approx

from nlosoptics import inverse
from nlosoptics.errors import NlosError, SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import Measurement
from nlosoptics.inverse.published.unet import UNet, UNetObject

DRAW = np.random.default_rng(6)
IMAGES = DRAW.random((7, 9, 10), dtype=np.float32) * 5.0 + 2.0
OBJECTS = DRAW.random((7, 9, 10), dtype=np.float32)
PAIRS = inverse.TrainingPairs(images=IMAGES, objects=OBJECTS)
STILL = 1e-30  # a learning rate that changes no weight


def network(**changes):
    return inverse.CnnBaseline(**{"base": 8, "depth": 1, "seed": 4} | changes)


def squares(made, which):
    """Mean squared error of chosen pairs, one by one."""
    with torch.no_grad():
        found = [made(torch.from_numpy(IMAGES[i : i + 1]))[0].numpy() for i in which]
    return np.mean([(one - OBJECTS[i]) ** 2 for one, i in zip(found, which, strict=True)])


def test_network_sees_images_of_mean_0_and_spread_1():
    made, images = network(), torch.from_numpy(IMAGES[:3])
    plain = [(one - one.mean()) / one.std(correction=0) for one in images]
    with torch.no_grad():
        wanted = torch.sigmoid(made.network(torch.stack(plain)[:, None])[:, 0])
        found = made(images)
        dark = made(torch.full((1, 8, 8), 3.0))
    torch.testing.assert_close(found, wanted)
    with torch.no_grad():  # in any unit
        torch.testing.assert_close(made(1e-6 * images), wanted, rtol=1e-3, atol=1e-4)
    assert found.shape == (3, 9, 10)
    assert torch.isfinite(dark).all()
    with pytest.raises(NlosError, match=r"images has shape \(9, 10\), must be \(B, H, W\)"):
        made(images[0])


@pytest.mark.parametrize(("share", "held"), [(0.1, 1), (0.3, 2), (0.64, 4), (0.9, 6)])
def test_errors_are_means_over_shown_and_held_pairs(share, held):
    """Of a network that learns nothing, also where the last batch is smaller."""
    options = {"base": 8, "depth": 1, "seed": 4, "epochs": 2, "learning_rate": STILL}
    found = inverse.train_cnn(PAIRS, batch=2, validation=share, **options)
    made, history = network(), found.history
    shown = 7 - held
    assert history["training"] == approx([squares(made, range(shown))] * 2, rel=1e-5)
    assert history["validation"] == approx([squares(made, range(shown, 7))] * 2, rel=1e-5)
    assert 0.0 < found.seconds < 60.0
    for name, values in found.network.state_dict().items():
        torch.testing.assert_close(values, made.state_dict()[name], rtol=0, atol=1e-28)


def test_steps_follow_a_cosine_and_are_told(monkeypatch):
    rates, told = [], []
    real = torch.optim.Adam.step

    def step(self, *given):
        rates.append(self.param_groups[0]["lr"])
        return real(self, *given)

    monkeypatch.setattr(torch.optim.Adam, "step", step)
    found = inverse.train_cnn(
        PAIRS,
        **{"base": 8, "depth": 1, "epochs": 3, "batch": 2, "validation": 0.3},
        learning_rate=0.01,
        progress=lambda *step: told.append(step),
    )
    # five shown pairs in batches of 2, 2 and 1
    done = [(epoch + start / 5) / 3 for epoch in range(3) for start in (0, 2, 4)]
    assert rates == approx([0.01 * (1 + math.cos(math.pi * share)) / 2 for share in done])
    assert [share for _, share in told] == approx([*done, 1.0])
    best = np.minimum.accumulate(found.history["validation"])
    assert [text for text, _ in told] == [
        *["training: epoch 1 of 3"] * 3,
        *[f"training: epoch 2 of 3, validation {best[0]:.4f}"] * 3,
        *[f"training: epoch 3 of 3, validation {best[1]:.4f}"] * 3,
        f"training: validation {best[2]:.4f}",
    ]
    assert squares(found.network, [5, 6]) == approx(best[2], rel=1e-4)
    assert not found.interrupted


def test_interrupted_training_tells_no_end():
    told = []

    def progress(text, _):
        told.append(text)
        if "epoch 2" in text:
            raise KeyboardInterrupt

    found = inverse.train_cnn(PAIRS, base=8, depth=1, epochs=3, progress=progress)
    assert found.interrupted
    assert told[-1].startswith("training: epoch 2 of 3, validation ")
    assert len(told) == 2


def test_settings_that_are_left_out():
    """They are those that the documentation tells."""
    draw = np.random.default_rng(2)
    images = draw.random((19, 4, 5), dtype=np.float32)
    pairs = inverse.TrainingPairs(images=images, objects=images[::-1].copy())
    told = {"epochs": 20, "batch": 16, "learning_rate": 3e-3, "validation": 0.1, "seed": 0}
    plain, named = (inverse.train_cnn(pairs, base=8, depth=1, **given) for given in ({}, told))
    assert len(plain.history["training"]) == 20
    for name in ("training", "validation"):
        assert plain.history[name].tolist() == named.history[name].tolist()


def test_order_and_weights_follow_the_seed():
    options = {"base": 8, "depth": 1, "epochs": 1, "batch": 2}
    first, second, other = (inverse.train_cnn(PAIRS, seed=s, **options) for s in (1, 1, 2))
    assert first.history["training"] == second.history["training"]
    assert first.history["training"] != other.history["training"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"epochs": 0}, "epochs = 0"),
        ({"batch": 0}, "batch = 0"),
        ({"learning_rate": 0.0}, "learning_rate = 0"),
        ({"validation": 0.0}, "validation = 0"),
        ({"validation": 0.91}, "validation = 0.91"),
        ({"seed": -1}, "seed = -1"),
    ],
)
def test_options_out_of_range_are_refused(options, words):
    with pytest.raises(SceneError, match=words):
        inverse.train_cnn(PAIRS, **{"base": 8, "depth": 1, "epochs": 1} | options)


def test_bad_values_of_pairs_are_counted():
    objects = OBJECTS.copy()
    objects[1, 2, 3] = np.nan
    objects[4, 0, 0] = np.inf
    pairs = inverse.TrainingPairs(images=IMAGES, objects=objects)
    with pytest.raises(SceneError, match="pairs.objects has 2 of 630 values that are not finite"):
        inverse.train_cnn(pairs, base=8)


def test_file_tells_format_and_size_and_refuses_weights_that_are_not_finite(tmp_path):
    made, file = network(depth=2), tmp_path / "one.safetensors"
    made.save(file)
    content = file.read_bytes()
    length = int.from_bytes(content[:8], "little")
    told = json.loads(json.loads(content[8 : 8 + length])["__metadata__"]["nlosoptics"])
    assert told == {"format": "nlosoptics CnnBaseline 1", "base": 8, "depth": 2}
    read = inverse.CnnBaseline.load(str(file))
    assert (read.network.base, read.network.depth) == (8, 2)
    with torch.no_grad():
        next(made.parameters())[0, 0, 0, 0] = math.nan
    made.save(str(file))
    with pytest.raises(SceneError, match=r"one.safetensors has weights that are not finite; train"):
        inverse.CnnBaseline.load(file)


@pytest.fixture
def model():
    draw = np.random.default_rng(8)
    kernel = draw.random((3, 5))
    return ForwardModel(kernel / kernel.sum(), shape=IMAGES[0].shape)


def test_reconstruction_scales_the_networks_object_to_the_image(model):
    draw = np.random.default_rng(8)
    made = network()
    with torch.no_grad():
        plain = made(torch.from_numpy(IMAGES[:1]))[0].double().numpy()
    seen = model.forward(plain)
    image = 40.0 * seen + 3.0 + 0.5 * draw.normal(size=seen.shape)
    with torch.no_grad():
        shape = made(torch.from_numpy(image[None].astype(np.float32)))[0].double().numpy()
    columns = np.stack([model.forward(shape).ravel(), np.ones(image.size)], axis=1)
    (strength, ground), *_ = np.linalg.lstsq(columns, image.ravel(), rcond=None)
    found = made.reconstruct(Measurement(image, noise_sigma=0.5), model)
    assert found.object == approx(shape / shape.max(), abs=1e-5)
    assert found.physical_parameters["gain"] == approx(strength * shape.max(), rel=1e-4)
    assert found.physical_parameters["background"] == approx(ground, abs=1e-3)
    misfit = columns @ (strength, ground) - image.ravel()
    assert found.score == approx(np.sqrt((misfit**2).mean()) / 0.5, rel=1e-4)
    assert {name: len(values) for name, values in found.history.items()} == {
        "objective": 0,
        "residual": 0,
        "change": 0,
    }


@pytest.mark.parametrize("tolerance", [0.0, 0.501, -0.1])
def test_tolerance_out_of_range_is_refused(model, tolerance):
    with pytest.raises(SceneError, match=f"tolerance = {tolerance:g}"):
        network().reconstruct(IMAGES[0], model, tolerance=tolerance)


class Knowing(inverse.CnnBaseline):
    """A network that answers with one object."""

    def __init__(self, answer):
        super().__init__(base=8, depth=1)
        self.answer = torch.from_numpy(answer)

    def forward(self, images):
        return self.answer[None].to(images)


@pytest.mark.parametrize(("excess", "status"), [(0.99, "converged"), (1.01, "unconverged")])
def test_converged_is_a_residual_within_the_tolerance(excess, status):
    """With a noise for which the residual is just above or below one plus the tolerance."""
    across, up = np.meshgrid(np.arange(24.0) - 9.0, np.arange(22.0) - 12.0)
    blob = np.exp(-(across**2 + up**2) / 40.0)
    image = 30.0 * blob + np.random.default_rng(2).normal(size=blob.shape)
    made, model = Knowing(blob), ForwardModel(np.eye(1), shape=blob.shape)
    misfit = made.reconstruct(Measurement(image, noise_sigma=1.0), model).score
    found = made.reconstruct(
        Measurement(image, noise_sigma=misfit / (1.4 * excess)), model, tolerance=0.4
    )
    assert found.score == approx(1.4 * excess, rel=1e-6)
    assert found.status == status
    assert found.object == approx(blob / blob.max(), abs=1e-6)


def convolved(values, stage):
    """The layers of a stage by plain functions, in the order that the class tells."""
    for layer in stage:
        if isinstance(layer, torch.nn.Conv2d):
            padded = F.pad(
                values, (1, 1, 1, 1), mode=layer.padding_mode.replace("zeros", "constant")
            )
            values = F.conv2d(padded, layer.weight, layer.bias)
        elif isinstance(layer, torch.nn.GroupNorm):
            every = values.flatten(1)
            mean, spread = every.mean(dim=1), every.var(dim=1, correction=0)
            values = (values - mean[:, None, None, None]) / (spread + layer.eps).sqrt()[
                :, None, None, None
            ]
            values = values * layer.weight[:, None, None] + layer.bias[:, None, None]
        else:
            values = torch.where(values > 0, values, 0.1 * values)
    return values


@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("shape", [(8, 16), (9, 13)])
def test_network_is_an_encoder_and_a_decoder_with_skips(depth, shape):
    draw = np.random.default_rng(8)
    made = UNet(8, depth, in_channels=2, out_channels=3, seed=5)
    picture = torch.from_numpy(draw.random((2, 2, *shape), dtype=np.float32))
    whole = [-(-n // 2**depth) * 2**depth for n in shape]
    rows, columns = (np.minimum(np.arange(w), n - 1) for w, n in zip(whole, shape, strict=True))
    values, skipped = picture[:, :, rows][:, :, :, columns], []
    with torch.no_grad():
        for stage in made.encoder[:-1]:
            values = convolved(values, stage)
            skipped.append(values)
            parts = [values[:, :, i::2, j::2] for i in (0, 1) for j in (0, 1)]
            values = torch.stack(parts).amax(dim=0)
        values = convolved(values, made.encoder[-1])
        for level in range(depth - 1, -1, -1):
            finer = values.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
            values = convolved(torch.cat([finer, skipped[level]], dim=1), made.decoder[level])
        wanted = torch.einsum("oc,bchw->bohw", made.head.weight[:, :, 0, 0], values)
        wanted += made.head.bias[:, None, None]
        found = made(picture)
    assert found.shape == (2, 3, *shape)
    torch.testing.assert_close(found, wanted[..., : shape[0], : shape[1]], rtol=1e-4, atol=1e-5)
    convolutions = [
        sum(isinstance(layer, torch.nn.Conv2d) for layer in stage)
        for stage in (*made.encoder, *made.decoder)
    ]
    assert convolutions == [2] * (depth + 1) + [1] * depth


@pytest.mark.parametrize(("base", "millions"), [(8, 0.44), (16, 1.77), (32, 7.06)])
def test_number_of_weights(base, millions):
    made = UNet(base)
    assert sum(one.numel() for one in made.parameters()) == approx(1e6 * millions, rel=0.01)
    assert made.decoder[0][0].weight.is_contiguous(memory_format=torch.channels_last)
    assert (made.in_channels, made.out_channels, made.depth) == (1, 1, 4)


def test_seed_decides_the_weights_and_leaves_torchs_own_draws_alone():
    torch.manual_seed(7)
    wanted = torch.rand(3)
    torch.manual_seed(7)
    one, same, other = (UNet(8, 1, seed=seed).head.weight for seed in (3, 3, 4))
    assert torch.equal(torch.rand(3), wanted)
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"base": 12}, "base = '12'"),
        ({"depth": 9}, "depth = 9"),
        ({"depth": 0}, "depth = 0"),
        ({"in_channels": 0}, "in_channels = 0"),
        ({"out_channels": 0}, "out_channels = 0"),
    ],
)
def test_networks_of_other_sizes_are_refused(options, words):
    with pytest.raises(SceneError, match=words):
        UNet(**options)


@pytest.mark.parametrize("shape", [(1, 3, 8, 8), (2, 8, 8), (8, 8)])
def test_pictures_of_other_channels_are_refused(shape):
    with pytest.raises(SamplingError, match=re.escape(f"{shape}, must be (B, 2, H, W); give one")):
        UNet(8, 1, in_channels=2)(torch.zeros(shape))


@pytest.mark.parametrize(
    ("guide", "words"),
    [
        (np.ones((8, 8)), "guide of type ndarray is not a tensor of floats; give torch.from_numpy"),
        (torch.ones((8, 8), dtype=torch.int32), "guide of type Tensor is not a tensor of floats"),
        (torch.ones(8), r"guide has shape \(8,\), must be \(H, W\) or \(C, H, W\)"),
        (torch.ones((1, 1, 8, 8)), r"guide has shape \(1, 1, 8, 8\), must be"),
    ],
)
def test_other_guides_are_refused(guide, words):
    with pytest.raises(NlosError, match=words):
        UNetObject(guide)


def test_untrained_objects_take_guides_of_one_or_several_channels():
    draw = np.random.default_rng(8)
    guide = torch.from_numpy(draw.random((3, 8, 9))) * 4e-3 + 1.0
    flat = guide.clone()
    flat[1] = 6.0
    for given in (guide, guide[0], flat):
        made = UNetObject(given, base=8, depth=1, seed=3)
        channels = given if given.ndim == 3 else given[None]
        assert made.network.in_channels == len(channels)
        mean = channels.mean(dim=(1, 2), keepdim=True)
        spread = channels.std(dim=(1, 2), keepdim=True, correction=0)
        plain = (channels - mean) / torch.where(spread > 0, spread, 1.0)
        torch.testing.assert_close(made.guide, plain[None])
        with torch.no_grad():
            found = made()
            torch.testing.assert_close(found, torch.sigmoid(made.network(plain[None])[0, 0]))
        made.set_guide(5.0 * given + 2.0)
        torch.testing.assert_close(made.guide, plain[None])
        assert found.shape == (8, 9)
        assert found.dtype == torch.float64
