"""y-tal reads what we write, and makes the same picture of it as of its own file.

The interpreter that has y-tal is named by NLOSOPTICS_YTAL_PYTHON, unless this one has it.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from nlosoptics.transient import TransientCapture, wall_grid

READ = """
import json, sys
import numpy as np
import tal
from tal.enums import CameraSystem, HFormat

held = []
for path in sys.argv[2:]:
    data = tal.io.read_capture(path)
    held.append({
        "H": np.asarray(data.H).tolist(), "H_format": data.H_format.name,
        "sensor": data.sensor_grid_xyz.tolist(), "laser": data.laser_grid_xyz.tolist(),
        "delta_t": float(data.delta_t), "t_start": float(data.t_start),
        "outer": bool(data.t_accounts_first_and_last_bounces),
        "confocal": bool(data.is_confocal()), "info": data.scene_info,
    })
    tal.io.write_capture(path + ".ytal", data)
    if data.H_format == HFormat.T_Sx_Sy:
        # the reconstruction takes times from 0 on
        data.H = np.pad(data.H, ((round(data.t_start / data.delta_t), 0), (0, 0), (0, 0)))
        data.t_start = 0.0
        slice = data.sensor_grid_xyz + np.array([0.0, 0.0, 1.0])
        # its phasor field takes no confocal pairs
        fields = not data.is_confocal()
        solve = tal.reconstruct.pf_dev.solve if fields else tal.reconstruct.fbp.solve
        image = solve(
            data, wl_mean=0.3, wl_sigma=0.2, camera_system=CameraSystem.DIRECT_LIGHT,
            volume_xyz=slice, progress=False, **({"nt": len(data.H)} if fields else {}))
        held[-1]["picture"] = np.abs(image).reshape(slice.shape[:2]).tolist()
json.dump(held, open(sys.argv[1], "w"))
"""


@pytest.fixture(scope="module")
def ytal():
    """Run y-tal on files: what it holds of each, and its picture of the grids."""
    python = os.environ.get("NLOSOPTICS_YTAL_PYTHON")
    if not python:
        if importlib.util.find_spec("tal") is None:
            pytest.skip("no y-tal: NLOSOPTICS_YTAL_PYTHON names no interpreter that has it")
        python = sys.executable

    def run(folder, *paths):
        out = folder / "held.json"
        words = [python, "-W", "ignore", "-c", READ, str(out), *map(str, paths)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(out.read_text())

    return run


def patch_capture(pairing):
    """Light from a small patch at (0.25, -0.3, 1): no symmetry hides a turned axis."""
    grid = wall_grid(1.6, 8)
    far = np.linalg.norm(grid - [0.25, -0.3, 1.0], axis=-1)
    path = 2.0 * far if pairing == "confocal" else far + np.linalg.norm([0.25, -0.3, 1.0])
    H = np.zeros((120, 8, 8))
    np.put_along_axis(H, np.floor((path - 1.8) / 0.02).astype(int)[None], 1.0 / far**2, axis=0)
    return TransientCapture(
        H=H,
        laser_points=grid if pairing == "confocal" else (0.0, 0.0, 0.0),
        sensor_points=grid,
        delta_t=0.02,
        t_start=1.8,
        pairing=pairing,
        by_bounce={3: H},
        standard_error=np.zeros_like(H),
        laser_origin=(-0.5, 0.0, 0.25),
        sensor_origin=(-0.5, 0.0, 0.25),
        details={"n": 1, "words": "a: b\n- c", "none": None, "small": 1e-9},
    )


@pytest.mark.parametrize("pairing", ["all", "confocal"])
def test_ytal_reconstructs_ours_without_origins(ytal, tmp_path, pairing):
    path = tmp_path / "ours.hdf5"
    replace(patch_capture(pairing), laser_origin=None, sensor_origin=None).save(path)
    (held,) = ytal(tmp_path, path)
    seen = np.array(held["picture"])
    assert np.unravel_index(seen.argmax(), seen.shape) == (5, 2)
    back = TransientCapture.load(path)
    assert (back.laser_origin, back.sensor_origin) == (None, None)


@pytest.mark.parametrize("pairing", ["all", "confocal"])
def test_ytal_reads_and_reconstructs_ours(ytal, tmp_path, pairing):
    ours = patch_capture(pairing)
    path = tmp_path / "ours.hdf5"
    ours.save(path, compression=3)
    (held,) = ytal(tmp_path, path)
    assert held["H"] == ours.H.swapaxes(1, 2).tolist()
    assert held["sensor"] == ours.sensor_points.swapaxes(0, 1).tolist()
    assert (held["delta_t"], held["t_start"], held["outer"]) == (0.02, 1.8, False)
    assert held["confocal"] == (pairing == "confocal")
    # YAML 1.1 takes 1e-09 for a word; all else is as it was
    assert held["info"]["nlosoptics"]["details"] == {**ours.details, "small": "1e-09"}
    # the picture is [x, y]: brightest at the patch, whose cell is the sixth in x, third in y
    seen = np.array(held["picture"])
    assert np.unravel_index(seen.argmax(), seen.shape) == (5, 2)
    # what y-tal wrote of it comes back to us: a file of its own, less what it does not hold
    back = TransientCapture.load(f"{path}.ytal")
    assert np.array_equal(back.H, ours.H)
    assert np.array_equal(back.sensor_points, ours.sensor_points)
    assert back.is_confocal == ours.is_confocal


def test_ytal_reads_every_kind_of_points(ytal, tmp_path):
    points = wall_grid(1.0, 3)
    flat = points.reshape(-1, 3)
    kinds = {
        "T_Si": (points[0, 0], flat),
        "T_Li_Si": (flat[:4], flat),
        "T_Lx_Ly_Sx_Sy": (points[:2], points),
    }
    paths = []
    for name, (lasers, sensors) in kinds.items():
        axes = lasers.shape[:-1] + sensors.shape[:-1]
        H = np.random.default_rng(0).random((5, *axes))
        one = TransientCapture(H=H, laser_points=lasers, sensor_points=sensors, delta_t=0.1)
        paths.append(tmp_path / f"{name}.hdf5")
        one.save(paths[-1])
    for name, held in zip(kinds, ytal(tmp_path, *paths), strict=True):
        assert held["H_format"] == name
    H = np.array(held["H"])
    assert H[:, 2, 1, 0, 2] == pytest.approx(one.H[:, 1, 2, 2, 0], rel=0)


@pytest.mark.parametrize("name", ["Z_single16_3b", "Z_confocal16_3b"])
def test_ytal_makes_the_same_picture_of_ours_as_of_its_own(ytal, tmp_path, data, name):
    own = data / "peer_transient" / "tal_hdf5" / f"{name}.hdf5"
    if not own.is_file():
        pytest.skip("the data folder has no peer_transient")
    copy = tmp_path / "own.hdf5"
    copy.write_bytes(own.read_bytes())
    TransientCapture.load(own).save(tmp_path / "ours.hdf5")
    theirs, ours = ytal(tmp_path, copy, tmp_path / "ours.hdf5")
    first, second = np.array(theirs["picture"]), np.array(ours["picture"])
    difference = np.abs(second - first).max() / first.max()
    # points and times are single in one file, double in the other
    assert difference < 1e-5
