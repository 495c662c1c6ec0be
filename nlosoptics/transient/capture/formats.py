"""Loading of capture files: recognise the layout, then require what the file leaves open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import in_range, one_of, path_of, positive, real, vector
from ...errors import NlosError, SamplingError, SceneError
from .layouts import LIGHT, Found

T = TypeVar("T")
Array = NDArray[Any]
LAYOUTS = ("tal", "znlos", "dirac", "phasor_field_2019", "phasor_field_2020", "lct")
#: Plausible bin widths, m of optical path (0.3 fs and 33 ns); others must be in another unit.
FINEST, COARSEST = 1e-7, 10.0


@dataclass(frozen=True, kw_only=True)
class Lack:
    """A value that a file does not give, and the argument of `load_capture` that gives it.

    Parameters
    ----------
    argument : str
        Name of the argument.
    why : str
        The reason why it is needed.
    what : str
        Value to give.
    """

    argument: str
    why: str
    what: str


class LackingFileError(SceneError):
    """A capture file does not give all values of a capture.

    Attributes
    ----------
    lacks : tuple of Lack
        All that is missing.
    layout : str
        Layout that the file appears to have.
    details : mapping
        Details that the file does give.
    """

    lacks: tuple[Lack, ...] = ()
    layout: str = ""
    details: Mapping[str, Any] = {}


@contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Prefix errors raised in the context with the file's name."""
    try:
        yield
    except NlosError as error:
        text = str(error)
        named = type(error)(text if text.startswith(str(path)) else f"{path}: {text}")
        vars(named).update(vars(error))
        raise named from None


def load_capture(
    capture: Callable[..., T],
    path: str | Path,
    *,
    format: str | None = None,
    bin_width: float | None = None,
    t_start: float | None = None,
    side: float | None = None,
    pairing: str | None = None,
    laser_point: Any = None,
    outer_legs: bool | None = None,
    quantity: str | None = None,
    gate_start: float | None = None,
) -> T:
    """Read a file and return ``capture(**values)``; the other arguments override the file.

    ``capture`` is the class `TransientCapture`, the arguments are those of its ``load``.
    """
    path = path_of("path", path)
    if format is not None:
        one_of("format", format, LAYOUTS)
    if not path.is_file():
        what = "a folder" if path.is_dir() else "missing"
        raise SceneError(f"{path}: the capture file is {what}; give the path of an HDF5 or .mat")
    with in_file(path):
        found = _read(path, format)
        given = {
            "bin_width": bin_width,
            "t_start": t_start,
            "side": side,
            "pairing": pairing,
            "laser_point": laser_point,
            "outer_legs": outer_legs,
            "quantity": quantity,
            "gate_start": gate_start,
        }
        if pairing is not None:
            found.pairing = one_of("pairing", pairing, ("all", "confocal"))
        lacks = tuple(_lacks(found, given, format))
        if lacks:
            error = LackingFileError(
                "; also ".join(f"{lack.why}; give {lack.argument} = {lack.what}" for lack in lacks)
            )
            error.lacks, error.layout, error.details = lacks, found.layout, found.details
            raise error
        _fill(found, laser_point, side)
        return capture(**_values(found, given))


def _read(path: Path, format: str | None) -> Found:
    from . import foreign_files, mat_files, tal_files

    readers = {
        "tal": tal_files.read,
        "znlos": foreign_files.read_znlos,
        "dirac": foreign_files.read_dirac,
        "phasor_field_2019": foreign_files.read_phasor_field_2019,
        "phasor_field_2020": foreign_files.read_phasor_field_2020,
        "lct": foreign_files.read_lct,
    }
    with mat_files.variables(path) as variables:
        layout = _layout(variables)
        if format is not None and format != layout:
            raise SceneError(
                f"format = {format!r}, the file has the layout {layout!r} by its variables; omit "
                "format or give that layout"
            )
        return readers[layout](variables)


def _layout(variables: Mapping[str, Any]) -> str:
    """Return the layout of a file, recognised from the names of its variables."""
    if "H" in variables:
        return "tal"
    if "rect_data" in variables:
        if "width" in variables:
            return "lct"
        if "sampling_spacing" in variables:
            return "phasor_field_2020"
        raise SceneError(
            "rect_data needs width (LCT) or sampling_spacing (phasor field 2020) for the size of "
            "the wall, and the file has neither; add one of them to the file"
        )
    for key, layout in (
        ("dataset", "phasor_field_2019"),
        ("data_t", "dirac"),
        ("cameraGridPositions", "znlos"),
    ):
        if key in variables:
            return layout
    held = ", ".join(sorted(variables)[:8]) or "nothing"
    raise SceneError(
        f"holds {held}, which is no known layout; give a file of y-tal (H), Z-NLOS (data, "
        "cameraGridPositions), NLOS-DIRAC (data_t), phasor field (dataset; rect_data and "
        "sampling_spacing) or LCT (rect_data and width)"
    )


