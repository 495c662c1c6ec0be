"""
Choosing a transform
====================

The integral from wave to point spread can be summed in several ways. Each has waves for which it is
the fastest and waves for which it errs. `psf.compare` runs all of them, and `psf.point_spread`
picks one without running the others.
"""

import matplotlib.pyplot as plt

from nlosoptics import psf, views

plt.style.use("tableau-colorblind10")

# %%
# Three waves
# -----------
# Zernike coefficients in metres rms, by Noll's index: none, a quarter of a wave, and two waves of
# defocus with some coma.

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
# All transforms of each
# ----------------------
# On 128 x 128 pixels of one Airy unit. Full markers are the errors that a transform estimates of
# itself, hollow ones its difference from the best. Those that cannot take a wave, or would take
# long, are left out and named.

window = {"pitch": 8e-6, "shape": 128, "pixel_integrated": True}
tables = {name: psf.compare(wave, repeats=2, longest=1.0, **window) for name, wave in waves.items()}
for name, table in tables.items():
    figure, axis = plt.subplots(figsize=(9, 5.6), layout="constrained")
    views.compare_methods(table, tol=1e-3, axes=axis)
    chosen = psf.point_spread(waves[name], **window)
    axis.set_title(f"{name}: auto takes {chosen.method}")
plt.show()

# %%
# What to see: the line is the error that is asked for. What auto takes is the transform that it
# predicts to be the cheapest below it, from the wave alone.

print(tables["2 waves rms"])
for name, wave in waves.items():
    print(f"{name}: {psf.point_spread(wave, **window).reason}")
