"""Captures in the layouts of Z-NLOS, NLOS-DIRAC, the phasor field's and the LCT's files."""

from __future__ import annotations

import io
import struct
import tracemalloc

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import TransientCapture, wall_grid
from nlosoptics.transient.capture.mat_files import _check_elements, variables

GRID = wall_grid(1.0, 3)[:2]  # 2 rows of 3, so that no axis is taken for another
LASERS = wall_grid(1.0, 5)[:4]
DRAW = np.random.default_rng(5)
SPEED = 299792458.0


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
        ({"isConfocal": np.array([[1]])}, "not paired"),
        ({"deltaT": np.array([[1e-11]])}, "bin_width = 0.00299792"),
        ({"t0": None}, "does not say t_start"),
        ({"laserGridPositions": None}, "laserGridPositions is missing"),
        ({"cameraGridPositions": np.ones((2, 3))}, r"cameraGridPositions has shape \(2, 3\)"),
        ({"laserGridPositions": np.ones((3, 4, 5))}, "no laser axes"),
    ],
)
def test_bad_znlos(tmp_path, changes, words):
    path = znlos(tmp_path, DRAW.random((8, 2, 3)), LASERS[:1, :1], **changes)
    with pytest.raises((SceneError, SamplingError), match=words):
        TransientCapture.load(path)


@pytest.mark.parametrize(
    "changes", [{"da": np.ones(7)}, {"xg": np.ones((2, 3))}, {"yg": np.ones((2, 3))}]
)
def test_bad_dirac(tmp_path, changes):
    held = {"data_t": np.ones((8, 3, 2)), "xg": GRID[..., 0].T, "yg": GRID[..., 1].T}
    path = written(tmp_path / "d.hdf5", **{**held, "da": np.ones(8), **changes})
    with pytest.raises(SamplingError, match=r"data_t has shape \(8, 3, 2\), must be"):
        TransientCapture.load(path)


def test_dirac_leaves_pairing_and_times_to_the_caller(tmp_path):
    H = DRAW.random((8, 2, 3))
    path = written(
        tmp_path / "d.hdf5",
        data_t=H.swapaxes(1, 2),
        xg=GRID[..., 0].T,
        yg=GRID[..., 1].T,
        da=0.4 + 0.01 * np.arange(8),
    )
    with pytest.raises(SceneError, match="NLOS-DIRAC does not say .*pairing = 'confocal'"):
        TransientCapture.load(path)
    with pytest.raises(SceneError, match="give t_start"):
        TransientCapture.load(path, pairing="confocal")
    with pytest.raises(SceneError, match="give outer_legs"):
        TransientCapture.load(path, pairing="confocal", t_start=0.4)
    given = {"t_start": 0.4, "outer_legs": False}
    after = TransientCapture.load(path, pairing="confocal", **given)
    assert np.array_equal(after.H, H)
    assert after.is_confocal
    assert after.delta_t == pytest.approx(0.01, rel=1e-12)  # a difference of numbers near 0.4
    single = TransientCapture.load(path, laser_point=(0, 0, 0), **given)
    assert single.laser_shape == ()


def dataset(H, **changes):
    """Phasor field 2019, MATLAB's order: (laser, sensor, t)."""
    points = GRID.reshape(-1, 3)
    held = {
        "data": np.ascontiguousarray(H.T[:, None]),
        "t": float(len(H)),
        "deltat": 0.0048,
        "t0": 1.0,
        "laserPos": points,
        "laserNorm": np.array([[0.0, 0.0, 1.0]]),
        "laserOrigin": np.array([[0.1, 0.2, 0.3]]),
        "cameraPos": np.array([[0.05, 0.0, 0.0]]),
        "cameraNorm": np.array([[0.0, 0.0, 1.0]]),
        "cameraOrigin": np.array([[0.4, 0.5, 0.6]]),
    }
    return {k: v for k, v in {**held, **changes}.items() if v is not None}


