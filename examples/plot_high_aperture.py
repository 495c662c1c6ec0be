"""
Fast beams and polarised light
==============================

A lens with a large aperture brings rays together at large angles, so that the directions of their
electric fields matter. `psf.point_spread` bounds the error of the scalar model, which neglects
this, and uses vector diffraction if the tolerance requires it.
"""

import matplotlib.pyplot as plt
import numpy as np

from nlosoptics import psf

plt.style.use("nlosoptics.views.palette")

# %%
# A focus at F/0.7
# ----------------
# Light that is polarised along x has a longer spot along x, because the rays at the rim turn the
# field toward the axis.

wavelength, radius = 633e-9, 5e-3


def wave_at(f_number):
    return psf.Wavefront.from_zernike(
        {}, wavelength=wavelength, pupil_radius=radius, image_distance=2 * radius * f_number
    )


window = {"pitch": wavelength / 20, "shape": 65, "normalisation": "ideal-peak"}
spots = {
    "scalar": psf.point_spread(wave_at(0.7), model="scalar", **window),
    "unpolarised": psf.point_spread(wave_at(0.7), **window),
    "polarised along x": psf.point_spread(wave_at(0.7), polarisation="x", **window),
}
figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
for axis, (name, spot) in zip(axes, spots.items(), strict=True):
    edges = 1e6 * np.array([spot.x[0], spot.x[-1], spot.y[0], spot.y[-1]])
    shown = axis.imshow(np.sqrt(spot.intensity), origin="lower", extent=edges, vmin=0, vmax=1)
    axis.set(title=name, xlabel="x (µm)", ylabel="y (µm)")
figure.colorbar(shown, ax=axes, shrink=0.8, label="square root of intensity / ideal peak")
plt.show()

# %%
# The error of the scalar model
# -----------------------------
# Every scalar point spread states a bound of the error of the scalar model. The bound is larger for
# values that add up to 1 over the image plane than for values relative to the ideal peak.

f_numbers = np.geomspace(0.55, 16, 16)
figure, axis = plt.subplots(figsize=(5.1, 3.9), layout="constrained")
for normalisation in ("unit-sum", "ideal-peak"):
    bounds = [
        psf.point_spread(
            wave_at(n),
            method="airy",
            pitch=wavelength * n / 4,
            shape=65,
            normalisation=normalisation,
        ).model_error
        for n in f_numbers
    ]
    axis.loglog(f_numbers, bounds, "o-", label=normalisation)
axis.set(xlabel="F-number", ylabel="bound of the error / peak", title="error of the scalar model")
axis.legend(title="normalisation")
plt.show()

# %%
# Result: widths of the spots, in nm.

for name, spot in spots.items():
    across, up = (1e9 * width for width in psf.fwhm(spot))
    print(f"{name}: {across:.0f} along x, {up:.0f} along y, {spot.model} model")
