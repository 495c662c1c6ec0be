"""
Light traps in a creased wall
=============================

Light that falls into a crease of the wall meets the wall again before it leaves, and each
reflection absorbs a part of it. A creased wall is therefore darker than a flat wall of the same
paint. Ray tracing gives this loss and the number of reflections.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import raytrace, scene

plt.style.use("nlosoptics.views.palette")

# %%
# Creases from shallow to steep
# -----------------------------
# The wall is a cosine of 20 mm period. A depth of one period, peak to valley, means slopes up to
# :math:`\pi`. A beam of 1 W illuminates 40 periods at normal incidence. The hidden object is a
# black speck, so that no light returns from it. `raytrace.trace` returns a power balance. Its entry
# "absorbed by wall" is the loss, and all other light leaves the wall. With ``analog=True`` rays
# propagate as physical light, so that their reflections can be counted.

room = nlos.Scene.load(Path(__file__).parent / "scenes" / "letter_wavy.toml")
beam = replace(room.laser, power=1.0, beam_diameter=0.8, position=(0, 0, 1.2), aim=(0, 0, 0))
speck = scene.PlanarObject(np.zeros((2, 2)), 1e-6, position=(0.6, 0, 0.8))
depths = np.array([0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0])  # periods, peak to valley
found = {}
for albedo in (0.75, 0.9):
    room = replace(room, laser=beam, hidden=speck, wall_material=scene.Lambert(albedo))
    walls = [scene.WavyWall(depth * 10e-3, 20e-3, size=(2.0, 2.0)) for depth in depths]
    options = {"n_rays": 8192, "max_bounces": 40, "analog": True, "keep_paths": True}
    found[albedo] = [raytrace.trace(replace(room, wall=wall), **options) for wall in walls]

# %%
# A formula without rays
# ----------------------
# Let r be the area of the wall divided by that of its flat projection. If every reflection started
# at a random position on this area, a fraction 1/r of the reflected light would leave. The sum over
# all reflections is an albedo of :math:`\rho / [\rho + (1 - \rho) r]`. In a spherical hollow, which
# illuminates itself evenly, this is exact. At the bottom of a deep crease a smaller fraction leaves
# than at its edge, so that the light stays longer than the formula assumes.

slopes = np.pi * depths[:, None] * np.sin(np.linspace(0.0, 2 * np.pi, 256, endpoint=False))
r = np.sqrt(1.0 + slopes**2).mean(axis=1)
formula = {albedo: 1.0 - albedo / (albedo + (1.0 - albedo) * r) for albedo in found}

# %%
# Loss and number of reflections
# ------------------------------
# Left: loss by rays, with error bars of two standard errors, and by the formula. Right: where the
# light goes.

figure, axes = plt.subplots(1, 2, figsize=(11.5, 4.4), layout="constrained")
for (albedo, traced), colour in zip(found.items(), ("C0", "C1"), strict=True):
    loss = [paths.ledger["absorbed by wall"] for paths in traced]
    bars = [2 * paths.ledger_error["absorbed by wall"] for paths in traced]
    axes[0].plot(depths, formula[albedo], color=colour, label=f"formula, albedo {albedo}")
    label = f"rays, albedo {albedo}"
    axes[0].errorbar(depths, loss, bars, fmt="o", ms=3, capsize=4, color=colour, label=label)
axes[0].set(
    xlabel="depth / period", ylabel="fraction lost", ylim=(0, 0.55), title="loss in the wall"
)
axes[0].legend()

traced = found[0.75]
left = np.array([np.bincount(p.n_bounces, p.weight, minlength=41) for p in traced])
fates = {
    "leaves after 1 reflection": left[:, 1],
    "leaves after 2 reflections": left[:, 2],
    "leaves after 3 or more": left[:, 3:].sum(axis=1),
    "absorbed at a later reflection": [p.trapped for p in traced],
    "absorbed at the 1st reflection": [p.ledger["absorbed by wall"] - p.trapped for p in traced],
}
colours = plt.get_cmap("viridis")(np.linspace(0.95, 0.0, len(fates)))
axes[1].stackplot(depths, *fates.values(), labels=list(fates), colors=colours)
axes[1].set(xlabel="depth / period", ylabel="fraction of the light", xlim=(0, 1), ylim=(0, 1))
axes[1].set_title("where the light goes, albedo 0.75")
axes[1].legend(loc="lower left", reverse=True)
plt.show()

# %%
# Result:

flat, deep, late = traced[0], traced[-1], traced[-1].n_bounces >= 2
way = deep.points[late, deep.n_bounces[late]] - deep.points[late, 1]
shift = np.average(np.linalg.norm(way, axis=1), weights=deep.weight[late])
print(
    f"At albedo 0.75 the flat wall loses {flat.ledger['absorbed by wall']:.3f} of the light. "
    f"Creases as deep as the period lose {deep.ledger['absorbed by wall']:.3f} +- "
    f"{deep.ledger_error['absorbed by wall']:.3f}; the formula gives {formula[0.75][-1]:.3f}. "
    f"Of the light that leaves them, {100 * left[-1, 2:].sum() / left[-1].sum():.0f} % takes two "
    f"or more reflections and leaves on average {1e3 * shift:.0f} mm from where it arrived."
)