def _lacks(found: Found, given: Mapping[str, Any], format: str | None) -> Iterator[Lack]:
    """Yield every value that neither the file nor the caller gives."""

    def lack(argument: str, why: str, what: str) -> Lack:
        return Lack(argument=argument, why=found.needs.get(argument, why), what=what)

    if found.doubt and format is None and any(given[name] is None for name in found.instead):
        what = f"{found.layout!r} if so, or {' and '.join(found.instead)}"
        yield lack("format", found.doubt, what)
    if found.sensor_points is None and given["side"] is None:
        what = "the full side of the scanned square, m"
        yield lack("side", "the file has no sensor points", what)
    if found.pairing is None and given["laser_point"] is None:
        why = "the file does not say where the laser pointed"
        yield lack("pairing", why, "'confocal', or laser_point = (x, y, z) in m")
    if found.pairing == "all" and found.laser_points is None and given["laser_point"] is None:
        yield lack("laser_point", "the file has no laser points", "(x, y, z) in m")
    for name, argument, what in (
        ("delta_t", "bin_width", "the width of a bin, m of optical path"),
        ("t_start", "t_start", "the start of bin 0, m of optical path"),
        ("outer_legs", "outer_legs", "whether times include the legs from laser and to sensor"),
    ):
        if getattr(found, name) is None and given[argument] is None:
            yield lack(argument, f"the file does not say {name}", what)
    if "gate_start" in found.needs and given["gate_start"] is None:
        what = "optical path in m before which bins are set to 0, or 0 to keep all"
        yield lack("gate_start", "", what)


def _fill(found: Found, laser_point: Any, side: float | None) -> None:
    """Set points and pairing from the arguments, else from the file."""
    if side is not None:
        _lay_grid(found, positive("side", side, unit="m"))
    if laser_point is not None:
        if found.pairing == "confocal":
            raise SceneError(
                "laser_point was given for confocal pairs, which have one laser point each; omit "
                "laser_point, or give pairing = 'all'"
            )
        found.laser_points = np.array(vector("laser_point", laser_point))
        found.laser_normals, found.pairing = None, "all"
    if found.pairing == "confocal" and (found.laser_points is None or side is not None):
        found.laser_points, found.laser_normals = found.sensor_points, found.sensor_normals


def _lay_grid(found: Found, side: float) -> None:
    """Set the sensor points to the cell centres of a square wall, [y, x]."""
    from .wall_points import wall_grid

    shape = found.H.shape[-2:]
    if found.H.ndim < 3 or shape[0] != shape[1]:
        raise SamplingError(
            f"side = {side:g} m needs a square grid of points, the file has {found.H.shape[1:]}; "
            "omit side"
        )
    found.sensor_points, found.sensor_normals = wall_grid(side, shape[0]), None


def _values(found: Found, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a `TransientCapture` from a file and the caller's arguments."""
    values = {
        name: getattr(found, name) if given[argument] is None else given[argument]
        for name, argument in (
            ("delta_t", "bin_width"),
            ("t_start", "t_start"),
            ("outer_legs", "outer_legs"),
            ("quantity", "quantity"),
        )
    }
    if not isinstance(values["outer_legs"], bool | np.bool_):
        raise SceneError(f"outer_legs = {values['outer_legs']!r} must be True or False")
    values["outer_legs"] = bool(values["outer_legs"])
    named = "delta_t" if given["bin_width"] is None else "bin_width"
    values["delta_t"] = path_step(named, values["delta_t"])
    values["t_start"] = _path_start(values["t_start"], values["delta_t"])
    H, parts, error = found.H, found.by_bounce, found.standard_error
    if given["gate_start"] is not None:
        start = in_range("gate_start", given["gate_start"], unit="m")
        begins = values["t_start"] + values["delta_t"] * np.arange(H.shape[0])
        late = begins >= start - 1e-9 * values["delta_t"]
        if not late.any():
            raise SamplingError(
                f"gate_start = {start:g} m is after the last bin, which starts at "
                f"{begins[-1]:g} m of optical path; give an earlier one"
            )
        H, parts = _opened(H, late), {n: _opened(part, late) for n, part in parts.items()}
        error = None if error is None else _opened(error, late)
    return dict(
        H=np.ascontiguousarray(H),
        laser_points=found.laser_points,
        sensor_points=found.sensor_points,
        laser_normals=found.laser_normals,
        sensor_normals=found.sensor_normals,
        laser_origin=found.laser_origin,
        sensor_origin=found.sensor_origin,
        pairing=found.pairing,
        by_bounce=parts,
        standard_error=error,
        details=found.details,
        **values,
    )


def _opened(values: Array, late: NDArray[np.bool_]) -> Array:
    """Return bins with those set to 0 that start before the gate."""
    if len(values) != len(late):  # TransientCapture reports the mismatch
        return values
    return np.where(late.reshape(-1, *[1] * (values.ndim - 1)), values, values.dtype.type(0))


def path_step(name: str, value: Any) -> float:
    """Return a bin width in m of optical path; refuse one that must be in another unit."""
    step = positive(name, value, unit="m")
    if step < FINEST:
        raise SceneError(
            f"{name} = {step:g} is too short for a length in m, limit {FINEST:g} m; if it is in "
            f"seconds, give bin_width = {step * LIGHT:.6g} (m of optical path)"
        )
    if step > COARSEST:
        raise SceneError(
            f"{name} = {step:g} is too long for m of optical path, limit {COARSEST:g} m; if it is "
            f"in ps, give bin_width = {step * 1e-12 * LIGHT:.6g} (m)"
        )
    return step


def _path_start(value: Any, step: float) -> float:
    start = real("t_start", value)
    if 0.0 < abs(start) < 1e-6 * step:
        raise SceneError(
            f"t_start = {start:g} is too short for a length in m, limit {1e-6 * step:g} m for bins "
            f"of {step:g} m; if it is in seconds, give t_start = {start * LIGHT:.6g} (m)"
        )
    return start
