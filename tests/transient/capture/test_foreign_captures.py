"""Captures in the layouts of Z-NLOS and of the LCT."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import TransientCapture, gated, wall_grid

GRID = wall_grid(1.0, 3)[:2]  # 2 rows of 3, so that no axis is taken for another
LASERS = wall_grid(1.0, 5)[:4]
DRAW = np.random.default_rng(5)


def written(path, **entries):
    with h5py.File(path, "w") as file:
        for key, value in entries.items():
            file[key] = value
    return path


def znlos(tmp_path, H, lasers, **changes):
    """Colours and bounces by halves, whose sums are whole again; (3, a, b) grids."""
    parts = np.stack([0.25 * H, 0.75 * H], axis=1)  # (t, bounces, ...)
    if lasers.shape[:2] != (1, 1) and H.ndim == 5:
        parts = np.moveaxis(parts, (2, 3), (4, 5))  # sensors before lasers
    entries = {
        "data": parts[None],
        "cameraGridPositions": np.moveaxis(GRID, -1, 0),
        "cameraGridNormals": np.moveaxis(np.broadcast_to([0, 0, 1.0], GRID.shape), -1, 0),
        "laserGridPositions": np.moveaxis(lasers, -1, 0),
        "laserGridNormals": np.moveaxis(np.broadcast_to([0, 0, 1.0], lasers.shape), -1, 0),
        "cameraPosition": np.array([[-0.5], [0.0], [0.3]]),
        "laserPosition": np.array([[-0.4], [0.0], [0.3]]),
        "deltaT": np.array([[0.003]]),
        "t0": np.array([[0.5]]),
        "t": np.array([[len(H)]]),
        "isConfocal": np.array([[0]]),
        "hiddenVolumePosition": np.array([0.0, 0.0, 1.0]),
    }
    entries.update(changes)
    return written(tmp_path / "z.hdf5", **{k: v for k, v in entries.items() if v is not None})


def test_znlos_confocal_single_and_exhaustive(tmp_path):
    H = DRAW.random((8, 2, 3))
    confocal = TransientCapture.load(znlos(tmp_path, H, GRID, isConfocal=np.array([[1]])))
    assert confocal.is_confocal
    assert confocal.H == pytest.approx(H, rel=1e-15)  # a quarter and three quarters added
    assert np.array_equal(confocal.sensor_points, GRID)
    assert (confocal.delta_t, confocal.t_start, confocal.outer_legs) == (0.003, 0.5, True)
    assert confocal.sensor_origin == (-0.5, 0.0, 0.3)

    one = TransientCapture.load(znlos(tmp_path, H, LASERS[:1, :1]))
    assert one.laser_shape == ()
    assert np.array_equal(one.laser_points, LASERS[0, 0])
    assert one.H == pytest.approx(H, rel=1e-15)

    H = DRAW.random((8, 4, 5, 2, 3))
    many = TransientCapture.load(znlos(tmp_path, H, LASERS))
    assert many.H == pytest.approx(H, rel=1e-15)
    assert np.array_equal(many.laser_points, LASERS)


def test_znlos_in_the_reverse_order(tmp_path):
    """Rows, columns, bounces, t, colours; lasers before sensors."""
    H = DRAW.random((8, 4, 5, 2, 3))
    data = np.moveaxis(np.stack([0.25 * H, 0.75 * H]), (0, 1), (-2, -1))[..., None]
    same = TransientCapture.load(znlos(tmp_path, H, LASERS, data=data))
    assert same.H == pytest.approx(H, rel=1e-15)


def test_znlos_grids_laid_as_x_y_are_turned(tmp_path):
    H = DRAW.random((8, 2, 3))
    turned = np.moveaxis(GRID.swapaxes(0, 1), -1, 0)
    parts = np.stack([H, 0 * H], axis=1).swapaxes(2, 3)[None]
    path = znlos(
        tmp_path,
        H,
        GRID,
        data=parts,
        cameraGridPositions=turned,
        laserGridPositions=turned,
        cameraGridNormals=None,
        laserGridNormals=None,
        isConfocal=np.array([[1]]),
    )
    after = TransientCapture.load(path)
    assert np.array_equal(after.H, H)
    assert np.array_equal(after.laser_points, GRID)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"data": np.ones((1, 8, 2, 5, 5))}, r"data has shape \(1, 8, 2, 5, 5\), must be"),
        ({"isConfocal": np.array([[1]])}, "do not fit the laser points"),
        ({"deltaT": np.array([[1e-11]])}, "delta_t = 0.00299792"),
        ({"t0": None}, "give t_start"),
        ({"laserGridPositions": None}, "laserGridPositions is missing"),
        ({"cameraGridPositions": np.ones((2, 3))}, r"cameraGridPositions has shape \(2, 3\)"),
        ({"laserGridPositions": np.ones((3, 4, 5))}, "do not fit the laser points"),
    ],
)
def test_bad_znlos(tmp_path, changes, words):
    path = znlos(tmp_path, DRAW.random((8, 2, 3)), LASERS[:1, :1], **changes)
    with pytest.raises((SceneError, SamplingError), match=words):
        TransientCapture.load(path)


def lct(tmp_path, **changes):
    counts = np.arange(4 * 4 * 6, dtype=np.uint16).reshape(4, 4, 6)
    savemat(tmp_path / "l.mat", {"rect_data": counts, "width": 0.2, **changes})
    return tmp_path / "l.mat", counts


def write_matlab73(path, variables):
    """As MATLAB's v7.3: a user block that says so, arrays with the first index fastest."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for key, value in variables.items():
            file[key] = np.atleast_2d(value).T
            file[key].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("version", ["v5", "v7.3"])