def write_matlab73(path, held):
    """As MATLAB's v7.3: a user block that says so, arrays with the first index fastest."""

    def put(group, items):
        for key, value in items.items():
            if isinstance(value, dict):
                put(group.create_group(key), value)
            else:
                group[key] = np.atleast_2d(value).T
                group[key].attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        put(file, held)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("version", ["v5", "v7.3"])
def test_phasor_field_2019(tmp_path, version):
    H = DRAW.random((8, 6))
    path = tmp_path / "p.mat"
    held = {"dataset": dataset(H), "minimalpos": np.zeros((1, 3))}
    if version == "v5":
        savemat(path, held)
    else:
        write_matlab73(path, held)
    after = TransientCapture.load(path)
    assert np.array_equal(after.H, H)
    assert np.array_equal(after.sensor_points, GRID.reshape(-1, 3))
    assert after.laser_points.tolist() == [0.05, 0.0, 0.0]
    # swapped, as the scanned points are
    assert after.laser_origin == (0.4, 0.5, 0.6)
    assert after.sensor_normals.shape == (6, 3)
    assert (after.delta_t, after.t_start, after.outer_legs) == (0.0048, 1.0, True)
    assert after.details["swapped"] == "laser and sensor"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"deltat": 16e-12}, "bin_width = 0.00479668"),
        ({"data": np.ones((5, 1, 8))}, r"dataset.data has shape \(5, 1, 8\)"),
        ({"t": 9.0}, "dataset.t = 9 bins, dataset.data has 8"),
        ({"cameraPos": np.zeros((2, 3))}, "cameraPos has 2 points"),
        ({"laserPos": None}, "laserPos is missing"),
        ({"t0": None}, "give t_start"),
    ],
)
def test_bad_phasor_field_2019(tmp_path, changes, words):
    savemat(tmp_path / "p.mat", {"dataset": dataset(DRAW.random((8, 6)), **changes)})
    with pytest.raises((SceneError, SamplingError), match=words):
        TransientCapture.load(tmp_path / "p.mat")


def diffraction(H, **changes):
    """Phasor field 2020, MATLAB's order: (y, x, t), bins in seconds."""
    held = {
        "rect_data": np.moveaxis(H, 0, -1),
        "ts": 16e-12,
        "sampling_spacing": 0.01,
        "SPAD_index": np.array([[2.0, 1.0]]),
    }
    return {k: v for k, v in {**held, **changes}.items() if v is not None}


@pytest.mark.parametrize("version", ["v5", "v7.3"])
def test_phasor_field_2020(tmp_path, version):
    H = DRAW.random((8, 2, 3))
    path = tmp_path / "p.mat"
    if version == "v5":
        savemat(path, diffraction(H))
    else:
        write_matlab73(path, diffraction(H))
    with pytest.raises(SceneError, match="SPAD_index may count from 0.* or laser_point"):
        TransientCapture.load(path)
    after = TransientCapture.load(path, format="phasor_field_2020")
    assert np.array_equal(after.H, H)
    assert after.delta_t == pytest.approx(16e-12 * SPEED, rel=1e-15)
    # x = 0 at index n/2 = 1.5 of 3 columns, y = 0 at 1 of 2 rows; the point is (2, 1) from 0
    assert after.laser_points == pytest.approx([0.005, 0.0, 0.0], abs=1e-15)
    assert after.sensor_points[0, 0] == pytest.approx([-0.015, -0.01, 0.0], abs=1e-15)
    named = TransientCapture.load(path, laser_point=(0.0, 0.1, 0.0))
    assert named.laser_points.tolist() == [0.0, 0.1, 0.0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ts": 0.0048}, "ts = 0.0048 is no bin width in s"),
        ({"ts": None}, "give bin_width"),
        ({"SPAD_index": np.array([[3, 1]])}, "is no point of the 3 x 2 grid"),
        ({"SPAD_index": np.array([[2, 2]])}, "is no point of the 3 x 2 grid"),
        ({"SPAD_index": np.array([[-1, 1]])}, "is no point of the 3 x 2 grid"),
        ({"SPAD_index": np.array([[np.nan, 1.0]])}, "is no point of the 3 x 2 grid"),
        ({"SPAD_index": np.array([[1.5, 1.0]])}, "is no point of the 3 x 2 grid"),
        ({"SPAD_index": None}, "no laser points; give laser_point"),
        ({"sampling_spacing": None}, "rect_data needs width"),
    ],
)
def test_bad_phasor_field_2020(tmp_path, changes, words):
    savemat(tmp_path / "p.mat", diffraction(DRAW.random((8, 2, 3)), **changes))
    given = {} if "sampling_spacing" in changes else {"format": "phasor_field_2020"}
    with pytest.raises(SceneError, match=words):
        TransientCapture.load(tmp_path / "p.mat", **given)


