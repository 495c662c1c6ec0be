"""Reader and writer of y-tal's HDF5 layout.

y-tal refuses unknown dataset names but ignores attributes. Data that its layout lacks are therefore
stored in ``scene_info`` (numbers and text, as JSON, a subset of YAML) and in attributes of ``H``
(contributions by bounce, standard error, array-valued details).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import path_of, reason, whole
from ..._whole_files import whole_files
from ...errors import SamplingError, SceneError
from .layouts import Values, array, number, triple, upright

Array = NDArray[Any]

#: Names of the attributes of ``H``; the first and last are prefixes.
PART, ERROR, DETAIL = "by_bounce_", "standard_error", "details_"
#: Key of the names of the origins that are not known; zeros stand for them in the layout.
UNKNOWN = "unknown_origins"


def save(capture: Any, path: str | Path, *, compression: int = 0) -> None:
    """Write a `TransientCapture` to an HDF5 file in y-tal's layout, atomically."""
    import h5py

    path = path_of("path", path)
    level = whole("compression", compression, 0, 9)
    # attributes larger than 64 KiB need the file format of HDF5 1.8
    with whole_files(path) as (draft,), h5py.File(draft, "w", libver=("v108", "v108")) as file:
        _write(file, capture, level)


def _write(file: Any, capture: Any, level: int) -> None:
    import h5py

    laser, sensor, form = _axes(capture)
    lasers = () if form in ("T_Sx_Sy", "T_Si") else laser

    def stored(values: Array) -> Array:
        return _turned(values.reshape(-1, *lasers, *sensor), len(lasers), len(sensor))

    packed = {"compression": "gzip", "compression_opts": level} if level else {}
    H = file.create_dataset("H", data=stored(capture.H), **packed)
    for bounce, part in capture.by_bounce.items():
        H.attrs[f"{PART}{bounce}"] = _brief(stored(part), H)
    if capture.standard_error is not None:
        H.attrs[ERROR] = _brief(stored(capture.standard_error), H)
    for key, value in capture.details.items():
        if _is_array(value):
            H.attrs[f"{DETAIL}{key}"] = value
    forms = {"UNKNOWN": 0, "T_Sx_Sy": 1, "T_Lx_Ly_Sx_Sy": 2, "T_Si": 3, "T_Li_Si": 4}
    _write_enum(file, "H_format", form, forms)
    for name, shape in (("laser", laser), ("sensor", sensor)):
        points = getattr(capture, f"{name}_points")
        normals = getattr(capture, f"{name}_normals")
        if normals is None:
            normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
        origin = getattr(capture, f"{name}_origin")
        if origin is None and not capture.outer_legs:
            # y-tal wants three numbers, and uses them for outer legs only; with such legs zeros
            # would give it a wrong path in silence
            origin = (0.0, 0.0, 0.0)
        file[f"{name}_xyz"] = h5py.Empty(float) if origin is None else np.array(origin)
        file[f"{name}_grid_xyz"] = _stored_points(points, shape)
        file[f"{name}_grid_normals"] = _stored_points(normals, shape)
        grid = "X_Y_3" if len(shape) == 2 else "N_3"
        _write_enum(file, f"{name}_grid_format", grid, {"UNKNOWN": 0, "N_3": 1, "X_Y_3": 2})
    volumes = {"UNKNOWN": 0, "N_3": 1, "X_Y_Z_3": 2, "X_Y_3": 3}
    _write_enum(file, "volume_format", "X_Y_Z_3", volumes)
    file["delta_t"] = capture.delta_t
    file["t_start"] = capture.t_start
    file["t_accounts_first_and_last_bounces"] = capture.outer_legs
    file["scene_info"] = json.dumps(_scene_info(capture), ensure_ascii=False, default=_plain)


def _axes(capture: Any) -> tuple[tuple[int, ...], tuple[int, ...], str]:
    """Return shapes of laser and sensor points that y-tal supports, and its name for the format."""
    laser, sensor = capture.laser_shape, capture.sensor_shape
    if capture.pairing == "confocal":
        if len(sensor) == 2:
            return sensor, sensor, "T_Sx_Sy"
        count = int(np.prod(sensor))
        return (count,), (count,), "T_Si"
    if laser == () and len(sensor) == 2:
        return (1, 1), sensor, "T_Sx_Sy"
    if len(laser) in (0, 2) and len(sensor) in (0, 2) and laser:
        return laser, sensor or (1, 1), "T_Lx_Ly_Sx_Sy"
    sensors = (int(np.prod(sensor)),)
    return ((1,), sensors, "T_Si") if laser == () else ((int(np.prod(laser)),), sensors, "T_Li_Si")


