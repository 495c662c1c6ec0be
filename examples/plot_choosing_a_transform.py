"""
Choosing a transform
====================

The diffraction integral from the wavefront to the point spread function can be computed by several
methods, called transforms. Each is the fastest for some wavefronts and inaccurate for others.
`psf.point_spread` selects one without running the others.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

from nlosoptics import psf
from nlosoptics.errors import SamplingError

plt.style.use("nlosoptics.views.palette")

# %%
# Three wavefronts
# ----------------
# Zernike coefficients in metres rms, by Noll index: no aberration, a quarter of a wavelength, and
# two wavelengths of defocus with some coma.

wavelength = 632.8e-9
coefficients = {
    "no aberration": {4: 0.0},
    "0.25 waves rms": {4: 0.2 * wavelength, 8: 0.15 * wavelength},
    "2 waves rms": {4: 2.0 * wavelength, 8: 0.3 * wavelength},
}
waves = {
    name: psf.Wavefront.from_zernike(
        terms, wavelength=wavelength, pupil_radius=2e-3, image_distance=50e-3
    )
    for name, terms in coefficients.items()
}

# %%
# All transforms
# --------------
# The image has 128 x 128 pixels of about one wavelength times the F-number. Filled markers show the
# error that each transform estimates. Hollow markers show its difference from ``quadrature``, the
# most accurate one. Transforms that are not valid for a wavefront are left out.

window = {"pitch": 8e-6, "shape": 128, "pixel_integrated": True, "tol": 1e-3}
figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained", sharey=True)
for axis, (name, wave) in zip(axes, waves.items(), strict=True):
    exact = psf.point_spread(wave, method="quadrature", **window).intensity
    for method in ("airy", "fft", "quadrature"):
        try:
            psf.point_spread(wave, method=method, **window)  # fills the caches
            start = time.perf_counter()
            spread = psf.point_spread(wave, method=method, **window)
            seconds = time.perf_counter() - start
        except SamplingError as refusal:
            print(f"{name}, {method}: {refusal}")
            continue
        (filled,) = axis.loglog(seconds, spread.error_estimate, "o", label=method)
        difference = np.abs(spread.intensity - exact).max() / exact.max()
        if difference > 0:
            axis.loglog(seconds, difference, "o", mfc="none", color=filled.get_color())
    axis.axhline(1e-3, linestyle="--", color="0.5")
    chosen = psf.point_spread(wave, **window)
    axis.set(title=f"{name}: auto selects {chosen.method}", xlabel="time (s)")
    axis.legend()
axes[0].set_ylabel("error / peak")
plt.show()

# %%
# Result: the dashed line is the requested error. ``method="auto"`` selects the transform with the
# lowest predicted cost among those with a predicted error below this line. The prediction uses only
# the wavefront.

for name, wave in waves.items():
    print(f"{name}: {psf.point_spread(wave, **window).reason}")
