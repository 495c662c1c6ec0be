"""Compiled loops of the evidence fit over batches of starts, which read each array only once.

In the shapes of arrays, b counts starts and k images. The padded FFT grid has p x p samples, of
which the first n x n are the image; half spectra have q = p//2 + 1 columns. Arrays are contiguous,
float32 or float64, or complex of the same precision.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def intensity(field, out):
    """Fill ``out`` with the squared modulus of ``field``, (b, k, p, p)."""
    for b in range(field.shape[0]):
        for k in range(field.shape[1]):
            for i in range(field.shape[2]):
                f, o = field[b, k, i], out[b, k, i]
                for j in range(o.size):
                    o[j] = f[j].real * f[j].real + f[j].imag * f[j].imag


@njit(cache=True)
def predict(transfer, pixel, objects, out):
    """Fill ``out`` (b, k, p, q) with the spectra of the predicted images.

    ``transfer`` (b, k, p, q) is multiplied in place by ``pixel`` (k, p, q), which is the transfer
    function of a pixel times the image's weight, and then by the objects' spectra (b, p, q).
    """
    for b in range(transfer.shape[0]):
        for k in range(transfer.shape[1]):
            for i in range(transfer.shape[2]):
                h, m, o, w = transfer[b, k, i], objects[b, i], out[b, k, i], pixel[k, i]
                for j in range(h.size):
                    x = h[j].real * w[j]
                    y = h[j].imag * w[j]
                    h[j] = complex(x, y)
                    o[j] = complex(x * m[j].real - y * m[j].imag, x * m[j].imag + y * m[j].real)


@njit(cache=True)
def residuals(predicted, images, fit_background, squares, background):
    """Subtract the images (k, n, n) from the predictions (b, k, p, p), in place.

    The result is 0 outside the image. If ``fit_background``, its mean is subtracted and stored in
    ``background`` (b, k). ``squares`` (b, k) receives the sums of squares.
    """
    n = images.shape[1]
    zero = predicted.dtype.type(0.0)
    for b in range(predicted.shape[0]):
        for k in range(predicted.shape[1]):
            picture = predicted[b, k]
            level = 0.0
            for i in range(n):
                for j in range(n):
                    picture[i, j] -= images[k, i, j]
                    level += picture[i, j]
                picture[i, n:] = zero
            picture[n:] = zero
            level = level / (n * n) if fit_background else 0.0
            background[b, k] = -level
            shift = predicted.dtype.type(level)
            total = 0.0
            for i in range(n):
                for j in range(n):
                    picture[i, j] -= shift
                    total += picture[i, j] * picture[i, j]
            squares[b, k] = total


@njit(cache=True)
def roughness(objects, variances, kappa, gradient, weights, energy, want_energy):
    """Compute the prior of the objects' differences and its gradient (b, n, n).

    The prior is a Gaussian scale mixture with strength ``kappa``. ``variances`` (b, 2) are
    posterior variances of the differences along x and y, and ``weights`` (b, 2) receives the mean
    weights along x and y. ``energy`` (b,) receives the prior's energy if wanted. Outside the image
    the object is 0.
    """
    count, n = objects.shape[0], objects.shape[1]
    real = objects.dtype.type
    one, kap = real(1.0), real(kappa)
    across = np.empty(n + 1, objects.dtype)
    above = np.empty(n, objects.dtype)
    scale = np.empty(n + 1, objects.dtype)
    for b in range(count):
        vx, vy = variances[b, 0], variances[b, 1]
        sum_x, sum_y, logs = 0.0, 0.0, 0.0
        above[:] = real(0.0)
        for i in range(n + 1):
            if i < n:
                row = objects[b, i]
                across[0] = row[0]
                for j in range(1, n):
                    across[j] = row[j] - row[j - 1]
                across[n] = -row[n - 1]
                for j in range(n + 1):
                    scale[j] = across[j] * across[j] + vx
                if want_energy:
                    for j in range(n + 1):
                        logs += np.log(scale[j])
                for j in range(n + 1):
                    scale[j] = kap * (one / scale[j])
                    sum_x += scale[j]
                for j in range(n + 1):
                    across[j] *= scale[j]
                target = gradient[b, i]
                for j in range(n):
                    target[j] = across[j] - across[j + 1]
            for j in range(n):
                step = (objects[b, i, j] if i < n else real(0.0)) - (
                    objects[b, i - 1, j] if i > 0 else real(0.0)
                )
                q = step * step + vy
                scale[j] = kap * (one / q)
                across[j] = step * scale[j]
                if want_energy:
                    logs += np.log(q)
            for j in range(n):
                sum_y += scale[j]
            if i < n:
                for j in range(n):
                    gradient[b, i, j] += across[j]
            if i > 0:
                for j in range(n):
                    gradient[b, i - 1, j] -= across[j]
        weights[b, 0] = sum_x / (n * (n + 1))
        weights[b, 1] = sum_y / (n * (n + 1))
        energy[b] = kappa * logs


@njit(cache=True)
def spectra(
    transfer, residual, objects, pixel, steps, weights, inverse_variance, share,
    toward_object, variances, energy, want_energy,
):  # fmt: skip
    """Compute the posterior covariance, and the gradients of the energy as half spectra.

    ``residual`` (b, k, p, q) is replaced by the gradient with respect to the transfer function
    without the detector's. ``toward_object`` (b, p, q) receives the gradient with respect to the
    object, and ``variances`` (b, 2) the posterior variances of its differences along x and y.
    ``inverse_variance`` (b,) is 1 over the noise variance and ``share`` the image's fraction of the
    grid. ``energy`` (b,) receives the energy of the covariance if wanted.
    """
    frames, p, q = transfer.shape[1:]
    real = steps.dtype.type
    one, tiny = real(1.0), real(1e-6)
    power = np.empty(q, steps.dtype)
    covariance = np.empty(q, steps.dtype)
    cross_x, cross_y = np.empty(q, steps.dtype), np.empty(q, steps.dtype)
    for b in range(transfer.shape[0]):
        i2 = real(inverse_variance[b])
        data_scale, trace_scale = real(i2 / (p * p)), real(share * i2)
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
                covariance[j] = one / (power[j] * i2 + wx * steps[j] + wy * dy + tiny)
            out = toward_object[b, i]
            for j in range(q):
                out[j] = complex(cross_x[j] * i2, cross_y[j] * i2)
            row_x, row_y = 0.0, 0.0
            for j in range(q):
                row_x += covariance[j] * steps[j]
                row_y += covariance[j]
            # columns 0 and p/2 of a half spectrum count once, all others twice
            last = covariance[q - 1] if p % 2 == 0 else real(0.0)
            sum_x += 2.0 * row_x - covariance[0] * steps[0] - last * steps[q - 1]
            sum_y += (2.0 * row_y - covariance[0] - last) * dy
            if want_energy:
                for j in range(q):
                    times = 1.0 if j == 0 or (p % 2 == 0 and j == q - 1) else 2.0
                    total += times * (power[j] * i2 * covariance[j] - np.log(covariance[j]))
            m = objects[b, i]
            for k in range(frames):
                h, r, w = transfer[b, k, i], residual[b, k, i], pixel[k, i]
                for j in range(q):
                    x, y = r[j].real * data_scale, r[j].imag * data_scale
                    c = trace_scale * covariance[j]
                    gx = x * m[j].real + y * m[j].imag + c * h[j].real
                    gy = y * m[j].real - x * m[j].imag + c * h[j].imag
                    r[j] = complex(gx * w[j], gy * w[j])
        variances[b, 0] = sum_x / (p * p)
        variances[b, 1] = sum_y / (p * p)
        energy[b] = share * total


@njit(cache=True)
def pull_back(field, weight, scale, out):
    """Fill ``out`` (b, k, p, p) with ``field`` times the real ``weight`` times ``scale``.

    This is the gradient of an intensity with respect to its field.
    """
    factor = weight.dtype.type(scale)
    for b in range(field.shape[0]):
        for k in range(field.shape[1]):
            for i in range(field.shape[2]):
                f, w, o = field[b, k, i], weight[b, k, i], out[b, k, i]
                for j in range(w.size):
                    x = w[j] * factor
                    o[j] = complex(f[j].real * x, f[j].imag * x)


@njit(cache=True)
def phase_gradient(pupil, toward, out):
    """Fill ``out`` (b, cells) with the gradient with respect to the pupil's phase.

    ``pupil`` and ``toward`` (b, k, cells) are pupil function and gradient with respect to it. The
    gradients of all images are added.
    """
    for b in range(out.shape[0]):
        out[b] = 0.0
        for k in range(pupil.shape[1]):
            p, g, o = pupil[b, k], toward[b, k], out[b]
            for i in range(o.size):
                o[i] += g[i].imag * p[i].real - g[i].real * p[i].imag


@njit(cache=True)
def softly_positive(free, softness, out):
    """Fill ``out`` with positive values of free parameters x: (x + sqrt(x^2 + softness^2))/2."""
    source, target = free.ravel(), out.ravel()
    square, half = source.dtype.type(softness * softness), source.dtype.type(0.5)
    for i in range(source.size):
        target[i] = half * (source[i] + np.sqrt(source[i] * source[i] + square))


@njit(cache=True)
def object_step(free, data_gradient, prior_gradient, first, second, softness, rate, bias):
    """Make one Adam step on the free parameters (b, n, n) of the objects, in place.

    ``first`` and ``second`` are the moments of the gradient, ``rate`` the step and ``bias`` the
    bias correction of the second moment.
    """
    real = free.dtype.type
    square, half, lr = real(softness * softness), real(0.5), real(rate)
    root_bias, tiny, one = real(1.0 / np.sqrt(bias)), real(1e-10), real(1.0)
    a1, a2, b1, b2 = real(0.9), real(0.99), real(0.1), real(0.01)
    n = free.shape[1]
    for b in range(free.shape[0]):
        for i in range(n):
            x, g, d = free[b, i], prior_gradient[b, i], data_gradient[b, i]
            m, v = first[b, i], second[b, i]
            for j in range(n):
                slope = half * (one + x[j] / np.sqrt(x[j] * x[j] + square))
                step = (g[j] + d[j]) * slope
                m[j] = a1 * m[j] + b1 * step
                v[j] = a2 * v[j] + b2 * step * step
                x[j] -= lr * m[j] / (np.sqrt(v[j]) * root_bias + tiny)