def _brief(values: Array, H: Any) -> Any:
    """Return a short form of bins: "H" if they equal ``H``, one number if all are the same."""
    if values.dtype == H.dtype and np.array_equal(values, H[...]):
        return "H"
    return values.flat[0] if (values == values.flat[0]).all() else values


def _at_length(value: Any, H: Array) -> Array:
    """Return the bins of ``H``'s shape from their short form by `_brief`."""
    if isinstance(value, str):
        return H
    bins = np.asarray(value)
    return np.full(H.shape, bins) if bins.ndim == 0 else bins


def _turned(values: Array, lasers: int, sensors: int) -> Array:
    """Return bins with the axes of two-dimensional grids swapped, [y, x] to [x, y] or back."""
    for first, count in ((1, lasers), (1 + lasers, sensors)):
        if count == 2:
            values = values.swapaxes(first, first + 1)
    return np.ascontiguousarray(values)


def _stored_points(points: Array, shape: tuple[int, ...]) -> Array:
    points = points.reshape(*shape, 3)
    return np.ascontiguousarray(points.swapaxes(0, 1) if len(shape) == 2 else points)


def _write_enum(file: Any, key: str, name: str, members: dict[str, int]) -> None:
    import h5py

    item = file.create_dataset(key, (1,), dtype=h5py.enum_dtype(members, basetype="i"))
    item[0] = members[name]


def _scene_info(capture: Any) -> dict[str, Any]:
    from ... import __version__

    return {
        "original_format": f"nlosoptics {__version__}",
        "nlosoptics": {
            "pairing": capture.pairing,
            "quantity": capture.quantity,
            "laser_shape": list(capture.laser_shape),
            "sensor_shape": list(capture.sensor_shape),
            UNKNOWN: [n for n in ("laser", "sensor") if getattr(capture, f"{n}_origin") is None],
            "details": {k: v for k, v in capture.details.items() if not _is_array(v)},
        },
    }


def _is_array(value: Any) -> bool:
    """Whether HDF5 can store a value as an array."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 0


def _plain(value: Any) -> Any:
    """Convert a value without a JSON form: arrays to lists, mappings to dicts, others to text."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else str(value)


def read(variables: Mapping[str, Any]) -> Values:
    """Read y-tal's layout; a capture written by `save` is restored exactly."""
    info = _info(variables.get("scene_info"))
    H = array(variables, "H", 2, 3, 5)
    points = {name: _points(variables, f"{name}_grid_xyz") for name in ("laser", "sensor")}
    lasers, sensors = (None if at is None else at.shape[:-1] for at in points.values())
    lasers, paired = _pairs(H, lasers, sensors)
    attributes = {
        key.removeprefix("H@"): value for key, value in variables.items() if key.startswith("H@")
    }
    parts = {
        int(key.removeprefix(PART)): _at_length(value, H)
        for key, value in attributes.items()
        if key.startswith(PART) and key.removeprefix(PART).isdecimal()
    }
    values = {
        "H": H,
        "sensor_points": points["sensor"],
        "laser_points": points["laser"],
        "sensor_normals": _normals(variables, "sensor", points["sensor"]),
        "laser_normals": _normals(variables, "laser", points["laser"]),
        "sensor_origin": triple(variables, "sensor_xyz"),
        "laser_origin": triple(variables, "laser_xyz"),
        "delta_t": number(variables, "delta_t"),
        "t_start": number(variables, "t_start"),
        "pairing": paired,
        "outer_legs": _flag(variables, "t_accounts_first_and_last_bounces"),
        "quantity": "unknown",
        "by_bounce": parts,
        "standard_error": _at_length(attributes[ERROR], H) if ERROR in attributes else None,
        "details": {
            key.removeprefix(DETAIL): np.asarray(value)
            for key, value in attributes.items()
            if key.startswith(DETAIL)
        },
    }
    ours = info.get("nlosoptics")
    return _own(values, ours) if isinstance(ours, Mapping) else _foreign(values, info, lasers)


def _info(text: Any) -> dict[str, Any]:
    """Parse ``scene_info`` to a mapping; text that is no JSON is kept under its name."""
    if text is None or text == "":
        return {}
    try:
        info = json.loads(text)
    except (TypeError, ValueError):
        info = None
    return info if isinstance(info, dict) else {"scene_info": str(text)}