def lct(tmp_path, **changes):
    counts = np.arange(4 * 4 * 6, dtype=np.uint16).reshape(4, 4, 6)
    savemat(tmp_path / "l.mat", {"rect_data": counts, "width": 0.2, **changes})
    return tmp_path / "l.mat", counts


def test_lct_asks_for_all_that_it_does_not_say(tmp_path):
    path, counts = lct(tmp_path)
    given = {}
    for words, more in (
        ("width is half the wall's side; give format = 'lct' if so, or pairing and side", "format"),
        ("width of its bins; give bin_width", "bin_width"),
        ("can be direct light; give gate_start", "gate_start"),
    ):
        with pytest.raises(SceneError, match=words):
            TransientCapture.load(path, **given)
        given[more] = {"format": "lct", "bin_width": 0.0012, "gate_start": 0.0024}[more]
    after = TransientCapture.load(path, **given)
    assert after.is_confocal
    assert after.quantity == "counts"
    assert not after.H[:2].any()
    # columns are the first index, rows the second, both from the other end: the lower left as the
    # wall sees it, (x > 0, y < 0), is first in x and last in y there
    assert after.H[2:, 0, 3].tolist() == counts[0, 3, 2:].tolist()
    assert after.H[2:, 1, 0].tolist() == counts[3, 2, 2:].tolist()
    assert after.sensor_points[0, 0] == pytest.approx([-0.15, -0.15, 0.0])  # cells of a 0.4 m side
    other = TransientCapture.load(
        path, pairing="confocal", side=0.2, bin_width=0.0012, gate_start=0.0
    )
    assert other.sensor_points[0, 0] == pytest.approx([-0.075, -0.075, 0.0])
    assert other.H[0].any()


def test_bad_lct(tmp_path):
    path, _ = lct(tmp_path)
    given = {"format": "lct", "gate_start": 0.0}
    with pytest.raises(SceneError, match="bin_width = 4e-12 is too short"):
        TransientCapture.load(path, bin_width=4e-12, **given)
    whole = path.read_bytes()
    path.write_bytes(whole[:200])
    with pytest.raises(SceneError, match="broken MATLAB file") as caught:
        TransientCapture.load(path, **given)
    assert "\n" not in str(caught.value)
    path, _ = lct(tmp_path, width=np.array([]))
    with pytest.raises(SceneError, match="width = None"):
        TransientCapture.load(path, **given)
    path, _ = lct(tmp_path, rect_data=np.ones((4, 3, 6)))
    with pytest.raises(SceneError, match="not a square wall"):
        TransientCapture.load(path, **given)
    savemat(path, {"volume": np.ones(3)})
    with pytest.raises(SceneError, match="holds volume, which is no known layout"):
        TransientCapture.load(path)


