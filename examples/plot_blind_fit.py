"""
Object and wall from two pictures
=================================

Where the wall's shape is not known, one picture seldom tells it: a blurred letter off a perfect
wall explains it as well as a sharp letter off a bad one. A second picture with a known change of
focus breaks the tie, because the same wall must explain both.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from nlosoptics import inverse, psf

plt.style.use("tableau-colorblind10")

# %%
# Two pictures
# ------------
# A letter by a wall of 0.4 waves rms in twelve Zernike modes, drawn at random, with 1 % of noise.
# The second picture is half a wave rms out of focus. The pictures are made on a frame twice as
# large as the one that is fitted.

wavelength = 632.8e-9
modes = tuple(range(4, 16))
optics = {
    "wavelength": wavelength,
    "pupil_radius": 0.9e-3,
    "image_distance": 51.2e-3,
    "pitch": 9e-6,
    "pixel_integrated": True,
}
size = 32
letter = np.zeros((size, size))
letter[8:24, 10:14] = letter[20:24, 10:20] = letter[14:17, 12:20] = 1.0

random = np.random.default_rng(3)
wall = random.normal(size=len(modes))
wall *= 0.4 / np.linalg.norm(wall)
defocus = np.array([0.0, 0.5 * wavelength])

wide = inverse.PupilPSF.from_zernike(modes, shape=2 * size, dtype=torch.float64, **optics)
with torch.no_grad():
    seen = wide.image(torch.from_numpy(letter), torch.from_numpy(wall), defocus=defocus).numpy()
noise = 0.01 * seen.max()
pictures = seen + noise * random.normal(size=seen.shape)

# %%
# The fit
# -------
# `inverse.evidence_fit` starts from random walls and compares them by the evidence of the
# pictures, with the object integrated out. It is told the modes, the lengths and the defocus; not
# the wall, and not the letter.

pupil = inverse.PupilPSF.from_zernike(modes, shape=size, **optics)
found = inverse.evidence_fit(
    pictures, pupil, defocus=defocus, noise_sigma=noise, max_iterations=1, seed=1
)
fitted = found.physical_parameters["coefficients"]

# %%
# Look
# ----
# Rows are drawn as the eye reads the letter.

figure, axes = plt.subplots(1, 5, figsize=(17, 3.4), layout="constrained")
panels = {
    "truth": letter,
    "picture in focus": pictures[0],
    "picture out of focus": pictures[1],
    f"found: {found.status}": found.object,
}
for axis, (title, values) in zip(axes, panels.items(), strict=False):
    shown = axis.imshow(values, cmap="gray", origin="lower")
    axis.set(title=title, xlabel="column (pixels)")
    figure.colorbar(shown, ax=axis, shrink=0.8, label="relative brightness")
axes[0].set_ylabel("row (pixels)")
axes[4].bar(np.array(modes) - 0.2, wall, 0.4, label="true wall")
axes[4].bar(np.array(modes) + 0.2, fitted, 0.4, label="found")
axes[4].set(xlabel="Zernike mode (Noll)", ylabel="coefficient (waves rms)", xticks=modes[::2])
axes[4].legend(fontsize=8)
plt.show()

# %%
# What to see:

wave = psf.Wavefront.from_zernike(
    dict(zip(modes, (fitted - wall) * wavelength, strict=True)),
    wavelength=wavelength,
    pupil_radius=optics["pupil_radius"],
    image_distance=optics["image_distance"],
)
correlation = inverse.registered_correlation(found, letter)
print(
    f"The letter correlates with the truth to {correlation:.3f}, where the picture in focus has "
    f"{inverse.registered_correlation(pictures[0], letter):.3f}. The wall is found to "
    f"{psf.rms_aberration(wave) / wavelength:.3f} waves rms of its {np.linalg.norm(wall):.1f}, "
    f"status {found.status}."
)
