"""Readers of captures from other projects: Z-NLOS, NLOS-DIRAC, phasor field 2019 and 2020, LCT.

Each reader sets the values that its layout defines. Values that the layout leaves open stay None,
with the reason in ``needs`` or ``doubt``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import positive
from ...errors import SamplingError, SceneError
from .layouts import LIGHT, Found, array, bins, number, triple, upright
from .wall_points import wall_grid

Array = NDArray[Any]


def read_znlos(variables: Mapping[str, Any]) -> Found:
    """Read a Z-NLOS capture [1]_; colours and bounces are summed, times include the outer legs.

    The grid points show which index runs along x. Data and grids have the same index order.

    References
    ----------
    .. [1] Galindo et al., A dataset for benchmarking time-resolved non-line-of-sight imaging,
       ICCP 2019.
    """
    data = array(variables, "data", 5, 7)
    sensors, lasers = (_grid(variables, f"{name}GridPositions") for name in ("camera", "laser"))
    confocal = number(variables, "isConfocal")
    if confocal is None and data.ndim == 5 and lasers.shape == sensors.shape:
        confocal = 1.0
    n_bins = number(variables, "t")
    H = _znlos_bins(data, sensors.shape[:2], lasers.shape[:2], n_bins)
    normals = {
        name: _grid(variables, f"{name}GridNormals") if f"{name}GridNormals" in variables else None
        for name in ("camera", "laser")
    }
    if confocal and lasers.shape != sensors.shape:
        raise SamplingError(
            f"isConfocal is 1, but laser points {lasers.shape[:2]} are not paired with sensor "
            f"points {sensors.shape[:2]}, shapes must be equal; correct the file"
        )
    if data.ndim == 5 and not confocal:
        if lasers.shape[:2] != (1, 1):
            raise SamplingError(
                f"data of shape {data.shape} has no laser axes, must have 7 axes for isConfocal = "
                f"0 and {lasers.shape[:2]} laser points; correct the file"
            )
        H = H[:, None, None]
    found = Found(
        layout="znlos",
        H=H,
        sensor_points=sensors,
        laser_points=lasers,
        sensor_normals=normals["camera"],
        laser_normals=normals["laser"],
        sensor_origin=triple(variables, "cameraPosition"),
        laser_origin=triple(variables, "laserPosition"),
        delta_t=number(variables, "deltaT"),
        t_start=number(variables, "t0"),
        pairing="confocal" if confocal else "all",
        outer_legs=True,
        details=_lists(variables, "hiddenVolumePosition", "hiddenVolumeSize"),
    )
    found = upright(found)
    if found.pairing == "all" and lasers.shape[:2] == (1, 1):
        found.H, found.laser_points = found.H[:, 0, 0], lasers[0, 0]
        if found.laser_normals is not None:
            found.laser_normals = found.laser_normals[0, 0]
    return found


def _znlos_bins(
    data: Array, sensors: tuple[int, ...], lasers: tuple[int, ...], n_bins: float | None
) -> Array:
    """Return bins (n_bins, *laser, *sensor) from data (colours, t, bounces, *sensor, *laser).

    The axes may also be stored in reverse order, then with ``(*laser, *sensor)``; the order within
    each grid is that of its points in both cases.
    """
    many = data.ndim == 7
    ways = (
        (1, (0, 2), sensors + (lasers if many else ()), slice(3, None)),
        (-2, (-1, -3), (lasers if many else ()) + sensors, slice(None, -3)),
    )
    for t, added, wanted, at in ways:
        if data.shape[at] == wanted and n_bins in (None, data.shape[t]):
            total = data.sum(axis=tuple(i % data.ndim for i in added), dtype=np.float64)
            if t == 1:
                return np.moveaxis(total, (1, 2), (3, 4)) if many else total
            return np.moveaxis(total, -1, 0)
    raise SamplingError(
        f"data has shape {data.shape}, must be (colours, {n_bins or 't'}, bounces, "
        f"{', '.join(map(str, ways[0][2]))}) for its grids, or in reverse order; correct the file"
    )


def read_dirac(variables: Mapping[str, Any]) -> Found:
    """Read an NLOS-DIRAC capture: bins (t, x, y) at times ``da`` on the grid ``xg``, ``yg``, m."""
    H = array(variables, "data_t", 3)
    x, y = array(variables, "xg", 2), array(variables, "yg", 2)
    times = array(variables, "da", 1, 2).ravel()
    if x.shape != H.shape[1:] or y.shape != x.shape or times.size != H.shape[0]:
        raise SamplingError(
            f"data_t has shape {H.shape}, must be ({times.size}, nx, ny) for da with xg {x.shape} "
            f"and yg {y.shape}; correct the file"
        )
    points = np.stack([x, y, np.zeros(x.shape)], axis=-1)
    return upright(
        Found(
            layout="dirac",
            H=bins(H),
            sensor_points=points,
            delta_t=float(times[1] - times[0]) if times.size > 1 else None,
            needs={
                "pairing": "NLOS-DIRAC does not say whether its pairs are confocal",
                "t_start": "NLOS-DIRAC does not say where bin 0 starts",
                "outer_legs": "NLOS-DIRAC does not say which legs its times include",
            },
        )
    )


def read_phasor_field_2019(variables: Mapping[str, Any]) -> Found:
    """Read a phasor-field capture of 2019 [1]_: a structure ``dataset`` with lists of points.

    The laser scans and the sensor is fixed. By reciprocity, the scanned points are returned as
    sensor points, as in y-tal. Times include the outer legs.

    References
    ----------
    .. [1] Liu et al., Non-line-of-sight imaging using phasor-field virtual wave optics, Nature
       572, 620 (2019).
    """
    dataset = variables["dataset"]
    if not isinstance(dataset, Mapping):
        raise SceneError(
            "dataset is not a structure, must hold data, laserPos, cameraPos and more; give a "
            "capture of the phasor field"
        )
    data = array(dataset, "data", 3)
    scanned, fixed = (_list(dataset, f"{name}Pos") for name in ("laser", "camera"))
    n_bins = number(dataset, "t")
    if fixed.shape[0] != 1:
        raise SceneError(
            f"dataset.cameraPos has {len(fixed)} points, limit 1 in this layout; build a "
            "TransientCapture from the arrays"
        )
    # (laser, sensor, t) in MATLAB's order
    if data.shape[:2] == (len(scanned), 1):
        H = data[:, 0].T
    elif data.shape[1:] == (1, len(scanned)):
        H = data[:, 0]
    else:
        raise SamplingError(
            f"dataset.data has shape {data.shape}, must be ({len(scanned)}, 1, n_bins) for "
            "dataset.laserPos; correct the file"
        )
    if n_bins is not None and int(n_bins) != H.shape[0]:
        raise SamplingError(
            f"dataset.t = {n_bins:g} bins, dataset.data has {H.shape[0]}; correct the file"
        )
    return Found(
        layout="phasor_field_2019",
        H=bins(H),
        sensor_points=scanned,
        laser_points=fixed[0],
        sensor_normals=_normals(dataset, "laserNorm", len(scanned)),
        sensor_origin=triple(dataset, "laserOrigin"),
        laser_origin=triple(dataset, "cameraOrigin"),
        delta_t=number(dataset, "deltat"),
        t_start=number(dataset, "t0"),
        pairing="all",
        outer_legs=True,
        quantity="counts",
        details={"swapped": "laser and sensor", **_lists(variables, "minimalpos", "maximalpos")},
    )


def read_phasor_field_2020(variables: Mapping[str, Any]) -> Found:
    """Read a phasor-field capture of 2020 [1]_: rectified counts (y, x, t), one sensor point.

    The bin width in the file is in seconds. The scanned points are returned as sensor points at
    (i - n/2) times the spacing, as in y-tal. ``SPAD_index`` is the index (x, y) of the fixed point.
    The file does not say whether it counts from 0 or 1. The user therefore gives ``laser_point``,
    or confirms with ``format`` that it counts from 0, as y-tal assumes.

    References
    ----------
    .. [1] Liu, Bauer and Velten, Phasor field diffraction based reconstruction for fast
       non-line-of-sight imaging systems, Nature Communications 11, 1645 (2020).
    """
    data = array(variables, "rect_data", 3)
    seconds, pitch = number(variables, "ts"), number(variables, "sampling_spacing")
    if pitch is None:
        raise SceneError(
            "sampling_spacing is empty, must be the pitch of the scan in m; correct the file"
        )
    ny, nx, _ = data.shape
    points = np.zeros((ny, nx, 3))
    points[..., 0] = (np.arange(nx) - nx / 2) * positive("sampling_spacing", pitch, unit="m")
    points[..., 1] = ((np.arange(ny) - ny / 2) * pitch)[:, None]
    return Found(
        layout="phasor_field_2020",
        H=bins(np.moveaxis(data, 2, 0)),
        sensor_points=points,
        laser_points=_index_point(variables, points),
        delta_t=None if seconds is None else _seconds("ts", seconds) * LIGHT,
        t_start=0.0,
        pairing="all",
        outer_legs=False,
        quantity="counts",
        details={"swapped": "laser and sensor"},
        doubt="SPAD_index may count from 0, as y-tal assumes, or from 1",
        instead=("laser_point",),
    )


def _index_point(variables: Mapping[str, Any], points: Array) -> Array | None:
    if variables.get("SPAD_index") is None:
        return None
    at = np.asarray(array(variables, "SPAD_index", 1, 2), dtype=np.float64).ravel()
    counts = at.size == 2 and bool((at == np.floor(at)).all() and (at >= 0).all())
    if not counts or at[0] >= points.shape[1] or at[1] >= points.shape[0]:
        raise SceneError(
            f"SPAD_index = {at.tolist()} is no point of the {points.shape[1]} x {points.shape[0]} "
            "grid; correct the file"
        )
    return np.asarray(points[int(at[1]), int(at[0])])


def read_lct(variables: Mapping[str, Any]) -> Found:
    """Read an LCT capture [1]_: rectified confocal counts (x, y, t); ``width`` is half the side.

    For a viewer who looks from the wall into the room, x grows to the right and y downward in the
    file. In this library y points up and z into the room, so that x grows to the left. Both indices
    are therefore reversed; otherwise the scene would be rotated by 180 degrees about z.

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
    H = np.moveaxis(data, 2, 0)[:, ::-1, ::-1].swapaxes(1, 2)
    return Found(
        layout="lct",
        H=bins(H),
        sensor_points=wall_grid(2.0 * positive("width", width, unit="m"), nx),
        t_start=0.0,
        pairing="confocal",
        outer_legs=False,
        quantity="counts",
        needs={
            "bin_width": "the LCT layout does not store the width of its bins",
            "gate_start": "the first bins of an LCT capture can be direct light",
        },
        doubt=f"rect_data with width = {width:g} looks like the LCT layout, in which pairs are "
        "confocal and width is half the wall's side",
        instead=("pairing", "side"),
    )


