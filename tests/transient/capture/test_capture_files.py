"""Captures written in y-tal's layout and read back, ours and y-tal's own."""

from __future__ import annotations

import json
from pathlib import PurePosixPath
from types import MappingProxyType

import h5py
import numpy as np
import pytest

from nlosoptics import cli
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import TransientCapture, wall_grid

GRID = wall_grid(2.0, 3) * (1.0, 0.5, 1.0)
LIST = np.array([[0.1, 0.2, 0.0], [0.3, -0.4, 0.0], [0.5, 0.6, 0.0], [-0.2, 0.1, 0.0]])
SHAPES = {
    "single": ((0.1, 0.2, 0.0), GRID[:2], "all"),
    "confocal": (GRID, GRID, "confocal"),
    "pairs": (GRID + 0.1, GRID, "confocal"),
    "exhaustive": (GRID[:2], GRID, "all"),
    "list of points": ((0.1, 0.2, 0.0), LIST, "all"),
    "lists of both": (LIST[:2], LIST, "all"),
    "confocal list": (LIST, LIST, "confocal"),
    "scanning laser": (GRID, (0.0, 0.0, 0.0), "all"),
    "one of each": ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), "all"),
    "a list and a grid": (LIST, GRID, "all"),
    "rows of one": (GRID[:1, :1], GRID[:1, :1], "all"),
}


def made(kind="single", dtype=np.float64, **more):
    lasers, sensors, pairing = SHAPES[kind]
    axes = np.shape(sensors)[:-1] if pairing == "confocal" else ()
    if pairing == "all":
        axes = np.shape(lasers)[:-1] + np.shape(sensors)[:-1]
    H = np.random.default_rng(0).random((7, *axes)).astype(dtype)
    given = {
        "H": H,
        "laser_points": lasers,
        "sensor_points": sensors,
        "pairing": pairing,
        "delta_t": 0.01,
        "t_start": 0.3,
    }
    return TransientCapture(**{**given, **more})


def changed(path, **changes):
    """Overwrite or (None) delete entries of an HDF5 file."""
    with h5py.File(path, "a") as file:
        for key, value in changes.items():
            del file[key]
            if value is not None:
                file[key] = value
    return path


@pytest.mark.parametrize("kind", SHAPES)
def test_round_trip_is_exact(tmp_path, kind):
    """Nothing is computed on the way, so not a bit may change."""
    before = made(kind)
    parts = {3: 0.7 * before.H, 4: 0.3 * before.H}
    before = made(
        kind,
        by_bounce=parts,
        standard_error=0.1 * before.H,
        quantity="radiosity",
        outer_legs=True,
        laser_origin=(-0.5, 0.0, 0.25),
        sensor_normals=np.broadcast_to([0.0, 0.6, 0.8], before.sensor_points.shape),
        details={"seed": 3, "wall": np.array([1.0, 2.0])},
    )
    before.save(tmp_path / "x.hdf5", compression=4)
    after = TransientCapture.load(tmp_path / "x.hdf5")
    for name in ("H", "standard_error", "laser_points", "sensor_points", "sensor_normals"):
        assert np.array_equal(getattr(after, name), getattr(before, name)), name
    assert {n: h.tolist() for n, h in after.by_bounce.items()} == {
        n: h.tolist() for n, h in before.by_bounce.items()
    }
    for name in ("pairing", "quantity", "delta_t", "t_start", "outer_legs", "laser_origin"):
        assert getattr(after, name) == getattr(before, name), name
    assert after.sensor_origin is None
    assert after.laser_normals is None
    assert after.details["seed"] == 3
    assert np.array_equal(after.details["wall"], [1.0, 2.0])


def test_unknown_origins_are_zeros_for_others_and_unknown_for_us(tmp_path):
    """y-tal reshapes the origins to three numbers, and uses them with outer legs only."""
    path = tmp_path / "x.hdf5"
    made(sensor_origin=(0.1, 0.2, 0.3)).save(path)
    with h5py.File(path) as file:
        assert file["laser_xyz"][()].tolist() == [0.0, 0.0, 0.0]
        assert file["sensor_xyz"][()].tolist() == [0.1, 0.2, 0.3]
    after = TransientCapture.load(path)
    assert after.laser_origin is None
    assert after.sensor_origin == (0.1, 0.2, 0.3)
    # a laser at the wall's centre is known
    made(laser_origin=(0.0, 0.0, 0.0)).save(path)
    after = TransientCapture.load(path)
    assert after.laser_origin == (0.0, 0.0, 0.0)
    assert after.sensor_origin is None
    # another program has filled it in
    with h5py.File(path, "a") as file:
        file["sensor_xyz"][...] = (0.0, 0.0, 1.0)
    assert TransientCapture.load(path).sensor_origin == (0.0, 0.0, 1.0)
    # zeros would be a wrong origin of legs that times hold
    made(outer_legs=True).save(path)
    with h5py.File(path) as file:
        assert file["laser_xyz"].shape is None
    assert TransientCapture.load(path).laser_origin is None


