"""
Choosing a transform
====================

The integral from wave to point spread can be summed in several ways. Each has waves for which it is
the fastest and waves for which it errs. `psf.compare` runs all of them, and `psf.point_spread`
picks one without running the others.
"""

import matplotlib.pyplot as plt

from nlosoptics import psf

plt.style.use("tableau-colorblind10")

# %%
# Three waves
# -----------
# Zernike coefficients in metres rms, by Noll's index: none, a quarter of a wave, and four waves of
# defocus with some coma.

wavelength = 632.8e-9
coefficients = {
    "no aberration": {4: 0.0},
    "0.25 waves rms": {4: 0.2 * wavelength, 8: 0.15 * wavelength},
    "4 waves rms": {4: 4.0 * wavelength, 8: 0.5 * wavelength},
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
# On 320 x 320 pixels of half an Airy unit. Every point is one transform: how long it took, and the
# error that it estimates of itself. Those that cannot take a wave, or would take long, are left out.

window = {"pitch": 4e-6, "shape": 320, "pixel_integrated": True}
tables = {name: psf.compare(wave, repeats=3, longest=1.0, **window) for name, wave in waves.items()}
markers = {"quadrature": "o", "fft": "s", "mdft": "^", "nufft": "D", "airy": "*", "geometric": "P"}
figure, axes = plt.subplots(1, 3, figsize=(14.5, 4.6), layout="constrained", sharey=True)
for (name, table), axis in zip(tables.items(), axes, strict=True):
    for row in table.rows:
        if row.seconds is not None:
            number = list(markers).index(row.method)
            axis.loglog(
                row.seconds,
                max(row.error_estimate, 1e-16),
                markers[row.method],
                color=f"C{number}",
                ms=10,
                label=row.method,
            )
    axis.axhline(1e-3, color="0.5", lw=1)
    chosen = psf.point_spread(waves[name], **window)
    axis.set(title=f"{name}: auto takes {chosen.method}", xlabel="seconds")
    axis.legend(fontsize=8)
axes[0].set_ylabel("estimated error, of the peak")
plt.show()

# %%
# What to see: the grey line is the error that is asked for, and the cheapest transform below it is
# taken. The table has what the figure cannot say.

print(tables["4 waves rms"])
for name, wave in waves.items():
    print(f"{name}: {psf.point_spread(wave, **window).reason}")