def _flag(variables: Mapping[str, Any], key: str) -> bool | None:
    """Return a flag of the file, None if it is absent."""
    values = np.asarray(variables.get(key, ()))
    if values.size == 0 or values.ravel()[0] is None:
        return None
    if values.dtype.kind not in "biuf" or values.ravel()[0] not in (0, 1):
        raise SceneError(f"{key} = {values.ravel()[0]} is neither 0 nor 1; correct the file")
    return bool(values.ravel()[0])


def _points(variables: Mapping[str, Any], key: str) -> Array | None:
    if variables.get(key) is None:
        return None
    values = np.asarray(array(variables, key, 1, 2, 3), dtype=np.float64)
    if values.shape[-1] != 3:
        raise SamplingError(
            f"{key} has shape {values.shape}, must be (n, 3) or (nx, ny, 3); correct the file"
        )
    return values if values.ndim > 1 else values[None]


def _normals(variables: Mapping[str, Any], name: str, points: Array | None) -> Array | None:
    """Return the normals of the points, None if all are +z or absent."""
    normals = _points(variables, f"{name}_grid_normals")
    if normals is None or points is None or (normals == (0.0, 0.0, 1.0)).all():
        return None
    if normals.shape != points.shape:
        raise SamplingError(
            f"{name}_grid_normals has shape {normals.shape}, must be {points.shape} like "
            f"{name}_grid_xyz; correct the file"
        )
    return normals


def _pairs(
    H: Array, lasers: tuple[int, ...] | None, sensors: tuple[int, ...] | None
) -> tuple[tuple[int, ...] | None, str | None]:
    """Return the laser axes of ``H`` and the pairing, each None if the file leaves it open.

    The pairing follows from the axes of ``H`` and the number of laser points: one laser point
    means "all", a grid like that of the sensors without axes of its own in ``H`` "confocal".
    """
    if sensors is None:
        return (None, None) if lasers is None else ((), "all")
    if H.shape[1:] == sensors:
        if lasers is None:
            return None, None
        count = int(np.prod(lasers))
        if count == 1:
            return (), "all"
        if lasers == sensors:
            return lasers, "confocal"
        raise SamplingError(
            f"H {H.shape} has no laser axes, {count} laser points are neither one nor paired with "
            f"the sensor points {sensors}; correct the file"
        )
    if lasers is not None and H.shape[1:] == lasers + sensors:
        return lasers, "all"
    raise SamplingError(
        f"H has shape {H.shape}, must be (n_bins, *{sensors}) or (n_bins, *{lasers}, *{sensors}) "
        "for its grids; correct the file"
    )


def _own(values: Values, ours: Mapping[str, Any]) -> Values:
    """Restore the axes of a capture that was written by `save`."""
    try:
        laser, sensor = (tuple(map(int, ours[f"{name}_shape"])) for name in ("laser", "sensor"))
        values["pairing"], values["quantity"] = str(ours["pairing"]), str(ours["quantity"])
        values["details"] |= ours["details"]
        for name in ours.get(UNKNOWN, ()):
            if not np.any(values[f"{name}_origin"] or 0.0):
                values[f"{name}_origin"] = None
        axes = sensor if values["pairing"] == "confocal" else laser + sensor
        points = values["sensor_points"]
        grid = 2 if points is not None and points.ndim == 3 else 1
        lasers = values["H"].ndim - 1 - grid

        def restored(bins: Array | None) -> Array | None:
            return None if bins is None else _turned(bins, lasers, grid).reshape(-1, *axes)

        for key in ("H", "standard_error"):
            values[key] = restored(values[key])
        values["by_bounce"] = {n: restored(part) for n, part in values["by_bounce"].items()}
        for name, shape in {"laser": laser, "sensor": sensor}.items():
            for key in (f"{name}_points", f"{name}_normals"):
                if values[key] is not None:
                    at = values[key].swapaxes(0, 1) if values[key].ndim == 3 else values[key]
                    values[key] = at.reshape(*shape, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise SceneError(
            f"scene_info.nlosoptics does not fit the arrays ({reason(error)}), the "
            "file was changed; save the capture again"
        ) from None
    return values


def _foreign(values: Values, info: dict[str, Any], lasers: tuple[int, ...] | None) -> Values:
    """Convert a capture of another program from [x, y] to rising [y, x]."""
    values["details"] = {key: value for key, value in info.items() if key != "ground_truth"}
    if values["pairing"] == "all" and lasers == () and values["laser_points"] is not None:
        for key in ("laser_points", "laser_normals"):
            if values[key] is not None:
                values[key] = values[key].reshape(3)
    if values["sensor_points"] is None and values["H"].ndim == 3:
        values["H"] = values["H"].swapaxes(1, 2)  # the layout defines [x, y]
        return values
    return upright(values)
