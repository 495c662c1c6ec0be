"""
Object and wall from two images
===============================

If the shape of the wall is unknown, one image is rarely enough: a blurred letter and a perfect wall
explain it as well as a sharp letter and an aberrated wall. A second image with a known defocus
resolves the ambiguity, because the same wall must explain both images.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from nlosoptics import imaging, inverse, psf

plt.style.use("nlosoptics.views.palette")

# %%
# Two images
# ----------
# The wall adds a random aberration of 0.4 wavelengths (waves) rms in twelve Zernike modes. The
# images have 1 % noise, and the second one is defocused by half a wave rms. They are simulated on a
# grid twice as large as that of the fit, so that simulation and fit use different models.

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
    spreads = wide(torch.from_numpy(wall), defocus=defocus).numpy()
seen = np.stack([imaging.ForwardModel(s, shape=letter.shape).forward(letter) for s in spreads])
noise = 0.01 * seen.max()
pictures = seen + noise * random.normal(size=seen.shape)

# %%
# The fit
# -------
# `inverse.evidence_fit` starts from random walls and compares them by their Bayesian evidence: the
# probability of the images for this wall, summed over all objects. It knows the set of modes, the
# optical system and the defocus, but neither the wall nor the letter.

pupil = inverse.PupilPSF.from_zernike(modes, shape=size, **optics)
found = inverse.evidence_fit(
    inverse.Measurement(pictures, noise_sigma=noise),
    pupil,
    defocus=defocus,
    max_iterations=1,
    seed=1,
)
fitted = found.physical_parameters["coefficients"]

# %%
# Images and fit
# --------------
# Rows are drawn upward, so that the letter is upright.

figure, axes = plt.subplot_mosaic("ab;cd;ee", figsize=(9.5, 10), layout="constrained")
panels = {
    "ground truth": letter,
    "image in focus": pictures[0],
    "image with defocus": pictures[1],
    f"reconstruction, {found.status}": found.object,
}
for axis, (title, values) in zip(axes.values(), panels.items(), strict=False):
    shown = axis.imshow(values, cmap="gray", origin="lower")
    axis.set(title=title, xlabel="column (pixels)", ylabel="row (pixels)")
    figure.colorbar(shown, ax=axis, shrink=0.8, label="relative brightness")
axes["e"].bar(np.array(modes) - 0.2, wall, 0.4, label="true wall")
axes["e"].bar(np.array(modes) + 0.2, fitted, 0.4, label="fitted wall")
axes["e"].set(xlabel="Zernike mode (Noll)", ylabel="coefficient (waves rms)", xticks=modes[::2])
axes["e"].set_title("aberration of the wall")
axes["e"].legend(loc="upper left", bbox_to_anchor=(0.3, 1.0))
plt.show()

# %%
# Result:

wave = psf.Wavefront.from_zernike(
    dict(zip(modes, (fitted - wall) * wavelength, strict=True)),
    wavelength=wavelength,
    pupil_radius=optics["pupil_radius"],
    image_distance=optics["image_distance"],
)
correlation = inverse.registered_correlation(found, letter)
print(
    f"The reconstruction correlates with the ground truth by {correlation:.3f}, the image in focus "
    f"by {inverse.registered_correlation(pictures[0], letter):.3f}. The error of the fitted "
    f"aberration is {psf.rms_aberration(wave) / wavelength:.3f} waves rms, for a wall of "
    f"{np.linalg.norm(wall):.1f} waves rms. The fit ends with status {found.status}."
)
