"""Readers of files from outside: valid samples, and what reading them returns."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parents[2]
Arrays = Iterable[NDArray[Any]]


class Reader(NamedTuple):
    """A reader: its sample files, and the call.

    ``make`` writes samples into a folder and returns those to damage. ``read`` reads the folder
    with one damaged file and returns arrays, which must be finite. ``text`` says whether numbers
    and lines are changed besides bytes.
    """

    make: Callable[[Path], list[Path]]
    read: Callable[[Path, Path], Arrays]
    text: bool = False


def _scenes(folder: Path) -> list[Path]:
    shutil.copytree(ROOT / "examples" / "objects", folder / "objects")
    shutil.copytree(ROOT / "examples" / "walls", folder / "walls")
    shutil.copytree(ROOT / "examples" / "scenes", folder / "scenes")
    names = ("letter_posed", "letter_mesh", "letter_rough", "letter_occluder", "transient_letter")
    return [folder / "scenes" / f"{name}.toml" for name in names]


def _read_scene(_: Path, file: Path) -> Arrays:
    from nlosoptics import Scene

    scene = Scene.load(file)
    return [np.asarray(scene.camera.position), np.asarray(scene.hidden.position)]


def _pictures(folder: Path) -> list[Path]:
    from PIL import Image

    values = np.random.default_rng(1).integers(0, 256, (12, 9), dtype=np.uint8)
    made = []
    for name in ("a.png", "b.tiff", "c.jpg", "d.bmp", "e.gif"):
        Image.fromarray(values).save(folder / name)
        made.append(folder / name)
    Image.fromarray(values.astype(np.uint16) * 257).save(folder / "deep.png")
    np.save(folder / "f.npy", values / 255.0)
    return [*made, folder / "deep.png", folder / "f.npy"]


def _read_picture(_: Path, file: Path) -> Arrays:
    from nlosoptics.scene import PlanarObject

    return [PlanarObject(file, 0.1, position=(0.0, 0.0, 1.0)).reflectance]


def _meshes(folder: Path) -> list[Path]:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    made = []
    for name in ("a.stl", "b.ply", "c.obj", "d.off", "e.glb"):
        mesh.export(folder / name)
        made.append(folder / name)
    mesh.export(folder / "text.stl", file_type="stl_ascii")
    return [*made, folder / "text.stl"]


def _read_mesh(_: Path, file: Path) -> Arrays:
    from nlosoptics.scene import MeshObject

    surface = MeshObject(file, position=(0.0, 0.0, 1.0)).surface
    return [np.asarray(surface.vertices), np.asarray(surface.faces)]


def _heights(folder: Path) -> list[Path]:
    np.save(folder / "h.npy", 1e-4 * np.random.default_rng(2).random((8, 9)))
    np.save(folder / "single.npy", np.zeros((4, 4), dtype=np.float32))
    return [folder / "h.npy", folder / "single.npy"]


def _read_heights(_: Path, file: Path) -> Arrays:
    from nlosoptics.scene import HeightMapWall

    return [np.asarray(HeightMapWall(file, 0.1).height(0.1, 0.1))]


def _captures(folder: Path) -> list[Path]:
    from scipy.io import savemat

    from nlosoptics.transient import TransientCapture, wall_grid

    draw, grid = np.random.default_rng(3), wall_grid(1.0, 3)
    capture = TransientCapture(
        H=draw.random((8, 3, 3)),
        laser_points=grid,
        sensor_points=grid,
        t_start=0.5,
        delta_t=0.003,
        pairing="confocal",
    )
    capture.save(folder / "own.hdf5")
    savemat(folder / "old.mat", {"rect_data": draw.random((4, 4, 16)), "width": np.array([[0.5]])})
    return [folder / "own.hdf5", folder / "old.mat"]


def _read_capture(_: Path, file: Path) -> Arrays:
    from nlosoptics.transient import TransientCapture

    given = {"delta_t": 0.01} if file.name == "old.mat" else {}
    found = TransientCapture.load(file, **given)
    return [found.H, np.asarray(found.H.sum()), found.laser_points, found.sensor_points]


def _zernikes(folder: Path) -> list[Path]:
    from nlosoptics import psf

    path = folder / "z.txt"
    psf.write_zernikes(path, {4: 50e-9, 11: -20e-9}, ordering="noll", unit="nm")
    return [path]


def _read_zernikes(_: Path, file: Path) -> Arrays:
    from nlosoptics import psf

    return [np.array(list(psf.read_zernikes(file).coefficients.values()), dtype=np.float64)]


def _results(folder: Path) -> list[Path]:
    import nlosoptics as nlos

    scene = nlos.Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml").resized(16)
    nlos.simulate(scene, tol=1e-2).save(folder / "run")
    return sorted(path for path in (folder / "run").rglob("*") if path.is_file())


def _read_result(folder: Path, _: Path) -> Arrays:
    import nlosoptics as nlos

    found = nlos.load_result(folder / "run")
    return [found.image.electrons, found.point_spread.intensity]


STUDY = """
scene = "scenes/letter_flat.toml"
figures = ["aberration_rms"]
[axes]
"camera.focus_distance" = ["2 m", "1.9 m"]
[draws]
count = 2
[draws.of]
"laser.power" = { mean = "20 mW", sigma = "1 mW" }
"""


def _studies(folder: Path) -> list[Path]:
    _scenes(folder)
    (folder / "study.toml").write_text(STUDY)
    return [folder / "study.toml"]


def _read_study(_: Path, file: Path) -> Arrays:
    from nlosoptics.study import Study

    return [np.array(Study.load(file).shape)]


def _stores(folder: Path) -> list[Path]:
    from nlosoptics.study import Study, run_study

    study = Study.load(_studies(folder)[0])
    run_study(study, folder / "store", workers=0)
    return sorted(path for path in (folder / "store").rglob("*") if path.is_file())


def _read_store(folder: Path, _: Path) -> Arrays:
    from nlosoptics.study import Results

    Results.load(folder / "store")
    return []  # damaged chunks are pending points, whose figures are NaN


def _records(folder: Path) -> list[Path]:
    """A result's record alone, whose text is then damaged as text."""
    _results(folder)
    return [folder / "run" / "result.json"]


READERS = {
    "scene": Reader(_scenes, _read_scene, text=True),
    "picture": Reader(_pictures, _read_picture),
    "mesh": Reader(_meshes, _read_mesh),
    "heights": Reader(_heights, _read_heights),
    "capture": Reader(_captures, _read_capture),
    "zernikes": Reader(_zernikes, _read_zernikes, text=True),
    "result": Reader(_results, _read_result),
    "record": Reader(_records, _read_result, text=True),
    "study": Reader(_studies, _read_study, text=True),
    "store": Reader(_stores, _read_store, text=True),
}
