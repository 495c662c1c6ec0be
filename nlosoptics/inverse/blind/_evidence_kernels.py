"""Compiled loops of the evidence fit over batches of starts, which read each array only once.

In the shapes of arrays, b counts starts and k images. The padded FFT grid has p x c
samples, of which the first n x m are the image; half spectra have q = c//2 + 1 columns, and c is
even. Arrays are contiguous, float32 or float64, or complex of the same precision.
"""

from __future__ import annotations

import numpy as np

from ...kernels.compiling import njit


@njit(cache=True, nogil=True)
def roughness(objects, variances, kappa, gradient, weights, energy, want_energy):
    """Compute the prior of the objects' differences and its gradient (b, n, m).

    The prior is a Gaussian scale mixture with strength ``kappa``. ``variances`` (b, 2) are
    posterior variances of the differences along x and y, and ``weights`` (b, 2) receives the mean
    weights along x and y. ``energy`` (b,) receives the prior's energy if wanted. Outside the image
    the object is 0.
    """
    count, n, m = objects.shape
    real = objects.dtype.type
    one, kap = real(1.0), real(kappa)
    across = np.empty(m + 1, objects.dtype)
    scale = np.empty(m + 1, objects.dtype)
    for b in range(count):
        vx, vy = variances[b, 0], variances[b, 1]
        sum_x, sum_y, logs = 0.0, 0.0, 0.0
        for i in range(n + 1):
            if i < n:
                row = objects[b, i]
                across[0] = row[0]
                for j in range(1, m):
                    across[j] = row[j] - row[j - 1]
                across[m] = -row[m - 1]
                for j in range(m + 1):
                    scale[j] = across[j] * across[j] + vx
                if want_energy:
                    for j in range(m + 1):
                        logs += np.log(scale[j])
                for j in range(m + 1):
                    scale[j] = kap * (one / scale[j])
                    sum_x += scale[j]
                for j in range(m + 1):
                    across[j] *= scale[j]
                target = gradient[b, i]
                for j in range(m):
                    target[j] = across[j] - across[j + 1]
            for j in range(m):
                step = (objects[b, i, j] if i < n else real(0.0)) - (
                    objects[b, i - 1, j] if i > 0 else real(0.0)
                )
                q = step * step + vy
                scale[j] = kap * (one / q)
                across[j] = step * scale[j]
                if want_energy:
                    logs += np.log(q)
            for j in range(m):
                sum_y += scale[j]
            if i < n:
                for j in range(m):
                    gradient[b, i, j] += across[j]
            if i > 0:
                for j in range(m):
                    gradient[b, i - 1, j] -= across[j]
        weights[b, 0] = sum_x / (n * (m + 1))
        weights[b, 1] = sum_y / ((n + 1) * m)
        energy[b] = kappa * logs


@njit(cache=True, nogil=True)
def spectra(
    transfer, residual, objects, pixel, gains, steps, weights, inverse_variance, share,
    toward_object, variances, energy, want_energy,
):  # fmt: skip
    """Compute the posterior covariance, and the gradients of the energy as half spectra.

    ``residual`` (b, k, p, q) is replaced by the gradient with respect to the transfer function
    without the detector's. ``toward_object`` (b, p, q) receives the gradient with respect to the
    object, and ``variances`` (b, 2) the posterior variances of its differences along x and y.
    ``steps`` (p + c,) are the squared transfer functions of the differences along y, then x.
    ``inverse_variance`` (b,) is 1 over the noise variance and ``share`` the image's fraction of the
    grid. ``energy`` (b,) receives the energy of the covariance if wanted.
    """
    frames, p, q = transfer.shape[1:]
    columns, along = steps[p:], 2 * (q - 1)
    real = steps.dtype.type
    one, tiny = real(1.0), real(1e-6)
    power = np.empty(q, steps.dtype)
    covariance = np.empty(q, steps.dtype)
    cross_x, cross_y = np.empty(q, steps.dtype), np.empty(q, steps.dtype)
    for b in range(transfer.shape[0]):
        i2 = real(inverse_variance[b])
        data_scale, trace_scale = real(i2 / (p * along)), real(share * i2)
        wx, wy = real(weights[b, 0]), real(weights[b, 1])
        sum_x, sum_y, total = 0.0, 0.0, 0.0
        for i in range(p):
            power[:] = real(0.0)
            cross_x[:] = real(0.0)
            cross_y[:] = real(0.0)
            for k in range(frames):
                h, r = transfer[b, k, i], residual[b, k, i]
                for j in range(q):
                    power[j] += h[j].real * h[j].real + h[j].imag * h[j].imag
                    cross_x[j] += h[j].real * r[j].real + h[j].imag * r[j].imag
                    cross_y[j] += h[j].real * r[j].imag - h[j].imag * r[j].real
            dy = steps[i]
            for j in range(q):
                covariance[j] = one / (power[j] * i2 + wx * columns[j] + wy * dy + tiny)
            out = toward_object[b, i]
            for j in range(q):
                out[j] = complex(cross_x[j] * i2, cross_y[j] * i2)
            row_x, row_y = 0.0, 0.0
            for j in range(q):
                row_x += covariance[j] * columns[j]
                row_y += covariance[j]
            # the first and last columns of a half spectrum count once, all others twice
            last = covariance[q - 1]
            sum_x += 2.0 * row_x - covariance[0] * columns[0] - last * columns[q - 1]
            sum_y += (2.0 * row_y - covariance[0] - last) * dy
            if want_energy:
                for j in range(q):
                    times = 1.0 if j == 0 or j == q - 1 else 2.0
                    total += times * (power[j] * i2 * covariance[j] - np.log(covariance[j]))
            m = objects[b, i]
            for k in range(frames):
                h, r, w = transfer[b, k, i], residual[b, k, i], pixel[k, i]
                gain = real(gains[b, k])
                for j in range(q):
                    x, y = r[j].real * data_scale, r[j].imag * data_scale
                    c = trace_scale * covariance[j]
                    gx = x * m[j].real + y * m[j].imag + c * h[j].real
                    gy = y * m[j].real - x * m[j].imag + c * h[j].imag
                    r[j] = complex(gx * gain * w[j], gy * gain * w[j])
        variances[b, 0] = sum_x / (p * along)
        variances[b, 1] = sum_y / (p * along)
        energy[b] = share * total


@njit(cache=True, nogil=True)
def object_step(free, data_gradient, prior_gradient, first, second, softness, rate, bias):
    """Make one Adam step on the free parameters (b, n, m) of the objects, in place.

    Objects are (x + sqrt(x^2 + s^2))/2 for parameters x and ``softness`` s. ``first`` and
    ``second`` are the moments of the gradient, ``rate`` the step and ``bias`` the bias correction
    of the second moment.
    """
    real = free.dtype.type
    square, half, lr = real(softness * softness), real(0.5), real(rate)
    root_bias, tiny, one = real(1.0 / np.sqrt(bias)), real(1e-10), real(1.0)
    a1, a2, b1, b2 = real(0.9), real(0.99), real(0.1), real(0.01)
    n, m = free.shape[1:]
    for b in range(free.shape[0]):
        for i in range(n):
            x, g, d = free[b, i], prior_gradient[b, i], data_gradient[b, i]
            u, v = first[b, i], second[b, i]
            for j in range(m):
                slope = half * (one + x[j] / np.sqrt(x[j] * x[j] + square))
                step = (g[j] + d[j]) * slope
                u[j] = a1 * u[j] + b1 * step
                v[j] = a2 * v[j] + b2 * step * step
                x[j] -= lr * u[j] / (np.sqrt(v[j]) * root_bias + tiny)
