"""
An occluder found by gradient
=============================

A matt wall shows a hidden object by the shadows that an occluder casts. Its shape decides how many
independent patterns of the object, the modes, exceed the noise. Here a disc of 12 cm is cut into 16
discs of 3 cm, which together have the same area. Where should they be?
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy
import torch
import trimesh
from matplotlib.patches import Circle

import nlosoptics as nlos
from nlosoptics import imaging, limits

plt.style.use("nlosoptics.views.palette")

# %%
# Scene and discs
# ---------------
# The discs lie in the plane of the old one, half way between the object and the wall. They may be
# printed on a sheet of glass. Gaps of less than 1 cm are not allowed.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_disc.toml").resized(64)
scene = scene.with_values({"camera.exposure": 0.08})
count, radius, gap = 16, 0.015, 0.01
turns = 2 * np.pi * np.arange(24) / 24
rim = np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
rim *= radius * np.sqrt(np.pi / 12 / np.sin(np.pi / 12))  # a polygon of the disc's area
faces = [(24, k, (k + 1) % 24) for k in range(24)]


def discs(places):
    """Meshes of discs around places (n, 2) in the plane."""
    centres = np.column_stack([places, np.full(len(places), 0.5)])
    return tuple(
        trimesh.Trimesh([*(rim + centre), centre], faces, process=False) for centre in centres
    )


# %%
# Figure of merit
# ---------------
# The electrons in the pixels are a matrix times the reflectances of the object's cells. Divided by
# the noise, its singular values v are signal-to-noise ratios of independent patterns, here for
# variations of 0.3 about a mean reflectance of 0.35. The modes are those with v > 1. This number
# has no gradient; the sum of log(1 + v^2), twice the information in the image, has one.
#
# torch differentiates this sum by the elements of the matrix. `pose_gradient` goes on from there to
# the places of all discs: the shadows have exact edges, and thus exact derivatives. All 32
# derivatives together take about as long as the matrix.

coarse = imaging.WallTransport(scene, cells=(12, 12), pixels=(12, 12), samples=9)
camera = scene.camera
readout = camera.read_noise**2 + (camera.full_well / 2**camera.bit_depth) ** 2 / 12
readout = (readout + camera.dark_current * camera.exposure) * camera.pixels[0] * camera.pixels[1]


def ratios(matrix):
    """Return squared signal-to-noise ratios of the modes."""
    noise = torch.sqrt(0.35 * matrix.sum(axis=1) + readout / len(matrix))
    signal = 0.3 * matrix / noise[:, None]
    return torch.linalg.eigvalsh(signal.T @ signal).clamp(min=1e-9).flip(0)


def information(places):
    """Return the figure of merit and its gradient (n, 2)."""
    transport = coarse.with_occluders(discs(places))
    matrix = torch.tensor(transport.matrix, requires_grad=True)
    total = torch.log1p(ratios(matrix)).sum()
    total.backward()
    return total.item(), transport.pose_gradient(matrix.grad)[:, :2]


# %%
# The search
# ----------
# It begins with a grid, which is a poor choice: its shadows repeat, and patterns of the object with
# the same period are seen everywhere, others nowhere. A penalty keeps the discs apart.

first, second = np.triu_indices(count, 1)


def loss(offsets):
    places = 0.03 * offsets.reshape(-1, 2)
    merit, rates = information(places)
    apart = places[first] - places[second]
    distances = np.hypot(*apart.T)
    missing = np.maximum(2 * radius + gap + 1e-4 - distances, 0.0) / gap
    push = 2 * (missing / gap / distances)[:, None] * apart
    slope = -rates / 100
    np.add.at(slope, first, -push)
    np.add.at(slope, second, push)
    return np.sum(missing**2) - merit / 100, 0.03 * slope.ravel()


lines = (np.arange(4) - 1.5) * 0.045
grid = np.stack(np.meshgrid(lines + 0.01, lines + 0.05), axis=-1).reshape(-1, 2)
grid += np.random.default_rng(0).normal(0.0, 0.002, grid.shape)  # no symmetry
found = scipy.optimize.minimize(
    loss, grid.ravel() / 0.03, jac=True, method="L-BFGS-B", options={"maxiter": 40}
)
design = 0.03 * found.x.reshape(-1, 2)

# %%
# What it brings
# --------------
# The modes of each occluder, by `limits.feasibility`; the signal-to-noise ratios, now of 24 x 24
# cells in all pixels; and the letter that `inverse.shadow_fit` reads off a noisy image.

shapes = {
    "one disc": (scene.occluders, [[0.01, 0.05]], 0.06),
    "grid": (discs(grid), grid, radius),
    "found by gradient": (discs(design), design, radius),
}
fine = imaging.WallTransport(scene, cells=(24, 24))
figure, axes = plt.subplots(2, 4, figsize=(12, 6), layout="constrained")
axes[1, 3].imshow(scene.hidden.reflectance)
axes[1, 3].set(title="letter", xticks=[], yticks=[])
for (name, (occluders, places, size)), top, below in zip(
    shapes.items(), axes[0], axes[1], strict=False
):
    shaded = replace(scene, occluders=occluders)
    for place in places:
        top.add_patch(Circle(100 * np.array(place), 100 * size, color="black"))
    modes = limits.feasibility(shaded).diffuse_modes
    top.set(title=f"{name}: {modes} modes", xlim=(-18, 20), ylim=(-14, 24), aspect="equal")
    top.set(xlabel="x, cm", ylabel="y, cm")
    below.imshow(nlos.simulate(shaded, reconstruct=True).reconstruction.object)
    below.set(xticks=[], yticks=[])
    values = ratios(torch.tensor(fine.with_occluders(occluders).matrix)).sqrt()
    axes[0, 3].semilogy(values, label=name)
    print(f"{name}: {modes} modes above the noise")
axes[0, 3].axhline(1.0, color="grey", linewidth=0.8)
axes[0, 3].set(xlabel="pattern", ylabel="signal over noise", ylim=(0.1, None))
axes[0, 3].legend()
plt.show()

# %%
# Result:

nearest = np.hypot(*(design[first] - design[second]).T).min() - 2 * radius
print(f"{found.nfev} steps; the smallest gap is {1e3 * nearest:.1f} mm")
