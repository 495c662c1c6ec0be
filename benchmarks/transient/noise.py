"""Noisy letters without settings, SEEDS times: overlap and depth error (m) by two methods."""

import sys
from dataclasses import replace

import numpy as np
from trimesh.creation import box

from nlosoptics import scene, transient

WALL = {n: transient.wall_grid(1.0, 64) for n in ("laser_points", "sensor_points")}
SCAN = transient.Scan(**WALL, pairing="confocal", t_start=1.1, delta_t=0.01, n_bins=200)
F = ((-0.12, 0, 0.09, 0.44), (0.045, 0.175, 0.24, 0.09), (0.02, 0, 0.19, 0.09))
H = ((-0.16, 0, 0.08, 0.42), (0.16, 0, 0.08, 0.42), (0, 0, 0.24, 0.08))  # x, y, width, height
for name, bars in (("F", F), ("H", H)):
    meshes = [box((w, h, 1e-3)).apply_translation((x, y, 0.7)) for x, y, w, h in bars]
    clean = transient.render([(m, scene.Lambert(0.8)) for m in meshes], SCAN, max_bounces=3)
    for photons in (100, 10, 3, 1):
        for seed in range(int(sys.argv[1])):
            rng = np.random.default_rng(seed)
            counts = rng.poisson(photons * (clean.H / clean.H.max() + 0.2)).astype(float)
            shot = replace(clean, H=counts, by_bounce={}, standard_error=None)
            advice = transient.advise(shot)
            image = transient.inverse_image(shot, advice=advice)
            least = image.details["threshold"]
            truth = transient.true_depths(meshes, image.volume)
            for map_ in (advice.depths, transient.depth_map(image, threshold=least)):
                off, seen = np.abs(map_.depth - truth), np.isfinite(map_.depth)
                iou = np.isfinite(off).sum() / (seen | np.isfinite(truth)).sum()
                print(name, photons, seed, round(iou, 3), np.nanmedian(off).round(4), flush=True)