def test_single_precision_is_kept_and_compression_packs(tmp_path):
    even = made(dtype=np.float32, H=np.zeros((500, 2, 3), np.float32))
    even.save(tmp_path / "plain.hdf5")
    even.save(tmp_path / "packed.hdf5", compression=9)
    assert TransientCapture.load(tmp_path / "packed.hdf5").H.dtype == np.float32
    sizes = [(tmp_path / f"{name}.hdf5").stat().st_size for name in ("packed", "plain")]
    assert sizes[0] < sizes[1] - 6000  # 12000 bytes of zeros, less what a chunk's index takes


def test_equal_and_even_bins_take_no_room(tmp_path):
    """As of three bounces alone: one part that is all, without a standard error."""
    H = np.random.default_rng(1).random((500, 2, 3))
    made(H=H).save(tmp_path / "alone.hdf5")
    made(H=H, by_bounce={3: H}, standard_error=0 * H).save(tmp_path / "parts.hdf5")
    sizes = [(tmp_path / f"{name}.hdf5").stat().st_size for name in ("alone", "parts")]
    assert sizes[1] < sizes[0] + H.nbytes / 2
    after = TransientCapture.load(tmp_path / "parts.hdf5")
    assert np.array_equal(after.by_bounce[3], H)
    assert np.array_equal(after.standard_error, 0 * H)


def test_file_is_in_ytals_words(tmp_path):
    """Names, codes and axes as its reader has them: [x, y], a lone laser point as (1, 1, 3)."""
    capture = made("single", details={"note": "grüße 🙂"})
    capture.save(tmp_path / "x.hdf5")
    with h5py.File(tmp_path / "x.hdf5") as file:
        assert sorted(file) == [
            "H",
            "H_format",
            "delta_t",
            "laser_grid_format",
            "laser_grid_normals",
            "laser_grid_xyz",
            "laser_xyz",
            "scene_info",
            "sensor_grid_format",
            "sensor_grid_normals",
            "sensor_grid_xyz",
            "sensor_xyz",
            "t_accounts_first_and_last_bounces",
            "t_start",
            "volume_format",
        ]
        assert file["H"].shape == (7, 3, 2)
        assert file["H"][:, 2, 1] == pytest.approx(capture.H[:, 1, 2], rel=0)
        assert file["sensor_grid_xyz"][2, 1] == pytest.approx(GRID[1, 2], rel=0)
        assert file["laser_grid_xyz"].shape == (1, 1, 3)
        assert (file["sensor_grid_normals"][...] == (0.0, 0.0, 1.0)).all()
        codes = {key: int(file[key][0]) for key in file if key.endswith("_format")}
        assert file["laser_xyz"][()].tolist() == [0.0, 0.0, 0.0]  # unknown
        info = json.loads(file["scene_info"][()])
    assert codes == {
        "H_format": 1,
        "laser_grid_format": 2,
        "sensor_grid_format": 2,
        "volume_format": 2,
    }
    assert info["nlosoptics"]["details"] == {"note": "grüße 🙂"}


def foreign(tmp_path, **changes):
    """y-tal's layout as another program writes it: single precision, no word of ours."""
    path = tmp_path / "foreign.hdf5"
    made("single").save(path)
    return changed(path, **{"scene_info": "config: {a: 1}\n", **changes})


def test_a_foreign_file_is_turned_by_its_points(tmp_path):
    """However its axes lie, each point keeps its light, and rows rise with y, columns with x."""
    truth = made("single")
    for swap, flip in ((False, False), (True, False), (False, True)):
        H, points = truth.H.swapaxes(1, 2), GRID[:2].swapaxes(0, 1)
        if swap:
            H, points = H.swapaxes(1, 2), points.swapaxes(0, 1)
        if flip:
            H, points = H[:, ::-1], points[::-1]
        path = foreign(
            tmp_path,
            H=H,
            sensor_grid_xyz=points,
            sensor_grid_normals=np.broadcast_to([0, 0, 1], points.shape),
        )
        after = TransientCapture.load(path)
        assert np.array_equal(after.sensor_points, GRID[:2])
        assert np.array_equal(after.H, truth.H)
        assert after.quantity == "unknown"


