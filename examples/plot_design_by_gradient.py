"""
A design by gradient
====================

Which stop, focus and wall show fine lines of a hidden object best? A wider stop collects more
light, but light from a curved wall is blurred by aberration. `inverse.SceneModel` gives a figure of
merit of the scene its gradient, and scipy's L-BFGS-B follows it.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy
import torch

import nlosoptics as nlos
from nlosoptics import inverse, psf

plt.style.use("nlosoptics.views.palette")

# %%
# Figure of merit
# ---------------
# The light of the image grows with the area of the stop, and its photon noise with the diameter.
# The signal-to-noise ratio of lines is thus proportional to the diameter times the modulation
# transfer function (MTF). There are 60 lines per millimetre on the detector, along both
# axes. Any function of a scene can be such a figure.

scenes = Path(__file__).parent / "scenes"
start = {"camera.stop_diameter": 4e-3, "camera.focus_distance": 2.4}
scene = nlos.Scene.load(scenes / "letter_concave.toml").with_values(start)
seen = []


def lines(scene):
    """Logarithm of the signal-to-noise ratio of lines; 0 for a stop of 1 mm without blur."""
    seen.append((scene.camera.focus_distance, scene.camera.stop_diameter))
    spread = psf.scene_point_spread(scene, 1e-4, pitch=6e-6, shape=201).point_spread
    wave = np.exp(2j * np.pi * 60e3 * spread.x)
    contrasts = [abs(spread.intensity.sum(axis=axis) @ wave) for axis in (0, 1)]
    return np.log(scene.camera.stop_diameter / 1e-3) + np.mean(np.log(contrasts))


# %%
# The search
# ----------
# Free values are named by their addresses, with a scale for each. The optimiser works with offsets
# in units of the scales; the stop stays between 1 and 12 mm.

model = inverse.SceneModel(scene, {"camera.stop_diameter": 2e-3, "camera.focus_distance": 0.3})
path = []


def loss(offsets):
    model.offsets.data, model.offsets.grad = torch.tensor(offsets), None
    merit = model.evaluate(lines)
    (-merit).backward()
    path.append((model.values["camera.focus_distance"], model.values["camera.stop_diameter"]))
    return -merit.item(), model.offsets.grad.numpy()


limits = scipy.optimize.Bounds([-1.5, -2.5], [4.0, 5.0])
best = scipy.optimize.minimize(loss, [0.0, 0.0], jac=True, method="L-BFGS-B", bounds=limits)
images = len(seen)

# %%
# All designs, for comparison
# ---------------------------
# The figure on a grid of focus distances and stops, and the path of the search.

focus, stop = np.linspace(1.7, 3.9, 23), np.linspace(1e-3, 12e-3, 16)
grid = [
    [
        lines(scene.with_values({"camera.stop_diameter": d, "camera.focus_distance": f}))
        for f in focus
    ]
    for d in stop
]
figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
levels = axes.contourf(focus, 1e3 * stop, np.exp(grid), 20)
figure.colorbar(levels, label="signal-to-noise ratio of lines, a.u.")
way = np.array(path)
axes.plot(way[:, 0], 1e3 * way[:, 1], "o-", color="white", markersize=4)
axes.plot(*(way[-1] * [1, 1e3]), "*", color="white", markersize=14)
axes.set(xlabel="focus distance, m", ylabel="diameter of the stop, mm")
plt.show()

# %%
# Result:

first = np.exp(-loss(np.zeros(2))[0])
print(
    f"From {first:.2f} to {np.exp(-best.fun):.2f} in {best.nfev} steps, for which {images} point "
    f"spreads are computed: focus at {way[-1, 0]:.3f} m and a stop of {1e3 * way[-1, 1]:.2f} mm. "
    f"The best of {np.size(grid)} designs on the grid has {np.exp(np.max(grid)):.2f}."
)
