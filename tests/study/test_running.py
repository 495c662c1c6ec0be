"""Runs: the same bits in any way of computing, resumed and extended stores, lost workers."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import zarr
from zarr.storage import LocalStore

from nlosoptics import imaging, limits, psf
from nlosoptics.errors import SceneError, ValidityWarning
from nlosoptics.scene.file.addresses import NOT_IN_POINT_SPREAD
from nlosoptics.study import Results, Study, plan_study, run_study
from nlosoptics.study.store import Store

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"
SCENE = str(EXAMPLES / "scenes" / "letter_concave.toml")
POWERS = {"laser.power": {"from": "1 mW", "to": "9 mW", "count": 9}}


def made(*figures, **tables) -> Study:
    """A study over nine powers, if not told otherwise."""
    given = {"scene": SCENE, "figures": list(figures), "axes": POWERS, **tables}
    return Study.from_tables(given, HERE)


def own(name: str) -> str:
    return f"own_figures:{name}"


def same(one: Results, other: Results) -> bool:
    """Whether all but times agree bit for bit."""
    return one.dataset.drop_vars("seconds").identical(other.dataset.drop_vars("seconds"))


def test_figures_are_those_of_the_library(tmp_path: Path) -> None:
    study = made("strehl", "spot_rms", {"figure": "mtf", "frequency": 5.0, "name": "mtf_5"})
    study = Study.from_tables(
        study.definition | {"axes": {"camera.f_number": [16], "laser.power": ["1 mW", "2 mW"]}},
        HERE,
    )
    results = run_study(study, tmp_path / "store", workers=0)
    found = psf.scene_point_spread(study.scene(0))
    row = results.dataset.isel({"camera.f_number": 0, "laser.power": 1})
    assert row["strehl"] == psf.strehl(found.wavefront, remove=("piston", "tilt"))
    assert row["spot_rms"] == psf.spot_radius(found.wavefront)
    assert 0.1 < row["mtf_5"] < 1.0
    assert (row["status"], row["message"]) == ("done", "")
    assert results.dataset["camera.f_number"] == 16.0
    assert results.dataset["laser.power"].attrs["units"] == "W"


def test_what_a_point_spread_does_not_read_does_not_change_it() -> None:
    """The list by which points share a point spread, address by address."""
    base = made("strehl").base
    new = {
        "laser.power": "9 mW",
        "laser.beam_diameter": "1 mm",
        "laser.independent_patterns": 7,
        "hidden.image": base.packed({"hidden.image": "../objects/R.png"})["hidden.image"],
        "hidden.size": "0.2 m",
        "hidden.material": {"lobe": "lambert", "albedo": 0.3},
        "camera.exposure": "1 s",
        "camera.quantum_efficiency": 0.1,
        "camera.transmission": 0.5,
        "camera.full_well": 1e4,
        "camera.read_noise": 9.0,
        "camera.dark_current": "9 / s",
        "camera.bit_depth": 8,
        "camera.glare_fraction": 0.01,
    }
    assert set(new) == set(NOT_IN_POINT_SPREAD)
    stopped = {"camera.f_number": 16, "camera.binning": 32}
    before = psf.scene_point_spread(base.scene(stopped), 1e-2).point_spread
    scene = base.scene(stopped | new)
    assert scene != base.scene(stopped)
    assert psf.scene_point_spread(scene, 1e-2).point_spread.intensity.tobytes() == (
        before.intensity.tobytes()
    )
    assert limits.object_scale(scene) == limits.object_scale(base.scene(stopped))  # for the MTF


def test_points_share_their_point_spread(tmp_path: Path, monkeypatch) -> None:
    axes = POWERS | {"camera.f_number": [16, 22]}
    study = made("strehl", "aberration_rms", axes=axes)
    assert plan_study(study).point_spreads == 2
    calls = []

    def counted(name):
        function = getattr(psf, name)

        def call(*given, **options):
            calls.append(name)
            warnings.warn(f"of {name}", ValidityWarning, stacklevel=1)
            return function(*given, **options)

        return call

    for name in ("scene_point_spread", "strehl", "rms_aberration"):
        monkeypatch.setattr(psf, name, counted(name))
    results = run_study(study, tmp_path / "store", workers=0)
    assert sorted(calls) == ["rms_aberration"] * 2 + ["scene_point_spread"] * 2 + ["strehl"] * 2
    assert results.counts["done"] == 18
    assert set(results.dataset["message"].values.ravel()) == {
        "strehl: of scene_point_spread; of strehl; "
        "aberration_rms: of scene_point_spread; of rms_aberration"
    }


def test_a_figure_that_ends_python_is_a_failure_that_says_so(tmp_path: Path) -> None:
    data = run_study(made(own("ends"), own("power")), tmp_path / "store", workers=0).dataset
    assert set(data["message"].values) == {"ends: SystemExit: no licence"}
    assert np.array_equal(data["power"], data["laser.power"])


def test_a_point_that_fails_says_why(tmp_path: Path) -> None:
    study = made(own("fragile"), own("not_finite"), own("power"))
    results = run_study(study, tmp_path / "store", workers=0)
    data = results.dataset
    assert np.array_equal(np.isfinite(data["fragile"]), data["laser.power"] <= 3e-3)
    assert set(data["status"].values.ravel()) == {"done"}  # the other figure is there
    assert data["message"].values[-1] == (
        "fragile: RuntimeError: too bright; "
        "not_finite: SceneError: not_finite = nan is not finite; give a finite number in SI units"
    )
    assert np.array_equal(data["power"], data["laser.power"])
    assert results.failures()[data["message"].values[-1]] == 6
    assert "6 x fragile" in str(results)


@pytest.mark.thorough
def test_failed_points_are_computed_again_if_asked_for(tmp_path: Path) -> None:
    (tmp_path / "mended.py").write_text("def ratio(point):\n    return 1 / 0\n")
    tables = {"scene": SCENE, "figures": ["mended:ratio"], "axes": POWERS}
    study = Study.from_tables(tables, tmp_path)
    failed = run_study(study, tmp_path / "store", workers=0)
    assert failed.failures() == {"ratio: ZeroDivisionError: division by zero": 9}
    sys.modules["mended"].ratio = lambda point: 2.0
    assert same(run_study(study, tmp_path / "store", workers=0), failed)
    mended = run_study(study, tmp_path / "store", workers=0, again=True)
    assert mended.counts["done"] == 9
    assert mended.failures() == {}
    assert set(mended.dataset["message"].values) == {""}


def test_scenes_share_a_mesh_and_what_it_has_computed(tmp_path: Path) -> None:
    scene = str(EXAMPLES / "scenes" / "letter_mesh.toml")
    base = made(own("power"), scene=scene).base
    one, other = (base.scene({"laser.power": power}) for power in ("1 mW", "2 mW"))
    assert one.wall is other.wall
    assert one.laser.power != other.laser.power
    assert base.scene({"wall.scale": 1.01}).wall is not one.wall
    assert base.scene({"hidden.yaw": "3 deg"}).hidden is not one.hidden
    assert base.scene({}).hidden is one.hidden


def test_values_that_a_scene_refuses_fail_also_where_a_stage_is_shared(tmp_path: Path) -> None:
    for order in (["1 mW", "-1 mW"], ["-1 mW", "1 mW"]):
        study = made("strehl", axes={"laser.power": order})
        results = run_study(study, tmp_path / order[0], workers=0)
        assert np.isfinite(results.dataset["strehl"].sel({"laser.power": 1e-3}))
        refused = results.dataset.sel({"laser.power": -1e-3})
        assert refused["status"] == "failed"
        assert "laser.power = -0.001 W is out of range" in str(refused["message"].values)


@pytest.mark.thorough
def test_processes_give_the_same_bits_and_a_killed_one_costs_one_point(tmp_path: Path) -> None:
    study = made(own("drawn"), own("power"))
    here = run_study(study, tmp_path / "here", workers=0)
    assert same(here, Results.load(tmp_path / "here"))
    there = run_study(study, tmp_path / "there", workers=2)
    assert same(there, here)
    lost = run_study(made(own("deadly")), tmp_path / "lost", workers=2).dataset
    bad = lost["laser.power"].values == 5e-3
    assert bad.sum() == 1
    assert np.array_equal(lost["status"], np.where(bad, "lost", "done"))
    assert np.array_equal(lost["deadly"].values[~bad], lost["laser.power"].values[~bad])
    assert "worker process ended twice" in str(lost["message"].values[bad])


@pytest.mark.thorough
def test_a_store_grows_to_that_of_a_study_at_once(tmp_path: Path) -> None:
    """More values in any order, more figures, more draws; nothing finished is computed again."""
    few = made(own("drawn"), axes={"laser.power": ["3 mW", "1 mW"], "camera.f_number": [4]})
    axes = {"laser.power": ["1 mW", "2 mW", "3 mW"], "camera.f_number": [2, 4]}
    many = made(own("power"), own("drawn"), axes=axes)
    run_study(few, tmp_path / "grown", workers=0)
    half = made(own("drawn"), axes=axes)
    run_study(half, tmp_path / "grown", workers=0)
    seconds = Store.open(tmp_path / "grown").column("seconds").copy()
    grown = run_study(many, tmp_path / "grown", workers=0)
    assert same(grown, run_study(many, tmp_path / "once", workers=0))
    again = run_study(many, tmp_path / "grown", workers=0)
    assert again.dataset.identical(grown.dataset)
    assert (Store.open(tmp_path / "grown").column("seconds") >= seconds).sum() == 6
    assert grown.counts == {"pending": 0, "done": 6, "failed": 0, "lost": 0}


def test_a_point_is_reopened_without_the_files_of_its_scene(tmp_path: Path) -> None:
    for name in ("scenes", "objects"):
        (tmp_path / name).mkdir()
    for name in ("scenes/letter_concave.toml", "scenes/camera_wu2024.toml", "objects/F.png"):
        (tmp_path / name).write_bytes((EXAMPLES / name).read_bytes())
    (tmp_path / "objects" / "R.png").write_bytes((EXAMPLES / "objects" / "R.png").read_bytes())
    study = made(
        own("power"),
        scene=str(tmp_path / "scenes" / "letter_concave.toml"),
        axes={"hidden.image": ["../objects/F.png", "../objects/R.png"]},
    )
    run_study(study, tmp_path / "store", workers=0)
    wanted = [study.scene(i).hidden.reflectance.tobytes() for i in range(2)]
    for file in tmp_path.glob("*/*.*"):
        if file.suffix in (".png", ".toml"):
            file.unlink()
    results = Results.load(tmp_path / "store")
    assert [results.scene(i).hidden.reflectance.tobytes() for i in range(2)] == wanted
    assert wanted[0] != wanted[1]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"axes": {"laser.power": ["1 mW"]}}, "laser.power = 2 mW and 7 more is missing"),
        ({"set": {"wall.radius": "4 m"}}, 'wall.radius = "4.0 m" instead of "5.0 m"'),
        ({"seed": 1}, "seed = 1 instead of 0"),
        ({"tol": 1e-2}, "tol = 0.01 instead of 0.001"),
        ({"figures": [{"figure": "strehl", "name": "power"}]}, "figure power is strehl"),
        ({"axes": {**POWERS, "camera.f_number": [2]}}, "dimension camera.f_number is new"),
    ],
)
@pytest.mark.thorough
def test_another_study_is_refused_with_the_difference(changes, told, tmp_path: Path) -> None:
    study = made(own("power"))
    before = run_study(study, tmp_path / "store", workers=0)
    other = Study.from_tables(study.definition | changes, HERE)
    with pytest.raises(SceneError, match=f"results of another study: .*{told}"):
        run_study(other, tmp_path / "store", workers=0)
    assert run_study(study, tmp_path / "store", workers=0).dataset.identical(before.dataset)


@pytest.mark.thorough
def test_interrupted_run_keeps_its_blocks_and_goes_on(tmp_path: Path) -> None:
    study = made(own("drawn"))
    asked = iter([False] * 4 + [True] * 99)
    part = run_study(study, tmp_path / "store", workers=0, interrupted=lambda: next(asked))
    assert 0 < part.counts["pending"] < 9
    with pytest.raises(SceneError, match=r"points of 9 in .* are pending; finish the study"):
        part.values("drawn")
    kept = part.dataset["seconds"].values
    whole = run_study(study, tmp_path / "store", workers=0)
    assert same(whole, run_study(study, tmp_path / "other", workers=0))
    finished = np.isfinite(kept)
    assert np.array_equal(whole.dataset["seconds"].values[finished], kept[finished])


def test_a_damaged_store_is_one_line(tmp_path: Path) -> None:
    run_study(made(own("power")), tmp_path / "store", workers=0)
    (chunk,) = (tmp_path / "store" / "value" / "c").rglob("0/0")
    chunk.write_bytes(b"broken")
    with pytest.raises(SceneError, match="store is damaged .*; restore it from a copy"):
        Results.load(tmp_path / "store")


def test_a_store_that_cannot_be_written_is_one_line(tmp_path: Path, monkeypatch) -> None:
    study = made(own("power"))
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match=r"cannot be written .Not a directory"):
        run_study(study, tmp_path / "file" / "store", workers=0)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").write_text("")
    with pytest.raises(SceneError, match="is no store of a study"):
        run_study(study, tmp_path / "foreign", workers=0)
    assert [file.name for file in (tmp_path / "foreign").iterdir()] == ["thesis.tex"]
    zarr.open_group(tmp_path / "other").create_array("id", shape=(1,), dtype="f8")
    with pytest.raises(SceneError, match="is a zarr group of another program"):
        run_study(study, tmp_path / "other", workers=0)

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(Store, "_write", full)
        with pytest.raises(SceneError, match="No space left on device.; finished blocks are kept"):
            run_study(study, tmp_path / "store", workers=0)
    assert run_study(study, tmp_path / "store", workers=0).counts["done"] == 9


CHILD = """
import sys
from nlosoptics.study import Study, run_study
if __name__ == "__main__":
    run_study(Study.load(sys.argv[1]), sys.argv[2], workers=int(sys.argv[3]))
