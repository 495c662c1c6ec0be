"""Variables of HDF5 and MATLAB files, by name."""

from __future__ import annotations

import math
import mmap
import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np

from ..._checks import counted, fits_memory
from ...errors import SceneError

#: Separator in the key ``name@attribute`` of an attribute of an HDF5 dataset.
AT = "@"
#: Type codes of elements in MATLAB v5 files: a variable, a compressed one, and those inside one.
MATRIX: Final = 14
COMPRESSED: Final = 15
DATA: Final = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX, 16, 17, 18})
DEEPEST: Final = 32  # nested structures
CHARS, SPARSE, INT64 = 4, 5, 14  # array classes; numeric ones are 6 to INT64
#: Signature and version of an HDF5 heap for values of variable length; bytes of its headers.
HEAP, HEADER = b"GCOL\x01", 16


@contextmanager
def variables(path: Path) -> Iterator[Mapping[str, Any]]:
    """Open an HDF5 or MATLAB file (v5, v7.3) as a mapping of its variables.

    A variable is read when it is looked up, so that large ones that nobody needs cost nothing.
    Arrays written by MATLAB get MATLAB's order of axes.

    Yields
    ------
    mapping of str to Any
        Arrays; None for empty variables, dict for groups and structures, str for text.

    Raises
    ------
    SceneError
        If the file has neither format, is damaged, or takes data from another file.
    """
    import h5py

    try:
        with path.open("rb") as file:
            head = file.read(128)
    except OSError as error:
        raise SceneError(f"cannot be read ({error.strerror}); check path and permissions") from None
    if h5py.is_hdf5(path):
        with ExitStack() as opened:
            with _readable_hdf5():
                held = opened.enter_context(h5py.File(path, "r"))
                _check_heaps(path, held)
            yield _Hdf5(held, matlab=head.startswith(b"MATLAB 7.3"))
        return
    if head.startswith(b"\x89HDF"):
        raise SceneError("is a broken HDF5 file (its header cannot be read); copy it again")
    if head[126:128] not in (b"IM", b"MI"):
        raise SceneError(
            "is neither HDF5 nor a MATLAB file; give a capture in one of these formats"
        )
    yield _Mat5(path, "<" if head[126:128] == b"IM" else ">")