def _seconds(name: str, value: float) -> float:
    if not 0.0 < value < 1e-6:
        raise SceneError(
            f"{name} = {value:g} is no bin width in s, must be above 0 and below 1e-06; give "
            "bin_width in m of optical path"
        )
    return value


def _grid(variables: Mapping[str, Any], key: str) -> Array:
    """Return points (a, b, 3) stored as (3, a, b), as (a, b, 3) or as three numbers."""
    values = np.asarray(array(variables, key, 1, 2, 3), dtype=np.float64)
    if values.size == 3:
        return values.reshape(1, 1, 3)
    if values.ndim == 3 and values.shape[0] == 3:
        return np.moveaxis(values, 0, -1)
    if values.ndim == 3 and values.shape[-1] == 3:
        return values
    raise SamplingError(
        f"{key} has shape {values.shape}, must be (3, a, b) or (a, b, 3); correct the file"
    )


def _list(variables: Mapping[str, Any], key: str) -> Array:
    """Return points (n, 3) stored as (n, 3), as (3, n) or as three numbers."""
    values = np.asarray(array(variables, key, 1, 2), dtype=np.float64)
    if values.size == 3:
        return values.reshape(1, 3)
    if values.ndim == 2 and values.shape[1] == 3:
        return values
    if values.ndim == 2 and values.shape[0] == 3:
        return values.T
    raise SamplingError(f"{key} has shape {values.shape}, must be (n, 3); correct the file")


def _normals(variables: Mapping[str, Any], key: str, count: int) -> Array | None:
    if variables.get(key) is None:
        return None
    normals = _list(variables, key)
    return np.repeat(normals, count, axis=0) if len(normals) == 1 else normals


def _lists(variables: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {
        key: np.asarray(variables[key]).ravel().tolist()
        for key in keys
        if variables.get(key) is not None
    }