def test_lct_asks_for_what_it_does_not_say(tmp_path, version):
    path, counts = lct(tmp_path)
    if version == "v7.3":
        write_matlab73(path, {"rect_data": counts, "width": 0.2})
    with pytest.raises(SceneError, match=r"does not state all values; give delta_t \(width of a b"):
        TransientCapture.load(path)
    after = TransientCapture.load(path, delta_t=0.0012)
    assert after.is_confocal
    assert (after.quantity, after.t_start, after.outer_legs) == ("counts", 0.0, False)
    # columns are the first index, rows the second from its end
    assert after.H[:, 0, 3].tolist() == counts[3, 3].tolist()
    assert after.H[:, 1, 0].tolist() == counts[0, 2].tolist()
    assert after.sensor_points[0, 0] == pytest.approx([-0.15, -0.15, 0.0])  # cells of a 0.4 m side
    # a value that is given replaces that of the file
    other = TransientCapture.load(path, sensor_points=wall_grid(0.2, 4), delta_t=0.0012)
    assert other.sensor_points[0, 0] == pytest.approx([-0.075, -0.075, 0.0])


L = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [1, 1, 1, 0]])  # as seen from the wall


@pytest.mark.parametrize("layout", ["LCT", "rows downward", "ours"])
def test_letters_read_the_right_way_from_the_wall(tmp_path, layout):
    """A viewer who looks from the wall into the room has x on the left and y up.

    The front view published with LCT files is ``rect_data[::-1]`` with its second index downward.
    """
    path = tmp_path / "l.mat"
    if layout == "LCT":
        savemat(path, {"rect_data": L.T[::-1, :, None], "width": 0.2})
        capture = TransientCapture.load(path, delta_t=0.01)
    elif layout == "rows downward":
        np.save(tmp_path / "l.npy", L[..., None])
        axes = {"array": "array", "axes": "-y,-x,t", "side": 0.4}
        capture = TransientCapture.load(tmp_path / "l.npy", delta_t=0.01, **axes)
    else:
        wall = wall_grid(0.4, 4)
        capture = TransientCapture(
            H=L[None, ::-1, ::-1],
            laser_points=wall,
            sensor_points=wall,
            delta_t=0.01,
            pairing="confocal",
        )
        capture.save(tmp_path / "l.hdf5")
        capture = TransientCapture.load(tmp_path / "l.hdf5")
    x, y = capture.sensor_points[..., 0], capture.sensor_points[..., 1]
    assert x[0, 0] < x[0, 1]
    assert y[0, 0] < y[1, 0]
    assert np.array_equal(capture.H[0, ::-1, ::-1], L)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": np.array([])}, "width = None"),
        ({"rect_data": np.ones((4, 3, 6))}, "not a square wall"),
        ({"rect_data": "words"}, "must be real numbers"),
    ],
)
def test_bad_lct(tmp_path, changes, words):
    path, _ = lct(tmp_path, **changes)
    with pytest.raises((SceneError, SamplingError), match=words):
        TransientCapture.load(path, delta_t=0.0012)


def test_broken_and_unknown_files(tmp_path):
    path, _ = lct(tmp_path)
    with pytest.raises(SceneError, match="delta_t = 4e-12 is too short .* give delta_t = 0.00119"):
        TransientCapture.load(path, delta_t=4e-12)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(SceneError, match="is broken .*copy") as caught:
        TransientCapture.load(path, delta_t=0.0012)
    assert "\n" not in str(caught.value)
    savemat(path, {"volume": np.ones(3)})
    with pytest.raises(SceneError, match="holds .*volume, which is no known layout"):
        TransientCapture.load(path)


@pytest.mark.parametrize("name", ["dot_chart_40cm", "resolution_chart_65cm"])
def test_measured_lct_light_comes_when_it_must(data, name):
    """Light from the nominal depth is the strongest past the direct light, within 5 cm."""
    path = data / "lct_stanford" / f"data_{name}.mat"
    if not path.is_file():
        pytest.skip("the data folder has no lct_stanford")
    capture = gated(TransientCapture.load(path, delta_t=1.2e-3), start=0.72)
    nominal = 0.01 * float(name[-4:-2])
    # just before the middle of the wall, where the path is twice the depth
    seen = capture.H[:, 28:36, 28:36].sum(axis=(1, 2)) * capture.times**2
    depth = 0.5 * capture.times[np.argmax(seen)]
    assert depth == pytest.approx(nominal, abs=0.05)


def test_znlos_that_says_nothing_of_pairs_has_those_of_equal_grids(tmp_path):
    H = DRAW.random((8, 2, 3))
    assert TransientCapture.load(znlos(tmp_path, H, GRID, isConfocal=None)).is_confocal
    single = TransientCapture.load(znlos(tmp_path, H, LASERS[:1, :1], isConfocal=None))
    assert (single.pairing, single.laser_shape) == ("all", ())
    many = znlos(tmp_path, DRAW.random((8, 2, 3, 2, 3)), GRID, isConfocal=None)
    assert TransientCapture.load(many).pairing == "all"


@pytest.mark.parametrize("turned", [False, True])
def test_grids_with_coordinates_first_or_last(tmp_path, turned):
    """Other shapes, also of two axes, are refused."""
    H, points = DRAW.random((8, 2, 3)), GRID if turned else np.moveaxis(GRID, -1, 0)
    found = TransientCapture.load(znlos(tmp_path, H, LASERS[:1, :1], cameraGridPositions=points))
    assert np.array_equal(found.sensor_points, GRID)
    path = znlos(tmp_path, H, LASERS[:1, :1], cameraGridPositions=np.ones((2, 4, 5)))
    with pytest.raises(SamplingError, match=r"has shape \(2, 4, 5\), must be \(3, a, b\) or"):
        TransientCapture.load(path)