"""


def started(folder: Path, workers: int, points: int = 40) -> subprocess.Popen:
    """A process that runs a study of slow points in a folder."""
    (folder / "child.py").write_text(CHILD)
    (folder / "study.toml").write_text(
        f'scene = "{SCENE}"\nfigures = ["own_figures:slow", "own_figures:drawn"]\n'
        f'[axes]\n"laser.power" = {{ from = "1 mW", to = "9 mW", count = {points} }}\n'
    )
    (folder / "own_figures.py").write_bytes((HERE / "own_figures.py").read_bytes())
    words = ("child.py", "study.toml", "store", str(workers))
    return subprocess.Popen([sys.executable, *words], cwd=folder)


@pytest.mark.thorough
def test_a_killed_client_loses_no_finished_block(tmp_path: Path) -> None:
    """SIGKILL at random moments; resumed to the same bits, and no finished point is repeated."""
    seed = int(time.time())
    random = np.random.default_rng(seed)
    store, kept = tmp_path / "store", np.full(40, np.nan)
    for kill in range(4):
        child = started(tmp_path, workers=0)
        while child.poll() is None and not store.exists():
            time.sleep(0.003)
        time.sleep(random.uniform(0.0, 0.6))
        child.send_signal(signal.SIGKILL)
        child.wait()
        if Store.open(store) is not None:
            data = Results.load(store).dataset
            known = np.isfinite(kept)
            kept = np.where(data["status"] == "done", data["seconds"], np.nan)
            assert np.isfinite(kept[known]).all(), (seed, kill)
    study = Study.load(tmp_path / "study.toml")
    resumed = run_study(study, store, workers=0)
    assert same(resumed, run_study(study, tmp_path / "undisturbed", workers=0)), seed
    known = np.isfinite(kept)
    assert np.array_equal(resumed.dataset["seconds"].values[known], kept[known]), seed
    assert not list(store.rglob("*.partial"))


@pytest.mark.thorough
def test_workers_end_with_a_killed_client_and_leave_no_folder(tmp_path: Path, monkeypatch) -> None:
    psutil = pytest.importorskip("psutil")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    client = started(tmp_path, workers=2, points=4000)
    while client.poll() is None and not list((tmp_path / "store").glob("status/c/*/*")):
        time.sleep(0.01)
    workers = psutil.Process(client.pid).children(recursive=True)
    assert len(workers) >= 2
    client.send_signal(signal.SIGKILL)
    client.wait()
    assert psutil.wait_procs(workers, timeout=10)[1] == []
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_store_has_few_files(tmp_path: Path) -> None:
    study = made(own("drawn"), axes=POWERS | {"camera.f_number": [2, 4, 8, 16]})
    run_study(study, tmp_path / "store", workers=0)
    # arrays with their metadata, one chunk each, and the files of the scene
    assert sum(path.is_file() for path in (tmp_path / "store").rglob("*")) < 25


class Ended(BaseException):
    """In place of a killed process."""


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.thorough
def test_a_run_that_ends_at_any_write_is_read_and_goes_on(
    before: bool, tmp_path: Path, monkeypatch
) -> None:
    """At each file that creation, growth and results write, in turn."""
    few = made(own("drawn"), axes={"laser.power": ["1 mW", "3 mW"]})
    many = made(own("drawn"), own("power"), axes={"laser.power": ["1 mW", "2 mW", "3 mW"]})
    once, put = run_study(many, tmp_path / "once", workers=0), LocalStore.set
    run_study(few, tmp_path / "few", workers=0)
    for allowed in range(99):
        store, left = tmp_path / str(allowed), iter(range(allowed))
        if before:
            shutil.copytree(tmp_path / "few", store)

        async def ends(*given, left=left) -> None:
            if next(left, None) is None:
                raise Ended
            await put(*given)

        with monkeypatch.context() as broken:
            broken.setattr(LocalStore, "set", ends)
            try:
                run_study(many, store, workers=0)
            except Ended:
                (store / "0.0f.partial").write_text("of a killed process")
            else:
                break
        if before or Store.open(store) is not None:
            part = Results.load(store)
            assert part.counts["failed"] == part.counts["lost"] == 0
            assert np.isfinite(part.dataset["drawn"]).sum() >= 2 * before
        assert same(run_study(many, store, workers=0), once), allowed
        assert not list(store.rglob("*.partial"))
    assert allowed > 10


def test_only_one_process_writes(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    study = made(own("power"))
    (tmp_path / "store").mkdir()
    folder = os.open(tmp_path / "store", os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    try:
        with pytest.raises(SceneError, match="being written by another process"):
            run_study(study, tmp_path / "store", workers=0)
    finally:
        os.close(folder)
    assert run_study(study, tmp_path / "store", workers=0).counts["done"] == 9


@pytest.mark.thorough
def test_a_dask_scheduler_gives_the_same_bits(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    study = made(own("drawn"), own("power"))
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        there = run_study(study, tmp_path / "there", scheduler=cluster.scheduler_address)
    assert same(there, run_study(study, tmp_path / "here", workers=0))
    with pytest.raises(SceneError, match="does not answer"):
        run_study(study, tmp_path / "none", scheduler="tcp://127.0.0.1:1")
    assert not (tmp_path / "none").exists()


def test_workers_load_only_what_points_need() -> None:
    """A worker imports what its script imports at the top: the store's packages take 0.3 s."""
    code = (
        "import sys; from nlosoptics.study import Results, run_study, sobol_indices; "
        "print({'zarr', 'xarray', 'pandas'} & set(sys.modules))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.stdout == "set()\n", answer.stderr


def stripes_in_the_image(scene, frequency: float) -> float:
    """Contrast of horizontal stripes at the image's centre, from stripes at three phases."""
    spread = psf.scene_point_spread(scene).point_spread
    y = (np.arange(4096) + 0.5) / 4096 * scene.hidden.size[1]
    n = len(imaging.form_image(scene, spread).signal) // 2
    light = []
    for phase in (0.0, 0.5, 1.0):
        stripes = 0.5 + 0.5 * np.sin(2 * np.pi * frequency * y + np.pi * phase)
        image = imaging.form_image(scene, spread, object_image=np.repeat(stripes[:, None], 2, 1))
        light.append(image.signal[n, n])
    mean = (light[0] + light[2]) / 2
    return float(np.hypot(light[0] - mean, light[1] - mean) / mean)


ROUGH = {"model": "gaussian", "height_rms": "1 pm", "correlation_length": "1 mm"}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        # of no height, but computed from a finely sampled point spread
        {"wall.roughness": ROUGH | {"realisation": "mean"}},
    ],
)
def test_mtf_is_the_contrast_of_stripes(changes: dict, tmp_path: Path) -> None:
    """Coarse pixels alias in a sampled point spread, whose Fourier sum says 0.999."""
    study = made(
        {"figure": "mtf", "frequency": 37.0, "azimuth": np.pi / 2, "name": "near"},
        {"figure": "mtf", "frequency": 100.0, "name": "far"},
        scene=str(EXAMPLES / "scenes" / "letter_flat.toml"),
        axes={"camera.binning": [32]},
        set=changes,
    )
    data = run_study(study, tmp_path / "store", workers=0).dataset
    # the point spread is computed to 0.001 of its peak
    assert data["near"][0] == pytest.approx(stripes_in_the_image(study.scene(0), 37.0), abs=3e-3)
    assert "pixels show at most 43.99" in str(data["message"].values[0])