def test_a_foreign_laser_grid_pairs_where_it_is_as_large(tmp_path):
    made("pairs").save(tmp_path / "x.hdf5")
    path = changed(tmp_path / "x.hdf5", scene_info="")
    after = TransientCapture.load(path)
    assert (after.pairing, after.is_confocal) == ("confocal", False)
    assert np.array_equal(after.laser_points, GRID + 0.1)


def test_arguments_go_before_the_file(tmp_path):
    after = TransientCapture.load(
        foreign(tmp_path),
        delta_t=0.02,
        t_start=1.0,
        laser_points=(0.0, 0.5, 0.0),
        outer_legs=True,
        quantity="counts",
    )
    assert (after.delta_t, after.t_start, after.outer_legs) == (0.02, 1.0, True)
    assert after.laser_points.tolist() == [0.0, 0.5, 0.0]
    assert after.quantity == "counts"
    assert np.array_equal(after.H, made("single").H)


def test_points_may_be_given(tmp_path):
    made("confocal").save(tmp_path / "x.hdf5")
    path = changed(tmp_path / "x.hdf5", scene_info="", sensor_grid_xyz=None, laser_grid_xyz=None)
    with pytest.raises(SceneError, match=r"give sensor_points \(.*pairing \(.*laser_points \("):
        TransientCapture.load(path)
    after = TransientCapture.load(path, sensor_points=wall_grid(2.0, 3), pairing="confocal")
    assert after.is_confocal
    assert np.array_equal(after.sensor_points, wall_grid(2.0, 3))
    assert np.array_equal(after.H, made("confocal").H)


def test_one_point_may_have_one_axis(tmp_path):
    """Coordinates (3,) stand for a grid of one point, as (1, 3) and (1, 1, 3) do."""
    path = tmp_path / "x.hdf5"
    made("single").save(path)
    before = TransientCapture.load(path)
    for shape in ((3,), (1, 3), (1, 1, 3)):
        point = before.laser_points.reshape(shape)
        after = TransientCapture.load(changed(path, scene_info="", laser_grid_xyz=point))
        assert after.laser_points.tolist() == before.laser_points.tolist()
        assert np.array_equal(after.sensor_points, before.sensor_points)
        assert np.array_equal(after.H, before.H)