@pytest.mark.parametrize("name", ["dot_chart_40cm", "resolution_chart_65cm"])
def test_measured_lct_light_comes_when_it_must(data, name):
    """Light from the nominal depth is the strongest past the direct light, within 5 cm."""
    path = data / "lct_stanford" / f"data_{name}.mat"
    if not path.is_file():
        pytest.skip("the data folder has no lct_stanford")
    capture = TransientCapture.load(path, format="lct", bin_width=1.2e-3, gate_start=0.72)
    nominal = 0.01 * float(name[-4:-2])
    # just before the middle of the wall, where the path is twice the depth
    seen = capture.H[:, 28:36, 28:36].sum(axis=(1, 2)) * capture.times**2
    depth = 0.5 * capture.times[np.argmax(seen)]
    assert depth == pytest.approx(nominal, abs=0.05)


@pytest.mark.parametrize(
    ("held", "at", "value", "words"),
    [
        # scipy's own reader ends the process on the first three
        (np.ones((3, 4, 5)), 184, 8, "type 8"),
        (np.ones((3, 4, 5)), 184, 200, "type 200"),
        (np.ones((3, 4, 5)), 145, 8, "lacks a part of its numbers"),  # said to be complex
        (np.ones((3, 4, 5)), 191, 1, "ends beyond"),
        (np.array([[1.0, "x"]], dtype=object), 163, 1, "lacks some of its"),  # 2^24 cells
    ],
)
def test_broken_elements_of_matlab_files_are_told(tmp_path, held, at, value, words):
    path = tmp_path / "p.mat"
    savemat(path, {"H": held})
    with variables(path) as found:
        assert set(found) == {"H"}
    raw = bytearray(path.read_bytes())
    raw[at] = value
    path.write_bytes(raw)
    with (
        pytest.raises(SceneError, match=f"is a broken MATLAB file.*{words}") as caught,
        variables(path),
    ):
        pass
    assert "\n" not in str(caught.value)


@pytest.fixture
def tal_file(tmp_path):
    """A small capture in y-tal's layout, and a file of the machine whose bytes it must not show."""
    path, secret = tmp_path / "capture.hdf5", tmp_path / "secret.bin"
    secret.write_bytes(np.full(4 * 3 * 3, 7.0).tobytes())
    with h5py.File(tmp_path / "other.hdf5", "w") as other:
        other["H"] = np.full((4, 3, 3), 7.0)
    points = np.stack([*np.meshgrid([0.0, 0.1, 0.2], [0.0, 0.1, 0.2], indexing="ij")], axis=-1)
    points = np.concatenate([points, np.zeros((3, 3, 1))], axis=-1)
    with h5py.File(path, "w") as file:
        file["H"] = np.ones((4, 3, 3))
        file["sensor_grid_xyz"], file["laser_grid_xyz"] = points, np.zeros((1, 1, 3))
        file["delta_t"], file["t_start"] = 0.01, 0.0
        file["t_accounts_first_and_last_bounces"] = 0
    return path


@pytest.mark.parametrize("depth", [0, 1])
def test_types_of_elements_of_matlab_files(depth):
    """Table 1-1 of the format: variables outside, and within them numbers, text and arrays."""
    numbers, texts = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13}, {16, 17, 18}
    for kind in range(21):
        file = io.BytesIO(struct.pack("<II", kind, 0))
        if kind in ({14, 15} if depth == 0 else numbers | texts | {14}):
            assert _check_elements(file, "<", 0, 8, depth) == [kind]
        else:
            with pytest.raises(ValueError, match=f"byte 0 has an element of type {kind} and 0 b"):
                _check_elements(file, "<", 0, 8, depth)


def external_storage(file, folder):
    del file["H"]
    file.create_dataset("H", (4, 3, 3), "f8", external=[(str(folder / "secret.bin"), 0, 288)])


def external_link(file, folder):
    del file["H"]
    file["H"] = h5py.ExternalLink(str(folder / "other.hdf5"), "/H")


def virtual_dataset(file, folder):
    del file["H"]
    layout = h5py.VirtualLayout((4, 3, 3), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "other.hdf5"), "H", shape=(4, 3, 3))
    file.create_virtual_dataset("H", layout)


