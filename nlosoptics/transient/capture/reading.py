"""Reading of capture files: y-tal's layout, which is also ours, Z-NLOS and the LCT's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, pair, path_of, positive, real, reason
from ...errors import NlosError, SamplingError, SceneError
from . import tal_files
from .layouts import Values, array, number, triple, upright
from .wall_points import wall_grid

T = TypeVar("T")
Array = NDArray[Any]
LIGHT: Final = 299792458.0  # m/s
#: What a capture needs, and what a user has to give if the file does not state it.
NEEDED: Final = {
    "sensor_points": "points observed by the sensor, m, or side",
    "pairing": "'confocal' or 'all'",
    "laser_points": "points lit by the laser, m",
    "delta_t": "width of a bin, m of optical path",
    "t_start": "start of bin 0, m of optical path",
    "outer_legs": "whether times include the paths from laser to wall and from wall to sensor",
}


def load_capture(
    capture: Callable[..., T],
    path: str | Path,
    given: Mapping[str, Any],
    *,
    array: str | None = None,
    axes: str = "t,y,x",
    side: Any = None,
) -> T:
    """Read a file and return ``capture(**values)``; the values in ``given`` replace the file's.

    ``capture`` is the class `TransientCapture`; the others are arguments of its method ``load``.
    """
    path = path_of("path", path)
    if not path.is_file():
        what = "a folder" if path.is_dir() else "missing"
        raise SceneError(f"{path}: the capture file is {what}; give the path of an HDF5 or .mat")
    with _in_file(path):
        given = {name: value for name, value in given.items() if value is not None}
        values = _stated(path) if array is None else _plain(read_variables(path), array, axes, side)
        for name in ("laser", "sensor"):
            if f"{name}_points" in given:
                values[f"{name}_normals"] = None
        values |= given
        if values.get("pairing") is None and (array is not None or "laser_points" in given):
            values["pairing"] = "all" if "laser_points" in given else "confocal"
        if values.get("pairing") == "confocal" and values.get("laser_points") is None:
            values["laser_points"] = values.get("sensor_points")
            values["laser_normals"] = values.get("sensor_normals")
        missing = [f"{n} ({what})" for n, what in NEEDED.items() if values.get(n) is None]
        if missing:
            raise SceneError(f"the file does not state all values; give {', '.join(missing)}")
        step = positive("delta_t", _path("delta_t", values["delta_t"], 1e-7), unit="m")
        if step > 10.0:
            raise SceneError(
                f"delta_t = {step:g} is too long for m of optical path, limit 10 m; if it is in "
                f"ps, give delta_t = {step * 1e-12 * LIGHT:.6g} (m)"
            )
        _path("t_start", values["t_start"], 1e-6 * step)
        return capture(**values)


def _path(name: str, value: Any, least: float) -> float:
    """Return a length of optical path; refuse one that must be in seconds."""
    length = real(name, value)
    if 0.0 < abs(length) < least:
        raise SceneError(
            f"{name} = {length:g} is too short for a length in m, limit {least:g} m; if it is in "
            f"seconds, give {name} = {length * LIGHT:.6g} (m of optical path)"
        )
    return length


@contextmanager
def _in_file(path: Path) -> Iterator[None]:
    """Prefix errors raised in the context with the file's name."""
    try:
        yield
    except NlosError as error:
        text = str(error)
        raise type(error)(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _stated(path: Path) -> Values:
    """Return the arguments of a `TransientCapture` that a file states."""
    variables = read_variables(path)
    if "H" in variables:
        return tal_files.read(variables)
    if "cameraGridPositions" in variables:
        return _read_znlos(variables)
    if "rect_data" in variables and "width" in variables:
        return _read_lct(variables)
    names = ", ".join(sorted(variables)[:8]) or "nothing"
    raise SceneError(
        f"holds {names}, which is no known layout; give a file of y-tal (H), Z-NLOS (data, "
        "cameraGridPositions) or LCT (rect_data, width), or name the array, its axes and its side"
    )


def _plain(variables: Mapping[str, Any], name: str, axes: str, side: Any) -> Values:
    """Return the values of a capture in an array of any name and order of axes.

    ``axes`` names them as in "y,-x,t"; an axis with a minus runs against the world's.
    """
    if name not in variables:
        raise SceneError(f"holds no {name}; give one of {', '.join(sorted(variables)[:8])}")
    signed = [axis.strip() for axis in axes.split(",")]
    order = [axis.lstrip("-") for axis in signed]
    if sorted(order) != ["t", "x", "y"]:
        raise SceneError(f"axes = {axes!r} must name t, y and x once each; give such as 'y,x,-t'")
    data = array(variables, name, 3)
    data = np.flip(data, tuple(k for k, axis in enumerate(signed) if axis[:1] == "-"))
    H = np.ascontiguousarray(data.transpose([order.index(axis) for axis in "tyx"]))
    values: Values = {"H": H, "t_start": 0.0, "outer_legs": False, "quantity": "unknown"}
    if side is not None:
        width, height = pair("side", side)
        y, x = (
            (np.arange(n) + 0.5) / n * size - 0.5 * size
            for n, size in zip(H.shape[1:], (height, width), strict=True)
        )
        values["sensor_points"] = np.stack([*np.meshgrid(x, y), np.zeros(H.shape[1:])], axis=-1)
    return values


def read_variables(path: Path) -> dict[str, Any]:
    """Return the variables of an HDF5, MATLAB (v5, v7.3) or numpy file, and ``H``'s attributes.

    Arrays written by MATLAB get MATLAB's order of axes. An attribute has the key ``H@name``, an
    empty variable the value None. The variable of an ``.npy`` file is called "array".
    """
    import h5py
    from scipy.io import loadmat

    try:
        with path.open("rb") as file:
            head = file.read(128)
        if head.startswith((b"\x93NUMPY", b"PK")):
            with np.load(path) if head.startswith(b"PK") else nullcontext() as several:
                return {"array": np.load(path)} if several is None else dict(several)
        if head.startswith(b"\x89HDF") or h5py.is_hdf5(path):
            with h5py.File(path, "r") as opened:
                size = float(sum(item.nbytes for item in _datasets(opened).values()))
                fits_memory("the file", size, "free memory, or load a smaller capture")
                matlab = head.startswith(b"MATLAB 7.3")
                found = {name: _value(item, matlab) for name, item in _datasets(opened).items()}
                if "H" in found:
                    found |= {f"H@{key}": opened["H"].attrs[key] for key in opened["H"].attrs}
                return found
        if head[126:128] in (b"IM", b"MI"):
            found = loadmat(path)
            return {
                name: value if np.size(value) else None
                for name, value in found.items()
                if not name.startswith("__")
            }
    except NlosError:
        raise
    except Exception as error:  # both libraries raise errors of many types
        raise SceneError(f"is broken ({reason(error)}); copy or write it again") from None
    raise SceneError("is neither HDF5 nor a MATLAB or numpy file; give a capture in such a format")


def _datasets(file: Any) -> dict[str, Any]:
    import h5py

    # names with # are MATLAB's own
    items = {name: file[name] for name in file if not name.startswith("#")}
    return {name: item for name, item in items.items() if isinstance(item, h5py.Dataset)}


def _value(item: Any, matlab: bool) -> Any:
    """Return the value of an HDF5 dataset."""
    if item.shape is None or item.attrs.get("MATLAB_empty", 0):
        return None
    value = item[()]
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.T if matlab and isinstance(value, np.ndarray) else value


def _read_znlos(variables: Mapping[str, Any]) -> Values:
    """Read a Z-NLOS capture [1]_; colours and bounces are summed, times include the outer legs.

    Data are (colours, t, bounces, *sensor, *laser), or in reverse order. The grid points show which
    index runs along x. Data and grids have the same index order.

    References
    ----------
    .. [1] Galindo et al., A dataset for benchmarking time-resolved non-line-of-sight imaging,
       ICCP 2019.
    """
    data = array(variables, "data", 5, 7)
    sensors, lasers = (_grid(variables, f"{name}GridPositions") for name in ("camera", "laser"))
    normals = {
        name: _grid(variables, f"{name}GridNormals") if f"{name}GridNormals" in variables else None
        for name in ("camera", "laser")
    }
    paired, many = lasers.shape == sensors.shape, data.ndim == 7
    confocal = number(variables, "isConfocal")
    confocal = not many and paired if confocal is None else bool(confocal)
    alone = lasers.shape[:2] == (1, 1)
    if (confocal and not paired) or not (many or confocal or alone):
        raise SamplingError(
            f"data of shape {data.shape} with isConfocal = {int(confocal)} do not fit the laser "
            f"points {lasers.shape[:2]} and sensor points {sensors.shape[:2]}; correct the file"
        )
    H = _znlos_bins(data, sensors.shape[:2], lasers.shape[:2], number(variables, "t"))
    values = upright(
        {
            "H": H if many or confocal else H[:, None, None],
            "sensor_points": sensors,
            "laser_points": lasers,
            "sensor_normals": normals["camera"],
            "laser_normals": normals["laser"],
            "sensor_origin": triple(variables, "cameraPosition"),
            "laser_origin": triple(variables, "laserPosition"),
            "delta_t": number(variables, "deltaT"),
            "t_start": number(variables, "t0"),
            "pairing": "confocal" if confocal else "all",
            "outer_legs": True,
            "quantity": "unknown",
            "details": {
                key: np.asarray(variables[key]).ravel().tolist()
                for key in ("hiddenVolumePosition", "hiddenVolumeSize")
                if variables.get(key) is not None
            },
        }
    )
    if alone and not confocal:
        values["H"], values["laser_points"] = values["H"][:, 0, 0], lasers[0, 0]
        if values["laser_normals"] is not None:
            values["laser_normals"] = values["laser_normals"][0, 0]
    return values


def _znlos_bins(
    data: Array, sensors: tuple[int, ...], lasers: tuple[int, ...], n_bins: float | None
) -> Array:
    """Return bins (n_bins, *laser, *sensor) of Z-NLOS data; ``n_bins`` tells the order of axes."""
    many = data.ndim == 7
    grids = sensors + (lasers if many else ())
    if data.shape[3:] == grids and n_bins in (None, data.shape[1]):
        total = data.sum(axis=(0, 2), dtype=np.float64)
        return np.moveaxis(total, (1, 2), (3, 4)) if many else total
    reverse = (lasers if many else ()) + sensors
    if data.shape[:-3] == reverse and n_bins in (None, data.shape[-2]):
        return np.moveaxis(data.sum(axis=(-1, -3), dtype=np.float64), -1, 0)
    raise SamplingError(
        f"data has shape {data.shape}, must be (colours, {n_bins or 't'}, bounces, "
        f"{', '.join(map(str, grids))}) for its grids, or in reverse order; correct the file"
    )


def _grid(variables: Mapping[str, Any], key: str) -> Array:
    """Return points (a, b, 3) stored as (3, a, b), as (a, b, 3) or as three numbers."""
    values = np.asarray(array(variables, key, 1, 2, 3), dtype=np.float64)
    if values.size == 3:
        return values.reshape(1, 1, 3)
    if values.ndim == 3 and 3 in (values.shape[0], values.shape[-1]):
        return np.moveaxis(values, 0, -1) if values.shape[0] == 3 else values
    raise SamplingError(
        f"{key} has shape {values.shape}, must be (3, a, b) or (a, b, 3); correct the file"
    )


def _read_lct(variables: Mapping[str, Any]) -> Values:
    """Read an LCT capture [1]_: rectified confocal counts (x, y, t); ``width`` is half the side.

    The front view that its authors publish is what a viewer sees who looks from the wall into the
    room: the second index grows downward in it and the first one to the left, since they reverse
    the first one for display. In this library y points up and z into the room, so that x grows to
    the left of this viewer, too. The second index alone is therefore reversed.

    References
    ----------
    .. [1] O'Toole, Lindell and Wetzstein, Confocal non-line-of-sight imaging based on the
       light-cone transform, Nature 555, 338 (2018).
    """
    data = array(variables, "rect_data", 3)
    width = number(variables, "width")
    nx, ny, _ = data.shape
    if width is None or nx != ny:
        raise SceneError(
            f"width = {width} and rect_data of {nx} x {ny} points are not a square wall, must have "
            "as many points along x as along y; correct the file"
        )
    return {
        "H": np.ascontiguousarray(np.moveaxis(data, 2, 0)[:, :, ::-1].swapaxes(1, 2)),
        "sensor_points": wall_grid(2.0 * positive("width", width, unit="m"), nx),
        "t_start": 0.0,
        "pairing": "confocal",
        "outer_legs": False,
        "quantity": "counts",
    }