NAN = np.where(np.arange(42).reshape(7, 3, 2) == 3, np.nan, 1.0)


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"delta_t": 4e-12}, SceneError, r"delta_t = 4e-12 .*give delta_t = 0.00119917"),
        ({"delta_t": 16.0}, SceneError, r"delta_t = 16 is too long .*give delta_t = 0.0047"),
        ({"delta_t": h5py.Empty(float)}, SceneError, r"give delta_t \(width of a bin"),
        ({"t_start": 6e-9}, SceneError, r"t_start = 6e-09 is too short .*give t_start = 1.79875"),
        ({"t_start": np.nan}, SceneError, "t_start = nan is not finite"),
        ({"t_accounts_first_and_last_bounces": None}, SceneError, "give outer_legs"),
        ({"H": NAN}, SceneError, "H has 1 of 42 values that are not finite"),
        ({"H": np.ones((7, 3, 3))}, SamplingError, r"H has shape \(7, 3, 3\), must be"),
        ({"H": np.array([b"abc"] * 7)}, SceneError, "must be real numbers"),
        ({"laser_grid_xyz": None}, SceneError, r"give pairing \('confocal' or 'all'\)"),
        ({"laser_grid_xyz": np.zeros((2, 1, 3))}, SamplingError, "2 laser points are neither"),
        ({"sensor_grid_normals": np.ones((2, 2, 3))}, SamplingError, "like sensor_grid_xyz"),
        ({"laser_xyz": np.ones(2)}, SceneError, "laser_xyz has 2 components"),
        ({"t_accounts_first_and_last_bounces": "no"}, SceneError, "= no is neither 0 nor 1"),
        ({"H": None}, SceneError, "no known layout; give a file of y-tal"),
    ],
)
def test_bad_files_say_so_in_one_line(tmp_path, changes, kind, words):
    path = foreign(tmp_path, **changes)
    with pytest.raises(kind, match=words) as caught:
        TransientCapture.load(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message


def test_files_that_are_no_captures(tmp_path):
    def refused(name, content, words):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError, match=words) as caught:
            TransientCapture.load(tmp_path / name)
        assert "\n" not in str(caught.value)

    made().save(tmp_path / "x.hdf5")
    whole = (tmp_path / "x.hdf5").read_bytes()
    refused("half.hdf5", whole[: len(whole) // 2], "is broken .*copy")
    refused("head.hdf5", whole[:20], "is broken")
    refused("text.hdf5", b"x" * 500, "neither HDF5 nor a MATLAB or numpy file")
    refused("empty.mat", b"", "neither HDF5 nor a MATLAB or numpy file")
    with pytest.raises(SceneError, match="is missing; give the path"):
        TransientCapture.load(tmp_path / "none.hdf5")
    with pytest.raises(SceneError, match="is a folder"):
        TransientCapture.load(tmp_path)


def test_a_changed_file_of_ours_is_seen(tmp_path):
    made().save(tmp_path / "x.hdf5")
    with h5py.File(tmp_path / "x.hdf5", "a") as file:
        info = json.loads(file["scene_info"][()])
        info["nlosoptics"]["sensor_shape"] = [5, 5]
        del file["scene_info"]
        file["scene_info"] = json.dumps(info)
    with pytest.raises(SceneError, match="scene_info.nlosoptics does not fit"):
        TransientCapture.load(tmp_path / "x.hdf5")


def test_files_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "x.hdf5"
    made().save(path)
    before = path.read_bytes()

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(h5py.Group, "create_dataset", full)
    with pytest.raises(SceneError, match="cannot be written .No space left"):
        made("confocal").save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.hdf5"]
    with pytest.raises(SceneError, match="there is no folder"):
        made().save(tmp_path / "nowhere" / "x.hdf5")
    with pytest.raises(SceneError, match="compression = 10"):
        made().save(path, compression=10)


@pytest.mark.parametrize("name", ["Z_single16_3b", "Z_confocal16_3b"])
def test_recorded_files_have_the_recorded_axes(data, name):
    """The same bins lie beside in an array of known order, [y, x, t]."""
    folder = data / "peer_transient"
    if not folder.is_dir():
        pytest.skip("the data folder has no peer_transient")
    after = TransientCapture.load(folder / "tal_hdf5" / f"{name}.hdf5")
    with np.load(folder / f"{name}.npz") as truth:
        assert np.array_equal(after.H, np.moveaxis(truth["H"], 2, 0))
    assert after.sensor_points == pytest.approx(wall_grid(2.0, 16), abs=1e-7)  # of float32
    assert after.is_confocal == ("confocal" in name)


def test_ytals_own_command_lays_x_first(data):
    """The Z has no symmetry about its diagonal: transposed it would fit much worse."""
    folder = data / "peer_transient"
    if not folder.is_dir():
        pytest.skip("the data folder has no peer_transient")
    ours = TransientCapture.load(folder / "tal_cli" / "ztal_no_scene_info.hdf5").H
    with np.load(folder / "Z_single16_3b.npz") as file:
        truth = np.moveaxis(file["H"], 2, 0)

    def alike(H):
        return np.corrcoef(H.ravel(), truth.ravel())[0, 1]

    # 0.987 with the noise of both, 0.82 transposed
    assert alike(ours) > 0.97 > 0.9 > alike(ours.swapaxes(1, 2))


def test_pictures_stand_before_the_lasers_of_one_sensor_in_a_grid(tmp_path, monkeypatch):
    """As files of others may lay it: a grid of lasers, all seen by a grid of one sensor."""
    monkeypatch.chdir(tmp_path)
    lasers = wall_grid(1.0, 4)
    made(
        H=np.random.default_rng(5).random((150, 4, 4, 1, 1)),
        laser_points=lasers,
        sensor_points=lasers[:1, :1],
        t_start=0.5,
        delta_t=0.02,
        pairing="all",
    ).save("one.hdf5")
    planes = ("--wl-mean", "0.5", "--near", "0.5", "--far", "0.7", "--step", "0.1")
    with pytest.raises(SystemExit) as ended:
        cli.main(["image", "one.hdf5", *planes])
    assert not ended.value.code
    with np.load("one/volume.npz") as kept:
        assert kept["intensity"].shape == (3, 4, 4)
        assert kept["x"] == pytest.approx(lasers[0, :, 0])


def test_details_that_are_no_arrays_of_numbers_become_plain(tmp_path):
    """Numbers and words of numpy, mappings, and, as text, whatever else."""
    details = {"n": np.int64(3), "words": np.array(["a", "b"]), "map": MappingProxyType({"k": 1})}
    made(details=details | {"path": PurePosixPath("a/b")}).save(tmp_path / "x.hdf5")
    found = TransientCapture.load(tmp_path / "x.hdf5").details
    assert found == {"n": 3, "words": ["a", "b"], "map": {"k": 1}, "path": "a/b"}


def test_a_foreign_laser_point_keeps_its_normal(tmp_path):
    path = foreign(tmp_path, laser_grid_normals=np.array([[[0.0, 0.6, 0.8]]]))
    found = TransientCapture.load(path)
    assert (found.laser_shape, found.laser_normals.tolist()) == ((), [0.0, 0.6, 0.8])
