"""The torch model against the numpy one."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import TorchForwardModel
from nlosoptics.inverse.data.models import mean_transfer

CASES = [
    ((16, 16), (5, 5), "padded"),
    ((17, 12), (40, 33), "padded"),
    ((13, 18), (6, 7), "circular"),
]


def twins(frame, kernel, boundary, dtype):
    rng = np.random.default_rng(0)
    model = ForwardModel(rng.random(kernel), shape=frame, boundary=boundary)
    return model, TorchForwardModel(model).to(dtype), rng.normal(size=(2, *frame))


@pytest.mark.parametrize(("frame", "kernel", "boundary"), CASES)
@pytest.mark.parametrize("arrow", ["forward", "adjoint"])
@pytest.mark.parametrize(
    # a few roundings of each precision, relative to the largest value
    ("dtype", "tolerance"),
    [(torch.float64, 1e-12), (torch.float32, 1e-5)],
)
def test_torch_agrees_with_numpy(frame, kernel, boundary, arrow, dtype, tolerance):
    model, twin, stack = twins(frame, kernel, boundary, dtype)
    expected = getattr(model, arrow)(stack)
    found = getattr(twin, arrow)(torch.from_numpy(stack).to(dtype))
    assert found.dtype == dtype
    np.testing.assert_allclose(
        found.numpy(), expected, rtol=0, atol=tolerance * np.abs(expected).max()
    )


@pytest.mark.parametrize(("frame", "kernel", "boundary"), CASES)
def test_gradient_of_half_the_square_is_adjoint_of_image(frame, kernel, boundary):
    _, twin, stack = twins(frame, kernel, boundary, torch.float64)
    picture = torch.from_numpy(stack).requires_grad_()
    image = twin(picture)
    (0.5 * (image * image).sum()).backward()
    expected = twin.adjoint(image.detach())
    # both are the same transforms in another order
    torch.testing.assert_close(picture.grad, expected, rtol=0, atol=1e-12 * float(expected.max()))


def test_casting_the_module_keeps_the_complex_transfer():
    model, twin, stack = twins(*CASES[0], torch.float64)
    back = twin.to(torch.float32).to(torch.float64)
    found = back(torch.from_numpy(stack)).numpy()
    # the transfer function went through float32
    np.testing.assert_allclose(found, model.forward(stack), rtol=0, atol=1e-5 * np.abs(found).max())


def field_twins(point_spread_field, boundary, dtype=torch.float64):
    model = ForwardModel(point_spread_field, shape=(21, 18), boundary=boundary)
    return model, TorchForwardModel(model).to(dtype)


@pytest.mark.parametrize("boundary", ["padded", "circular"])
@pytest.mark.parametrize("arrow", ["forward", "adjoint"])
@pytest.mark.parametrize(
    # a few roundings of each precision, relative to the largest value
    ("dtype", "tolerance"),
    [(torch.float64, 1e-12), (torch.float32, 1e-5)],
)
def test_fields_agree_with_numpy(point_spread_field, boundary, arrow, dtype, tolerance):
    model, twin = field_twins(point_spread_field, boundary, dtype)
    stack = np.random.default_rng(1).normal(size=(3, 2, 21, 18))
    expected = getattr(model, arrow)(stack)
    found = getattr(twin, arrow)(torch.from_numpy(stack).to(dtype))
    assert found.dtype == dtype
    np.testing.assert_allclose(
        found.numpy(), expected, rtol=0, atol=tolerance * np.abs(expected).max()
    )


@pytest.mark.parametrize("boundary", ["padded", "circular"])
def test_adjoint_of_a_field_is_its_transpose(point_spread_field, boundary):
    _, twin = field_twins(point_spread_field, boundary)
    generator = torch.Generator().manual_seed(0)
    x, y = torch.randn(2, 21, 18, dtype=torch.float64, generator=generator)
    seen, back = twin(x), twin.adjoint(y)
    # roundings of sums of 378 products
    assert float((seen * y).sum()) == pytest.approx(
        float((x * back).sum()), rel=0, abs=1e-12 * float(seen.norm() * y.norm())
    )


def test_mean_transfer_is_that_of_the_mean_kernel(point_spread_field):
    model, _ = field_twins(point_spread_field, "padded")
    mean = np.tensordot(model.weights.mean(axis=(1, 2)), model.kernel, 1)
    alone = ForwardModel(mean, shape=(21, 18))
    # sums of three transforms of values below 1
    np.testing.assert_allclose(mean_transfer(model), alone.transfer, rtol=0, atol=1e-13)
    assert np.array_equal(mean_transfer(alone), alone.transfer)


def test_a_wrong_shape_is_refused():
    _, twin, stack = twins(*CASES[0], torch.float64)
    with pytest.raises(SamplingError, match=r"must end in \(16, 16\)"):
        twin(torch.from_numpy(stack[:, :5]))


def test_what_is_no_model_and_no_tensor_is_named():
    with pytest.raises(SceneError, match=r"model of type ndarray is not an imaging\.ForwardModel"):
        TorchForwardModel(np.ones((3, 3)))
    _, twin, stack = twins(*CASES[0], torch.float64)
    for call, name in ((twin, "object_image"), (twin.adjoint, "image")):
        with pytest.raises(SceneError, match=f"{name} of type ndarray is not a tensor"):
            call(stack)
