"""U-nets: results of plain torch, images of any size, seeded weights."""

from __future__ import annotations

import pytest
import torch

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.inverse.published.unet import UNetObject


@pytest.mark.parametrize(("base", "millions"), [(8, 0.44), (16, 1.77), (32, 7.06)])
def test_sizes_are_those_documented(base, millions):
    weights = sum(parameter.numel() for parameter in inverse.UNet(base).parameters())
    assert weights / 1e6 == pytest.approx(millions, abs=0.005)


@pytest.mark.parametrize("shape", [(1, 1), (7, 40), (33, 17), (64, 64)])
def test_any_size_goes_through(shape):
    network = inverse.UNet(8, in_channels=2)
    assert network(torch.rand(3, 2, *shape)).shape == (3, 1, *shape)


def test_a_side_that_divides_is_not_padded():
    """Continuing a picture by its last samples is what an unpadded one is told by hand."""
    network = inverse.UNet(8, depth=2)
    picture = torch.rand(1, 1, 8, 7)
    continued = torch.cat((picture, picture[..., -1:]), dim=-1)
    torch.testing.assert_close(network(picture), network(continued)[..., :7])


def test_pictures_of_a_batch_are_apart():
    """Normalisation is within a picture, so one of a batch is like one alone."""
    network = inverse.UNet(8)
    pictures = torch.rand(3, 1, 32, 32)
    alone = torch.cat([network(picture[None]) for picture in pictures])
    # other blocks of the convolutions, in single precision
    torch.testing.assert_close(network(pictures), alone, rtol=1e-4, atol=1e-4)


def test_seed_decides_the_weights_and_nothing_else():
    torch.manual_seed(5)
    expected = torch.rand(4)
    torch.manual_seed(5)
    first, again, other = (inverse.UNet(8, seed=seed).state_dict() for seed in (3, 3, 4))
    torch.testing.assert_close(torch.rand(4), expected, rtol=0, atol=0)
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["head.weight"], other["head.weight"])


def test_torch_defaults_and_accelerators_have_no_say(monkeypatch):
    seeded = []
    monkeypatch.setattr(torch.cuda, "manual_seed_all", seeded.append)
    expected = inverse.UNet(8, 2, seed=3).state_dict()
    torch.set_default_dtype(torch.float64)
    try:
        found = inverse.UNet(8, 2, seed=3).state_dict()
    finally:
        torch.set_default_dtype(torch.float32)
    assert not seeded
    for name, values in expected.items():
        torch.testing.assert_close(found[name], values, rtol=0, atol=0)


def test_object_is_between_zero_and_one_and_ignores_level_and_scale():
    guide = torch.rand(20, 24)
    first = UNetObject(guide, seed=1)().detach()
    assert first.shape == (20, 24)
    assert float(first.min()) > 0.0
    assert float(first.max()) < 1.0
    # the guide's rounding, 7 + 1000 rand, in single precision
    torch.testing.assert_close(
        UNetObject(7.0 + 1e3 * guide, seed=1)().detach(), first, atol=1e-4, rtol=0
    )


def test_uniform_guide_gives_no_nan():
    assert torch.isfinite(UNetObject(torch.full((16, 16), 3.0))()).all()


@pytest.mark.thorough
def test_object_fits_a_picture():
    """Gradients reach all weights: a square is learnt from its blur in some steps."""
    picture = torch.zeros(16, 16)
    picture[4:12, 5:11] = 1.0
    fitted = UNetObject(torch.nn.functional.avg_pool2d(picture[None], 5, 1, 2)[0])
    optimiser = torch.optim.Adam(fitted.parameters(), 0.01)
    for _ in range(60):
        optimiser.zero_grad()
        loss = (fitted() - picture).square().mean()
        loss.backward()
        optimiser.step()
    assert all(float(parameter.grad.abs().max()) > 0.0 for parameter in fitted.parameters())
    # a constant would leave 0.15
    assert loss.item() < 0.01


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda: inverse.UNet(12), SceneError, "base = '12' is unknown, must be one of 8, 16, 32"),
        (lambda: inverse.UNet(8, 0), SceneError, "depth = 0 is out of range"),
        (lambda: inverse.UNet(8, seed=-1), SceneError, "seed = -1"),
        (lambda: inverse.UNet(8)(torch.ones(4, 4)), SamplingError, r"picture has shape \(4, 4\)"),
    ],
)
def test_bad_input_is_refused(make, kind, words):
    with pytest.raises(kind, match=words):
        make()
