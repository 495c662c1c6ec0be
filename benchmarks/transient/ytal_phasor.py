"""y-tal's phasor field of one capture, for phasor.py; runs in y-tal's environment.

python ytal_phasor.py IN.npz OUT.npz: H (t, y, x) from t_start on, the wall's side, depths, the
pulse and repeats in; the field (z, y, x) and seconds by way out. `pf_dev` as its documentation and
code want it: bins from t = 0, one depth a call (several fail in 0.20.0), `nt` given, planes on the
sensors' grid so that it convolves. Ways: every call by itself; `precompute_fft` once; and each with
`set_resources` for all processors.
"""

from __future__ import annotations

import sys
import time
from importlib.metadata import version

import numpy as np
import tal
from tal.enums import CameraSystem, GridFormat, HFormat, VolumeFormat
from tal.io.capture_data import NLOSCaptureData

tal.set_log_level(tal.LogLevel.ERROR)


def capture(given):
    """y-tal's capture of the bins, its axes x before y."""
    light = np.transpose(given["H"], (0, 2, 1)).astype(np.float32)
    early = round(float(given["t_start"]) / float(given["delta_t"]))
    side, count = float(given["side"]), light.shape[1]
    middles = (np.arange(count) + 0.5) * side / count - 0.5 * side
    grid = np.zeros((count, count, 3))
    grid[..., 0], grid[..., 1] = middles[:, None], middles
    data = NLOSCaptureData()
    data.H = np.concatenate([np.zeros((early, *light.shape[1:]), np.float32), light])
    data.H_format = HFormat.T_Sx_Sy
    data.sensor_grid_xyz, data.sensor_grid_format = grid, GridFormat.X_Y_3
    data.laser_grid_xyz, data.laser_grid_format = np.zeros((1, 1, 3)), GridFormat.X_Y_3
    data.sensor_xyz = data.laser_xyz = np.zeros(3)
    data.delta_t, data.t_start = float(given["delta_t"]), 0.0
    data.t_accounts_first_and_last_bounces = False
    return data


def field(data, given, precomputed):
    """(z, y, x) of all depths, one after another."""
    n_bins, wl_sigma = len(data.H), float(given["wl_sigma"])
    if precomputed:
        whole, data.H = data.H, tal.reconstruct.pf_dev.precompute_fft(data, wl_sigma)
    planes = []
    for depth in given["depths"]:
        volume = tal.reconstruct.get_volume_project_rw(data, [float(depth)])[..., 0, :]
        planes.append(
            tal.reconstruct.pf_dev.solve(
                data,
                wl_mean=float(given["wl_mean"]),
                wl_sigma=wl_sigma,
                volume_xyz=volume,
                volume_format=VolumeFormat.X_Y_3,
                camera_system=CameraSystem.DIRECT_LIGHT,
                progress=False,
                skip_H_fft=precomputed,
                nt=n_bins,
            ).T
        )
    if precomputed:
        data.H = whole
    return np.stack(planes)


def main():
    """Time every way, keep the least."""
    given = dict(np.load(sys.argv[1]))
    data = capture(given)
    seconds, names = [], []
    for resources in (None, "max"):
        if resources:
            tal.set_resources(resources)
        for precomputed in (False, True):
            few = {**given, "depths": given["depths"][:1]}
            field(data, few, precomputed)
            spent = []
            for _ in range(int(given["repeats"])):
                start = time.perf_counter()
                found = field(data, given, precomputed)
                spent.append(time.perf_counter() - start)
            seconds.append(min(spent))
            way = "precompute_fft" if precomputed else "plain"
            names.append(f"{way}, {resources or 1} processes")
    np.savez(sys.argv[2], field=found, seconds=seconds, names=names, version=version("y-tal"))


if __name__ == "__main__":
    main()
