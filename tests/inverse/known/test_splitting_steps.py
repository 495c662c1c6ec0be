"""Kernels of total variation's splitting against the same steps in whole arrays."""

import copy

import numpy as np
import pytest

from nlosoptics.inverse.known.splitting_steps import KernelSteps, Steps, gradient

FRAME, GRID = (9, 11), (12, 15)


@pytest.mark.parametrize(("precision", "error"), [(np.float32, 1e-5), (np.float64, 1e-13)])
def test_kernels_make_the_steps_of_whole_arrays(precision: type, error: float) -> None:
    """Each array and each sum, to rounding; a pixel without weight and a dark edge included."""
    generator = np.random.default_rng(3)

    def drawn(*shape: int) -> np.ndarray:
        return generator.normal(size=shape).astype(precision)

    def spectrum() -> np.ndarray:
        half = GRID[0], GRID[1] // 2 + 1
        values = generator.normal(size=(2, *half))
        return (values[0] + 1j * values[1]).astype(np.result_type(precision, np.complex64))

    image, shape, weights = drawn(*FRAME), np.abs(drawn(*FRAME)), np.abs(drawn(*FRAME))
    weights[2, 3] = 0.0
    free, seen, signed, sign_dual, predicted, pull = (drawn(*GRID) for _ in range(6))
    edges, edge_dual, dual = drawn(2, *GRID), drawn(2, *GRID), drawn(*FRAME)
    free[4:7, 4:7] = 1.0  # no gradient
    edges[:, 5, 5] = edge_dual[:, 5, 5] = 0.0
    first, second, filtered, transfer = (spectrum() for _ in range(4))
    inverse = np.abs(drawn(GRID[0], GRID[1] // 2 + 1))
    given = (edges, edge_dual, signed, sign_dual, predicted, dual, pull, first, second)

    def results(steps: Steps) -> list[object]:
        arrays = copy.deepcopy(given)
        edges, edge_dual, signed, sign_dual, predicted, dual, pull, first, second = arrays
        steps.pull(edges, edge_dual, 0.7, signed, sign_dual, 0.4, pull)
        steps.mix(first, second, filtered, inverse, transfer)
        numbers = [
            steps.shrink_edges(free, edges, edge_dual, 0.3),
            steps.keep_positive(free, signed, sign_dual),
            steps.relax_image(seen, predicted, dual, 0.2, 0.6),
            steps.weigh_misfit(predicted, 0.2, 0.6),
        ]
        steps.split_misfit(predicted, dual, 0.2, 0.6)
        return [*arrays, *numbers]

    whole = results(Steps(image, shape, weights))
    for one, other in zip(results(KernelSteps(image, shape, weights, GRID[1])), whole, strict=True):
        assert one == pytest.approx(other, rel=error, abs=error * 10)


def test_pull_is_the_transpose_of_the_gradient() -> None:
    """The inner products of both sides agree to rounding."""
    generator = np.random.default_rng(4)
    picture, field = generator.normal(size=GRID), generator.normal(size=(2, *GRID))
    steps = KernelSteps(*(np.ones(FRAME) for _ in range(3)), GRID[1])
    back, dark = np.empty(GRID), np.zeros(GRID)
    steps.pull(field, 0.0 * field, 1.0, dark, dark, 0.0, back)
    product = float((gradient(picture) * field).sum())
    assert float((picture * back).sum()) == pytest.approx(product, rel=1e-12)
