"""What HDF5 and MATLAB files hold, by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .._checks import fits_memory
from ..errors import SceneError

#: Attributes of HDF5 datasets that are read with them, under ``name@attribute``.
AT = "@"


def variables(path: Path) -> dict[str, Any]:
    """Variables of an HDF5 or MATLAB file (v5, v7.3), arrays in MATLAB's order if it wrote them.

    Empty ones are None, groups and structures dicts, texts str.

    Raises
    ------
    SceneError
        If the file is neither, or is not whole.
    """
    import h5py

    try:
        with path.open("rb") as file:
            head = file.read(128)
    except OSError as error:
        raise SceneError(f"cannot be read ({error.strerror}); check the file") from None
    if h5py.is_hdf5(path):
        return _hdf5(path, matlab=head.startswith(b"MATLAB 7.3"))
    if head.startswith(b"\x89HDF"):
        raise SceneError("is a broken HDF5 file (its header cannot be read); copy it again")
    if head[126:128] in (b"IM", b"MI"):
        return _mat5(path)
    raise SceneError("is neither HDF5 nor a MATLAB file; give a capture of one of them")


def _hdf5(path: Path, *, matlab: bool) -> dict[str, Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            found = {}
            for name, item in file.items():
                if name.startswith("#"):  # MATLAB's own
                    continue
                if item is None:
                    raise SceneError(f"is a broken HDF5 file ({name} leads nowhere); copy it again")
                found[name] = _hdf5_item(name, item, file, matlab)
                for key, value in item.attrs.items():
                    if not key.startswith(("MATLAB_", "H5PATH")):
                        found[f"{name}{AT}{key}"] = value
            return found
    # h5py raises whatever the library's error maps to
    except (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(
            f"is a broken HDF5 file ({_first_line(error)}); copy or write it again"
        ) from None


def _hdf5_item(name: str, item: Any, file: Any, matlab: bool) -> Any:
    import h5py

    if isinstance(item, h5py.Group):
        return {key: _hdf5_item(f"{name}.{key}", v, file, matlab) for key, v in item.items()}
    if not isinstance(item, h5py.Dataset):
        raise SceneError(f"has {name}, which is no array; give a capture's file")
    if item.shape is None or item.attrs.get("MATLAB_empty", 0):
        return None
    fits_memory(name, float(item.nbytes), "free memory, or load a smaller capture")
    value = item[()]
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, h5py.Reference):
        return _hdf5_item(name, file[value], file, matlab)
    if matlab and isinstance(value, np.ndarray):
        value = value.T  # MATLAB counts the first index fastest
        if item.attrs.get("MATLAB_class", b"") in (b"char", "char"):
            return "".join(map(chr, value.ravel()))
    return value


def _mat5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    try:
        found = loadmat(path, squeeze_me=False, struct_as_record=True)
    # scipy's reader raises many kinds on a file cut short
    except Exception as error:
        raise SceneError(
            f"is a broken MATLAB file ({type(error).__name__}: {_first_line(error)}); copy it again"
        ) from None
    return {name: _mat5_item(value) for name, value in found.items() if not name.startswith("__")}


def _mat5_item(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.names is not None:
        if value.size != 1:
            raise SceneError(f"holds an array of {value.size} structures, must be one")
        record = value.reshape(-1)[0]
        return {name: _mat5_item(record[name]) for name in value.dtype.names}
    if isinstance(value, np.ndarray) and value.size == 0:
        return None
    return value


def _first_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