def soft_link_that_leads_nowhere(file, folder):
    file["unused"] = h5py.SoftLink("/nothing")


def groups_in_a_circle(file, folder):
    del file["scene_info"]
    group = file.create_group("scene_info")
    group["again"] = group


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (external_storage, "has H, whose data are in other files"),
        (external_link, "has H, which is in another file"),
        (virtual_dataset, "has H, whose data are in other files"),
        (soft_link_that_leads_nowhere, "the link unused has no target"),
        (groups_in_a_circle, "nested in more than 32 groups or in a circle"),
    ],
)
def test_data_of_other_files_and_circles_are_refused(spoil, words, tal_file):
    assert TransientCapture.load(tal_file).H.sum() == 36.0
    with h5py.File(tal_file, "r+") as file:
        file.require_dataset("scene_info", (), "f8")
        spoil(file, tal_file.parent)
    with pytest.raises(SceneError, match=words) as caught:
        TransientCapture.load(tal_file)
    assert "\n" not in str(caught.value)


def test_what_a_layout_does_not_need_is_not_read(tal_file):
    with h5py.File(tal_file, "r+") as file:
        file.create_dataset("huge", (1 << 28,), "f8", chunks=(1 << 20,))  # 2 GiB without a byte
    tracemalloc.start()
    try:
        TransientCapture.load(tal_file)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("size", [0, 2, 16 + 3600, 2**64 - 8])
def test_a_heap_whose_objects_do_not_fill_it_is_refused(size, tal_file):
    """HDF5 itself would never end, or read what is after the heap."""
    with h5py.File(tal_file, "r+") as file:
        file["scene_info"] = "{}"  # of variable length
    content = bytearray(tal_file.read_bytes())
    (heap,) = [at for at in range(len(content)) if content[at : at + 4] == b"GCOL"]
    free = heap + 16 + 16 + 8  # after the headers and the text
    assert struct.unpack_from("<HHIQ", content, free) == (0, 0, 0, 4096 - 40)
    struct.pack_into("<Q", content, free + 8, size)
    tal_file.write_bytes(content)
    with pytest.raises(SceneError, match="broken HDF5 file .an object of .* bytes in a heap is"):
        TransientCapture.load(tal_file)


def test_a_heap_of_many_texts_is_read(tal_file):
    with h5py.File(tal_file, "r+") as file:
        file["unused"] = ["x" * length for length in range(2000)]
        del file["unused"]
        file["scene_info"] = '{"text": "' + 100_000 * "y" + '"}'
    assert TransientCapture.load(tal_file).details["text"] == 100_000 * "y"


def test_znlos_that_says_nothing_of_pairs_has_those_of_equal_grids(tmp_path):
    H = DRAW.random((8, 2, 3))
    assert TransientCapture.load(znlos(tmp_path, H, GRID, isConfocal=None)).is_confocal
    single = TransientCapture.load(znlos(tmp_path, H, LASERS[:1, :1], isConfocal=None))
    assert (single.pairing, single.laser_shape) == ("all", ())
    many = znlos(tmp_path, DRAW.random((8, 2, 3, 2, 3)), GRID, isConfocal=None)
    assert TransientCapture.load(many).pairing == "all"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"laser_point": (0.0, 0.0, 0.0)}, "laser_point was given for confocal pairs"),
        ({"outer_legs": "yes"}, "outer_legs = 'yes' must be True or False"),
        ({"side": 1.0}, r"side = 1 m needs a square grid of points, the file has \(2, 3\)"),
    ],
)
def test_arguments_that_do_not_fit_the_file(tmp_path, given, words):
    path = znlos(tmp_path, DRAW.random((8, 2, 3)), GRID, isConfocal=np.array([[1]]))
    with pytest.raises((SceneError, SamplingError), match=words):
        TransientCapture.load(path, **given)


