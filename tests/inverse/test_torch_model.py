"""The torch model against the numpy one."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse import TorchForwardModel

CASES = [
    ((16, 16), (5, 5), "padded"),
    ((17, 12), (40, 33), "padded"),
    ((13, 18), (6, 7), "circular"),
]


def twins(frame, kernel, boundary, dtype):
    rng = np.random.default_rng(0)
    model = ForwardModel(rng.random(kernel), shape=frame, boundary=boundary)
    return model, TorchForwardModel.from_numpy(model, "cpu", dtype), rng.normal(size=(2, *frame))


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


def test_bad_dtype_and_shape_are_refused():
    model, twin, stack = twins(*CASES[0], torch.float64)
    with pytest.raises(SamplingError, match=r"torch\.float16 is not supported"):
        TorchForwardModel.from_numpy(model, "cpu", torch.float16)
    with pytest.raises(SamplingError, match=r"must end in \(16, 16\)"):
        twin(torch.from_numpy(stack[:, :5]))
