"""
Choosing a transform
====================

The diffraction integral from the wavefront to the point spread function can be computed by several
methods, called transforms. Each is the fastest for some wavefronts and inaccurate for others.
`psf.point_spread` selects one without running the others.
"""

import matplotlib.pyplot as plt

from nlosoptics import psf

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
# The image has 128 x 128 pixels of about one wavelength times the F-number. Markers show the error
# that each transform estimates.

window = {"pitch": 8e-6, "shape": 128, "pixel_integrated": True}
tables = {name: psf.compare(wave, repeats=2, longest=1.0, **window) for name, wave in waves.items()}
figure, axes = plt.subplots(3, 1, figsize=(8.5, 15), layout="constrained")
for axis, (name, table) in zip(axes, tables.items(), strict=True):
    for row in table.rows:
        if row.seconds:
            axis.loglog(row.seconds, max(row.error_estimate, 1e-17), "o", label=row.method)
    axis.axhline(1e-3, linestyle="--")
    axis.set(xlabel="computation time (s)", ylabel="estimated error / peak")
    axis.legend()
    chosen = psf.point_spread(waves[name], **window)
    axis.set_title(f"{name}: auto selects {chosen.method}")
    axis.legend()
plt.show()

# %%
# Result: the dashed line is the requested error. ``method="auto"`` selects the transform with the
# lowest predicted cost among those with a predicted error below this line. The prediction uses only
# the wavefront.

for name, wave in waves.items():
    print(f"{name}: {psf.point_spread(wave, **window).reason}")
