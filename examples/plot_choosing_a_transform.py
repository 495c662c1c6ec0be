"""
Choosing a transform
====================

The diffraction integral from the wavefront to the point spread function can be computed by several
methods, called transforms. Each is the fastest for some wavefronts and inaccurate for others.
`psf.point_spread` selects one without running the others.
"""

import time

import matplotlib.pyplot as plt

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
# error that each transform estimates. Hollow markers show its difference from `quadrature`, the
# most accurate one. A transform that is not valid for a wavefront says so.

window = {"pitch": 8e-6, "shape": 128, "pixel_integrated": True}
methods = ("airy", "fft", "mdft", "quadrature", "nufft", "geometric")
figure, axes = plt.subplots(3, 1, figsize=(7, 12), layout="constrained")
for axis, (name, wave) in zip(axes, waves.items(), strict=True):
    best = psf.point_spread(wave, method="quadrature", **window).intensity
    for number, method in enumerate(methods):
        try:
            psf.point_spread(wave, method=method, **window)  # loads compiled code
            start = time.perf_counter()
            spread = psf.point_spread(wave, method=method, **window)
            seconds = time.perf_counter() - start
        except SamplingError as error:
            print(f"{name}, {method}: {error}")
            continue
        difference = abs(spread.intensity - best).max() / best.max()
        colour = f"C{number}"
        axis.loglog(seconds, max(spread.error_estimate, 1e-17), "o", color=colour, label=method)
        axis.loglog(seconds, max(difference, 1e-17), "o", color=colour, fillstyle="none")
    axis.axhline(1e-3, color="grey", linestyle="--")
    chosen = psf.point_spread(wave, **window)
    axis.set(xlabel="computation time (s)", ylabel="error, max |dI| / max I")
    axis.set_title(f"{name}: auto selects {chosen.method}")
    axis.legend()
plt.show()

# %%
# Result: the dashed line is the requested error. ``method="auto"`` selects the transform with the
# lowest predicted cost among those with a predicted error below this line. The prediction uses only
# the wavefront.

for name, wave in waves.items():
    print(f"{name}: {psf.point_spread(wave, **window).reason}")
