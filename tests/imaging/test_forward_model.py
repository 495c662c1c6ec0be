"""The image model against direct sums, its own transpose and bad input."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import fft, signal

from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.psf import PointSpreadField

# Double-precision transforms of unit-size data err by a few 1e-16 per pass.
ROUNDING = 1e-13

SIZES = [
    # frame, kernel
    ((16, 16), (5, 5)),
    ((17, 13), (4, 7)),
    ((12, 21), (6, 6)),
    ((9, 8), (31, 40)),
    ((8, 9), (16, 17)),
    ((1, 6), (3, 3)),
]


def drawn(shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def padded_by_hand(kernel, picture):
    full = signal.convolve2d(picture, kernel)
    row, column = (k // 2 for k in kernel.shape)
    return full[row : row + picture.shape[0], column : column + picture.shape[1]]


def circular_by_hand(kernel, picture):
    image = np.zeros_like(picture)
    for (i, j), weight in np.ndenumerate(kernel):
        offset = (i - kernel.shape[0] // 2, j - kernel.shape[1] // 2)
        image += weight * np.roll(picture, offset, axis=(0, 1))
    return image


@pytest.mark.parametrize(("frame", "kernel"), SIZES)
def test_padded_image_is_the_direct_sum(frame, kernel):
    model = ForwardModel(drawn(kernel), shape=frame)
    picture = drawn(frame, 1)
    expected = padded_by_hand(model.kernel, picture)
    np.testing.assert_allclose(
        model.forward(picture), expected, atol=ROUNDING * np.abs(model.kernel).sum(), rtol=0
    )


@pytest.mark.parametrize(("frame", "kernel"), [s for s in SIZES if s[1] <= s[0]][:3])
def test_circular_image_is_the_sum_of_rolled_copies(frame, kernel):
    model = ForwardModel(drawn(kernel), shape=frame, boundary="circular")
    picture = drawn(frame, 1)
    expected = circular_by_hand(model.kernel, picture)
    np.testing.assert_allclose(
        model.forward(picture), expected, atol=ROUNDING * np.abs(model.kernel).sum(), rtol=0
    )


@pytest.mark.parametrize(("frame", "kernel"), SIZES)
@pytest.mark.parametrize("boundary", ["padded", "circular"])
def test_adjoint_is_the_transpose(frame, kernel, boundary):
    if boundary == "circular" and any(k > n for k, n in zip(kernel, frame, strict=True)):
        kernel = tuple(min(k, n) for k, n in zip(kernel, frame, strict=True))
    model = ForwardModel(drawn(kernel), shape=frame, boundary=boundary)
    picture, image = drawn(frame, 1), drawn(frame, 2)
    seen = model.forward(picture)
    difference = np.vdot(seen, image) - np.vdot(picture, model.adjoint(image))
    assert abs(difference) <= 1e-12 * np.linalg.norm(seen) * np.linalg.norm(image)


@pytest.mark.parametrize("kernel", [(5, 5), (4, 6), (31, 30)])
def test_point_object_gives_the_kernel_around_it(kernel):
    model = ForwardModel(drawn(kernel), shape=(20, 22))
    point = np.zeros((20, 22))
    point[9, 12] = 2.0
    image = model.forward(point)
    centre = (kernel[0] // 2, kernel[1] // 2)
    for i, j in [(9, 12), (8, 12), (9, 14), (10, 11)]:
        expected = 2.0 * model.kernel[centre[0] + i - 9, centre[1] + j - 12]
        assert image[i, j] == pytest.approx(expected, abs=1e-13)


def test_light_beyond_the_frame_is_lost_when_padded_and_kept_when_circular():
    kernel = np.full((5, 5), 1 / 25)
    edge = np.zeros((10, 10))
    edge[0, 5] = 1.0
    # two of five kernel rows fall outside
    assert ForwardModel(kernel, shape=(10, 10)).forward(edge).sum() == pytest.approx(0.6)
    periodic = ForwardModel(kernel, shape=(10, 10), boundary="circular")
    assert periodic.forward(edge).sum() == pytest.approx(1.0)


def test_thread_count_changes_no_bit():
    model = ForwardModel(drawn((33, 31)), shape=(96, 100))
    picture = drawn((96, 100), 1)
    alone = model.forward(picture)
    with fft.set_workers(2):
        again = ForwardModel(drawn((33, 31)), shape=(96, 100)).forward(picture)
    assert alone.tobytes() == again.tobytes()


@pytest.mark.parametrize(
    ("kernel", "options", "kind", "words"),
    [
        (np.full((3, 3), np.nan), {}, SamplingError, "9 of 9 values that are not finite"),
        (np.zeros((3, 3)), {}, SamplingError, "zero everywhere"),
        (np.ones(3), {}, SamplingError, r"shape \(3,\)"),
        (np.ones((0, 3)), {}, SamplingError, "at least one pixel"),
        ("disc", {}, SamplingError, "str is not an array"),
        (np.ones((3, 3)), {"shape": (8, -8)}, SceneError, r"shape\[1\] = -8"),
        (np.ones((3, 3)), {"shape": (8.5, 8)}, SceneError, r"shape\[0\] = 8.5"),
        (np.ones((3, 3)), {"shape": 8}, SamplingError, "shape = 8 is not an image size"),
        (np.ones((3, 3)), {"boundary": "mirror"}, SceneError, "'mirror' is unknown"),
        (np.ones((9, 3)), {"boundary": "circular"}, SamplingError, "larger than the circular"),
        (
            SimpleNamespace(intensity=np.ones((3, 3)), pitch=-1e-6),
            {},
            SceneError,
            "point_spread.pitch = -1e-06",
        ),
        (np.ones((3, 3)), {"shape": (10**7, 10**7)}, MemoryLimitError, "GiB, limit"),
    ],
)
def test_bad_model_is_refused_in_one_line(kernel, options, kind, words):
    with pytest.raises(kind, match=words) as caught:
        ForwardModel(kernel, **{"shape": (8, 8), **options})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("arrow", ["forward", "adjoint"])
def test_bad_picture_is_refused(arrow):
    model = ForwardModel(np.ones((3, 3)), shape=(8, 9))
    with pytest.raises(SamplingError, match=r"shape \(9, 8\), must end in \(8, 9\)"):
        getattr(model, arrow)(np.ones((9, 8)))
    with pytest.raises(SamplingError, match=r"1 of \d+ values that are not finite"):
        getattr(model, arrow)(np.where(np.arange(9) + 9 * np.arange(8)[:, None] == 3, np.inf, 1.0))


def field_of_three():
    """Kernels of 5 x 3 that mix differently at every point: three modes on 3 x 4 nodes."""
    across, up = (np.cos(np.pi * (2 * np.arange(n) + 1) / (2 * n))[::-1].copy() for n in (4, 3))
    return PointSpreadField(
        modes=drawn((3, 5, 3), 5),
        weights=drawn((3, 3, 4), 6),
        across=across,
        up=up,
        pitch=1e-5,
        truncation_error=0.0,
        error_estimate=0.0,
    )


def test_places_belong_to_a_field_and_to_the_frame():
    at = (np.zeros((8, 9)), np.zeros((8, 9)))
    with pytest.raises(SamplingError, match="at is given, but the point spread is not a field"):
        ForwardModel(np.ones((3, 3)), shape=(8, 9), at=at)
    for wrong in ((at[0], at[1].T), (at[0].T, at[1])):
        with pytest.raises(SamplingError, match=r"must be the model's \(8, 9\); give the picture"):
            ForwardModel(field_of_three(), shape=(8, 9), at=wrong)
    model = ForwardModel(field_of_three(), shape=(8, 9), at=at)
    assert not model.kernel.flags.writeable
    assert not model.transfer.flags.writeable
    assert "transfer" not in repr(model)
    assert "kernel" not in repr(model)
    assert len(repr(model)) < 200


@pytest.mark.parametrize("boundary", ["padded", "circular"])
def test_each_point_of_a_field_has_its_own_kernel(boundary):
    """The image of a point is the sum of the modes about it, times their weights there."""
    field, shape = field_of_three(), (11, 13)
    model = ForwardModel(field, shape=shape, boundary=boundary)
    y, x = (2 * np.arange(n) + 1 - n for n in shape)
    weights = field.at(x / shape[1], y[:, None] / shape[0])
    other = drawn(shape, 7)
    # a corner, where circular frames wrap around, and a point within
    for row, column in ((0, 12), (4, 7)):
        kernel = np.einsum("k,kyx->yx", weights[:, row, column], field.modes)
        expected = np.zeros(shape)
        for i, j in np.ndindex(*kernel.shape):
            to = row + i - 2, column + j - 1
            if boundary == "circular":
                to = to[0] % shape[0], to[1] % shape[1]
            if 0 <= to[0] < shape[0] and 0 <= to[1] < shape[1]:
                expected[to] += kernel[i, j]
        point = np.zeros(shape)
        point[row, column] = 3.0
        # rounding of transforms
        assert model.forward(point) == pytest.approx(3.0 * expected, abs=1e-13)
        assert model.adjoint(other)[row, column] == pytest.approx((expected * other).sum())
