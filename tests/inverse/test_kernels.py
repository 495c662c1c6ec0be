"""Kernels of the evidence fit and of the splitting steps, each alone, on record.

The kernels are plain Python here, see `plain_kernels`. No two sizes are equal and no number is
round, so that an exchange of any two of them is seen.
"""

from __future__ import annotations

import numpy as np
import pytest

from ..plain_kernels import TIGHT, after, complexes, numbers, plain

evidence = plain("inverse.blind._evidence_kernels")
splitting = plain("inverse.known._splitting_kernels")
STARTS, IMAGES, ROWS, COLUMNS = 2, 3, 4, 5  # of an image; the grid is larger
HIGH, WIDE = 6, 8
HALF = WIDE // 2 + 1


def positive(*shape, seed=0):
    return numbers(*shape, low=0.2, seed=seed)


def test_predictions(on_record):
    transfer, pixel = complexes(STARTS, IMAGES, HIGH, HALF), numbers(IMAGES, HIGH, HALF)
    out, objects = np.zeros(transfer.shape, complex), complexes(STARTS, HIGH, HALF)
    field, bright = complexes(STARTS, IMAGES, HIGH, WIDE), np.zeros((STARTS, IMAGES, HIGH, WIDE))
    weight, toward = numbers(STARTS, IMAGES, HIGH, WIDE), np.zeros(bright.shape, complex)
    pupils = complexes(STARTS, 4, 9), complexes(STARTS, 4, 9, seed=2)
    on_record(
        [
            after(evidence.intensity, field, bright),
            after(evidence.predict, transfer, pixel, numbers(STARTS, IMAGES), objects, out),
            after(evidence.pull_back, field, weight, 1.7, toward),
            after(
                evidence.phase_gradient, *pupils, np.array([2, 0, 2, 1]), np.ones((STARTS, 3, 9))
            ),
        ],
        TIGHT,
    )


@pytest.mark.parametrize("fits", [True, False], ids=["background", "none"])
def test_misfits(fits, on_record):
    predicted = positive(STARTS, IMAGES, HIGH, WIDE)
    given = [positive(IMAGES, ROWS, COLUMNS, seed=seed) for seed in range(3)]
    pair = np.zeros((STARTS, IMAGES)), np.zeros((STARTS, IMAGES))
    others = np.zeros((STARTS, IMAGES)), np.zeros((STARTS, IMAGES))
    on_record(
        [
            after(evidence.brightness, predicted, *given, fits, *pair),
            after(evidence.residuals, predicted, *given, positive(IMAGES), fits, *others),
        ],
        TIGHT,
    )


@pytest.mark.parametrize("wanted", [True, False], ids=["energy", "none"])
def test_priors_and_covariances(wanted, on_record):
    objects, variances = numbers(STARTS, ROWS, COLUMNS), positive(STARTS, 2)
    gradient, weights, energy = np.ones(objects.shape), np.zeros((STARTS, 2)), np.ones(STARTS)
    transfer, residual = complexes(2, STARTS, IMAGES, HIGH, HALF)
    arrays = (transfer, residual, complexes(STARTS, HIGH, HALF), numbers(IMAGES, HIGH, HALF))
    numbers_of = (positive(STARTS, IMAGES), positive(HIGH + HALF), positive(STARTS, 2, seed=1))
    toward, spread, total = complexes(STARTS, HIGH, HALF), np.zeros((STARTS, 2)), np.ones(STARTS)
    noise = np.array([2.7, 0.4])
    flat = np.zeros((STARTS, 2))
    on_record(
        [
            after(evidence.roughness, objects, variances, 0.7, gradient, weights, energy, wanted),
            after(
                *(evidence.spectra, *arrays, *numbers_of, noise, 0.31, toward, spread, total),
                wanted,
            ),
            # without a power or a prior only the least inverse covariance is left
            after(
                *(evidence.spectra, 0.0 * transfer, residual, *arrays[2:], *numbers_of[:2], flat),
                *(noise, 0.31, toward.copy(), spread.copy(), total.copy(), wanted),
            ),
        ],
        TIGHT,
    )


def test_steps_of_an_object(on_record):
    free, support = numbers(STARTS, ROWS, COLUMNS), numbers(ROWS, COLUMNS, low=0.0)
    moments = numbers(STARTS, ROWS, COLUMNS, seed=1), positive(STARTS, ROWS, COLUMNS)
    gradients = numbers(2, STARTS, ROWS, COLUMNS)
    out = np.zeros(free.shape)
    shape = (free, support, *gradients, *moments)
    zero = [np.zeros((1, 2, 3)) for _ in range(5)]
    step = (zero[0], np.ones((2, 3)), *zero[1:])
    on_record(
        [
            after(evidence.softly_positive, free, support, 0.37, out),
            [after(evidence.object_step, *shape, 0.37, 0.11, bias) for bias in (0.3, 0.8)],
            after(evidence.object_step, *step, 0.37, 0.11, 0.3),
        ],
        TIGHT,
    )


def test_splitting(on_record):
    pairs = [numbers(2, ROWS, COLUMNS, seed=seed) for seed in range(3)]
    planes = [numbers(ROWS, COLUMNS, seed=seed) for seed in range(6)]
    weights, level, ratio = positive(ROWS, COLUMNS), 0.23, 1.9
    larger = [numbers(HIGH, WIDE, seed=seed) for seed in range(2)]

    def sums(count):
        return np.ones((count, WIDE))

    def copies(*arrays):
        return [one.copy() for one in arrays]

    on_record(
        [
            after(splitting.pull, *pairs[:2], 1.3, *planes[:2], 0.7, np.zeros((ROWS, COLUMNS))),
            after(splitting.mix, *copies(*planes[:5])),
            *(
                after(
                    *(splitting.shrink_edges, planes[0], *copies(*pairs[:2]), most),
                    *(np.zeros(COLUMNS), sums(2)),
                )
                for most in (0.4, 2.6)
            ),
            after(
                splitting.shrink_edges,
                *np.zeros((1, 2, 3)),
                *np.zeros((2, 2, 2, 3)),
                0.4,
                np.zeros(3),
                sums(2),
            ),
            after(splitting.keep_positive, *copies(*planes[:3]), 3, 4, sums(3)),
            after(
                splitting.relax_image, *copies(*larger, *planes[:3]), weights, level, ratio, sums(3)
            ),
            after(splitting.weigh_misfit, *planes[:3], weights, level, ratio, sums(2)),
            after(splitting.split_misfit, *copies(*planes[:4]), weights, level, ratio),
        ],
        TIGHT,
    )
