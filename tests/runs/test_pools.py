"""Runs in other processes give the bits of a loop: pools that spawn or fork, and dask."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

WORK = '''
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields

import numpy as np

import nlosoptics as nlos
from nlosoptics import transient
from nlosoptics.scene import Lambert, WavyWall


def scenes(folder):
    """A curved wall, whose waves are aimed on numba's threads, and a wavy one."""
    from dataclasses import replace

    hollow = nlos.Scene.load(folder + "/letter_concave.toml").resized(8)
    return [hollow, replace(hollow, wall=WavyWall(1e-7, 0.5, size=hollow.wall.size))]


def bits(value):
    """Every array and number of a result but its seconds."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if hasattr(value, "__dataclass_fields__"):
        left_out = {"timings", "plan", "scene", "seconds"}
        return {f.name: bits(getattr(value, f.name)) for f in fields(value)
                if f.name not in left_out}
    if hasattr(value, "items"):
        return {key: bits(inner) for key, inner in value.items()}
    return [bits(inner) for inner in value] if isinstance(value, (tuple, list)) else repr(value)


def run(scene, seed):
    return nlos.simulate(scene, tol=1e-2, seed=seed)


def light(seed):
    """The other loops over threads: three bounces, phasor fields, counts, migration."""
    import trimesh

    plate = trimesh.creation.box((0.2, 0.2, 0.01))
    plate.apply_translation((0.0, 0.0, 0.5))
    points = transient.wall_grid(0.5, 4)
    capture = transient.render(
        [(plate, Lambert(1.0))],
        transient.Scan(
            laser_points=points, sensor_points=points, pairing="confocal", t_start=0.8,
            delta_t=0.02, n_bins=64,
        ),
        max_bounces=3, tol=0.05,
    )
    axis = np.linspace(-0.2, 0.2, 4)
    volume = transient.Volume(axis, axis, np.linspace(0.4, 0.6, 4))
    image = transient.backprojection(capture, volume)
    counts = transient.Detector(photons=1e4).measure(capture, seed=seed)
    return [bits(capture.H), bits(image.intensity), bits(counts.H)]


def there(how, tasks):
    """The same runs and the same light, from the workers of a pool."""
    if how == "dask":
        from distributed import Client, LocalCluster

        with LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster, Client(cluster) as client:
            futures = [client.submit(run, *task, pure=False) for task in tasks]
            return client.gather(futures), client.submit(light, 5).result()
    context = multiprocessing.get_context(how)
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        results = list(pool.map(run, *zip(*tasks), timeout=200))
        return results, pool.submit(light, 5).result(timeout=200)


if __name__ == "__main__":
    folder, *ways = sys.argv[1:]
    tasks = [(scene, seed) for seed, scene in enumerate(scenes(folder))]
    loop = [run(*task) for task in tasks]
    loop_of_light = light(5)
    assert bits(loop[0]) != bits(loop[1])
    for how in ways:
        results, light_there = there(how, tasks)
        assert [bits(result) for result in results] == [bits(result) for result in loop], how
        assert light_there == loop_of_light, how
        for result, (scene, _) in zip(results, tasks):
            assert result.scene == scene
            assert not result.image.electrons.flags.writeable
        print(how, flush=True)
'''


@pytest.mark.thorough
@pytest.mark.timeout(620)
def test_a_pool_gives_the_bits_of_a_loop(examples: Path, tmp_path: Path) -> None:
    """With two threads, and after the parent has used them: what numba ends a forked child for."""
    pytest.importorskip("trimesh")
    ways = ["fork"] if hasattr(os, "fork") else []
    ways += ["spawn"]
    ways += ["dask"] if importlib.util.find_spec("distributed") else []
    script = tmp_path / "work.py"
    script.write_text(WORK)
    answer = subprocess.run(
        [sys.executable, str(script), str(examples / "scenes"), *ways],
        env=os.environ | {"NUMBA_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr[-3000:]
    assert answer.stdout.split() == ways