def _check_heaps(path: Path, opened: Any) -> None:
    """Raise ValueError if HDF5 would never end reading a heap of an open file.

    HDF5 goes from object to object by their sizes, and does not check that these advance and stay
    inside the heap (``H5HG__cache_heap_deserialize``).
    """
    if opened.id.get_create_plist().get_sizes()[1] != 8:
        raise ValueError("lengths are not stored in 8 bytes")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as held:
        budget, start = len(held) // HEADER, held.find(HEAP)
        while 0 <= start <= len(held) - HEADER:
            end = min(start + struct.unpack_from("<8xQ", held, start)[0], len(held))
            place = start + HEADER
            while place + HEADER <= end:
                index, length = struct.unpack_from("<H6xQ", held, place)
                step = HEADER + -(-length // 8) * 8 if index else length  # 0: free space
                budget -= 1
                if not HEADER <= step <= end - place or budget < 0:
                    raise ValueError(f"an object of {length} bytes in a heap is impossible")
                place += step
            start = held.find(HEAP, start + 1)


class _Hdf5(Mapping[str, Any]):
    """Variables of an open HDF5 file, and their attributes under ``name@attribute``."""

    def __init__(self, file: Any, *, matlab: bool) -> None:
        self._file, self._matlab = file, matlab
        self._read: dict[str, Any] = {}
        with _readable_hdf5():
            self._keys = tuple(self._names())

    def __len__(self) -> int:
        return len(self._keys)

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __contains__(self, key: object) -> bool:
        return key in self._keys  # without reading it

    def __getitem__(self, key: str) -> Any:
        if key not in self._keys:
            raise KeyError(key)
        if key not in self._read:
            name, at, attribute = key.partition(AT)
            with _readable_hdf5():
                item = self._file[name]
                self._read[key] = item.attrs[attribute] if at else self._value(name, item)
        return self._read[key]

    def _names(self) -> Iterator[str]:
        """Yield the names of variables and attributes."""
        for name in self._file:
            if name.startswith("#"):  # MATLAB's internal references
                continue
            item = _linked(name, self._file)
            yield name
            for key in item.attrs:
                if not key.startswith(("MATLAB_", "H5PATH")):
                    yield f"{name}{AT}{key}"

    def _value(self, name: str, item: Any, depth: int = 0) -> Any:
        """Return the value of a dataset or group."""
        import h5py

        if depth > DEEPEST:
            raise SceneError(
                f"has {name[:60]}, nested in more than {DEEPEST} groups or in a circle; write the "
                "capture's arrays at the top"
            )
        if isinstance(item, h5py.Group):
            return {
                key: self._value(f"{name}.{key}", _linked(key, item), depth + 1) for key in item
            }
        if not isinstance(item, h5py.Dataset):
            raise SceneError(f"has {name}, which is no array; give the file of a capture")
        if item.shape is None or item.attrs.get("MATLAB_empty", 0):
            return None
        if item.external or item.is_virtual:
            raise SceneError(f"has {name}, whose data are in other files; copy them into this one")
        fits_memory(name, float(item.nbytes), "free memory, or load a smaller capture")
        value = item[()]
        if isinstance(value, bytes):
            return value.decode("utf-8", "replace")
        if isinstance(value, h5py.Reference):
            return self._value(name, self._file[value], depth + 1)
        if self._matlab and isinstance(value, np.ndarray):
            value = value.T  # MATLAB stores the first index fastest
            if item.attrs.get("MATLAB_class", b"") in (b"char", "char"):
                return "".join(map(chr, value.ravel()))
        return value


def _linked(name: str, group: Any) -> Any:
    """Return the item of a group, or raise `SceneError` if it is not in this file."""
    import h5py

    if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
        raise SceneError(f"has {name}, which is in another file; copy it into this one")
    item = group.get(name)
    if item is None:
        raise SceneError(f"is a broken HDF5 file (the link {name} has no target); copy it again")
    return item


@contextmanager
def _readable_hdf5() -> Iterator[None]:
    """Convert errors of the HDF5 library, which h5py maps to many types, to `SceneError`."""
    try:
        yield
    except (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(
            f"is a broken HDF5 file ({_first_line(error)}); copy or write it again"
        ) from None


class _Mat5(Mapping[str, Any]):
    """Variables of a MATLAB v5 file."""

    def __init__(self, path: Path, order: Literal["<", ">"]) -> None:
        from scipy.io import whosmat

        self._path = path
        self._read: dict[str, Any] = {}
        with _readable_mat5():
            with path.open("rb") as file:
                _check_elements(file, order, 128, path.stat().st_size, 0)
            self._shapes = {name: shape for name, shape, _ in whosmat(path)}

    def __len__(self) -> int:
        return len(self._shapes)

    def __iter__(self) -> Iterator[str]:
        return iter(self._shapes)

    def __contains__(self, key: object) -> bool:
        return key in self._shapes  # without reading it

    def __getitem__(self, key: str) -> Any:
        from scipy.io import loadmat

        if key not in self._read:
            size = 8.0 * math.prod(self._shapes[key])
            fits_memory(key, size, "free memory, or load a smaller capture")
            with _readable_mat5():
                found = loadmat(
                    self._path, squeeze_me=False, struct_as_record=True, variable_names=[key]
                )[key]
            self._read[key] = _mat5_item(found)
        return self._read[key]


@contextmanager
def _readable_mat5() -> Iterator[None]:
    """Convert the many types of error of scipy's reader to `SceneError`."""
    try:
        yield
    except Exception as error:
        raise SceneError(
            f"is a broken MATLAB file ({type(error).__name__}: {_first_line(error)}); copy it again"
        ) from None


def _check_elements(
    file: BinaryIO, order: Literal["<", ">"], at: int, end: int, depth: int
) -> list[int]:
    """Return the types of the elements from ``at`` to ``end``; ValueError if one is invalid.

    scipy looks up an element's type in a table without a bounds check and crashes on an unknown
    one (pull request 25349). Compressed elements need no check because they have checksums.
    """
    kinds = []
    while at < end:
        file.seek(at)
        head = file.read(8)
        if len(head) < 8 or depth > DEEPEST:
            raise ValueError(
                "an element is cut short" if len(head) < 8 else f"over {DEEPEST} nested structures"
            )
        kind, size = struct.unpack(order + "II", head)
        start, step = at + 8, size
        if kind >> 16:  # up to four bytes of data are stored in the tag itself
            kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 0
        known = kind in (MATRIX, COMPRESSED) if depth == 0 else kind in DATA
        if not known or (start == at + 4 and size > 4):
            raise ValueError(f"byte {at} has an element of type {kind} and {counted(size, 'byte')}")
        if start + size > end:
            raise ValueError(f"an element of {size} bytes at byte {at} ends beyond its container")
        if kind == MATRIX and size:
            within = _check_elements(file, order, start, start + size, depth + 1)
            _check_array(file, order, start, within)
        kinds.append(kind)
        # all but compressed elements are padded to a multiple of eight bytes
        at += 8 + (step if kind == COMPRESSED else -(-step // 8) * 8)
    return kinds


def _check_array(file: BinaryIO, order: Literal["<", ">"], at: int, kinds: list[int]) -> None:
    """Raise ValueError unless an array has all the parts that its header declares."""
    file.seek(at + 8)
    head = file.read(16).ljust(16, b"\0")
    flags, _, _, length = struct.unpack(order + "4I", head)
    kind, imaginary = flags & 0xFF, bool(flags & 0x800)
    parts = kinds[3:]  # the first three are flags, shape and name
    if kind not in range(CHARS, INT64 + 1):  # cells and structures contain arrays
        length -= length % 4
        shape = struct.unpack(f"{order}{length // 4}i", file.read(length).ljust(length, b"\0"))
        if math.prod(shape) > max(1, len(parts)):
            raise ValueError(f"the array at byte {at} lacks some of its {math.prod(shape)} parts")
        return
    if len(parts) < (3 if kind == SPARSE else 1) + imaginary or MATRIX in parts:
        raise ValueError(f"the array at byte {at} lacks a part of its numbers")


def _mat5_item(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.names is not None:
        if value.size != 1:
            raise SceneError(
                f"holds an array of {value.size} structures, must be one; write them one by one"
            )
        record = value.reshape(-1)[0]
        return {name: _mat5_item(record[name]) for name in value.dtype.names}
    if isinstance(value, np.ndarray) and value.size == 0:
        return None
    return value


def _first_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