def test_a_side_needs_rows_and_columns(tmp_path):
    path = tmp_path / "p.mat"
    savemat(path, {"dataset": dataset(DRAW.random((8, 6)))})
    with pytest.raises(SamplingError, match=r"the file has \(6,\); omit side"):
        TransientCapture.load(path, side=1.0)


def nested(depth):
    return {"in": nested(depth - 1)} if depth else np.ones((1, 1))


def test_structures_are_nested_in_at_most_32_elements(tmp_path):
    path = tmp_path / "deep.mat"
    savemat(path, {"one": nested(31)})
    with variables(path) as held:
        assert list(held) == ["one"]
    savemat(path, {"one": nested(32)})
    with pytest.raises(SceneError, match="over 32 nested structures"), variables(path):
        pass


def test_an_array_of_structures_is_refused(tmp_path):
    savemat(tmp_path / "two.mat", {"dataset": np.array([(1.0,), (2.0,)], dtype=[("t", "f8")])})
    with (
        variables(tmp_path / "two.mat") as held,
        pytest.raises(SceneError, match="holds an array of 2 structures, must be one"),
    ):
        held["dataset"]


def test_references_are_followed_and_matlabs_own_are_left_out(tmp_path):
    path = written(tmp_path / "r.hdf5", light=np.arange(3.0))
    with h5py.File(path, "a") as file:
        file["#refs#/a"] = np.ones(2)
        file.create_dataset("same", data=file["light"].ref, dtype=h5py.ref_dtype)
        file["circle"] = file["light"].ref
        file["circle"][()] = file["circle"].ref
    with variables(path) as held:
        assert sorted(held) == ["circle", "light", "same"]
        assert np.array_equal(held["same"], [0.0, 1.0, 2.0])
        with pytest.raises(SceneError, match="nested in more than 32 groups or in a circle"):
            held["circle"]


def unreadable(tmp_path, what):
    path = tmp_path / "file"
    if what == "a folder":
        path.mkdir()
    elif what == "a header alone":
        path.write_bytes(b"\x89HDF" + bytes(200))
    else:
        layout = h5py.h5p.create(h5py.h5p.FILE_CREATE)
        layout.set_sizes(4, 4)
        h5py.File(h5py.h5f.create(bytes(path), fcpl=layout)).close()
    return path


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("a folder", "cannot be read (Is a directory); check path and permissions"),
        ("a header alone", "is a broken HDF5 file (its header cannot be read); copy it again"),
        ("short lengths", "is a broken HDF5 file (lengths are not stored in 8 bytes)"),
    ],
)
def test_unreadable_files(tmp_path, what, words):
    with pytest.raises(SceneError) as caught, variables(unreadable(tmp_path, what)):
        pass
    assert words in str(caught.value)


@pytest.mark.parametrize("size", [4, 5])
def test_a_tag_holds_up_to_four_bytes(tmp_path, size):
    """An element inside the tag of a MATLAB v5 file, of an array that has no other."""
    inner = struct.pack("<II", 6 | size << 16, 0)
    head = b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 14, len(inner)) + inner)
    words = "could not read bytes" if size == 4 else "element of type 6 and 5 bytes"
    with pytest.raises(SceneError, match=words), variables(tmp_path / "a.mat"):
        pass


@pytest.mark.parametrize("turned", [False, True])
def test_grids_with_coordinates_first_or_last(tmp_path, turned):
    """Other shapes, also of two axes, are refused."""
    H, points = DRAW.random((8, 2, 3)), GRID if turned else np.moveaxis(GRID, -1, 0)
    found = TransientCapture.load(znlos(tmp_path, H, LASERS[:1, :1], cameraGridPositions=points))
    assert np.array_equal(found.sensor_points, GRID)
    path = znlos(tmp_path, H, LASERS[:1, :1], cameraGridPositions=np.ones((2, 4, 5)))
    with pytest.raises(SamplingError, match=r"has shape \(2, 4, 5\), must be \(3, a, b\) or"):
        TransientCapture.load(path)
