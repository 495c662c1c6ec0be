"""Store of a study: one zarr group with a row for each point and a column for each figure.

Rows are in the order of computation, so that a study grows without moving what is finished. All
arrays are kept in memory; writing a block replaces the chunks that hold it, each in one step. The
chunk of the statuses is the last one: points without a status are computed again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import reason
from ..errors import NlosError, SceneError
from .worker import Answers, Block

if TYPE_CHECKING:
    import zarr

FORMAT = 2
ROWS, COLUMNS = 1024, 8  # of a chunk
STATUSES = ("pending", "done", "failed", "lost")
#: Type and empty value of each array, in the order in which a block is written.
ARRAYS: dict[str, tuple[Any, Any]] = {
    "message": (str, ""),
    "seconds": ("f8", np.nan),
    "error": ("f8", np.nan),
    "value": ("f8", np.nan),
    "status": ("i1", 0),
    "id": (str, ""),
}
ONE_COLUMN = ("seconds", "id")


class Store:
    """Rows of a study in a zarr group.

    Parameters
    ----------
    path : Path
        Folder of the group.
    group : zarr.Group
        Open group.

    Attributes
    ----------
    about : dict
        What describes the study, as JSON.
    ids : list of str
        Name of the point of each row.
    """

    def __init__(self, path: Path, group: zarr.Group) -> None:
        self.path, self._group = path, group
        self.about: dict[str, Any] = dict(group.attrs.get("about", {}))  # type: ignore[arg-type]
        self._arrays: dict[str, Any] = {name: group[name] for name in ARRAYS}
        self._values = {name: np.asarray(array[:]) for name, array in self._arrays.items()}
        self._values["message"] = self._values["message"].astype(object)
        self.ids = [str(name) for name in self._values["id"] if name]

    @classmethod
    def create(cls, path: Path, files: Mapping[str, bytes]) -> Store:
        """Create an empty store, which `add` completes; what a killed creation left is replaced."""
        import zarr  # here, so that a script's workers, which import what it does, load without

        with writing(path):
            group = zarr.open_group(path, mode="a", zarr_format=3)
            group.attrs.update({"format": FORMAT})
            for name, (kind, empty) in ARRAYS.items():
                one = name in ONE_COLUMN
                group.create_array(
                    name,
                    shape=(0,) if one else (0, 0),
                    chunks=(ROWS,) if one else (ROWS, COLUMNS),
                    dtype=kind,
                    fill_value=empty,
                    overwrite=True,
                )
            _add_files(group.create_group("files", overwrite=True), files)
            group.create_array(
                "trials", shape=(0,), chunks=(ROWS,), dtype=str, fill_value="", overwrite=True
            )
        return cls(path, group)

    @classmethod
    def open(cls, path: Path, *, write: bool = False) -> Store | None:
        """Open a store; None if there is none, or one whose creation was interrupted."""
        if not path.is_file() and all(one.suffix == ".partial" for one in path.glob("*")):
            return None
        import zarr

        try:
            group = zarr.open_group(path, mode="r+" if write else "r", zarr_format=3)
        except (OSError, ValueError, KeyError) as error:
            raise SceneError(
                f"{path} is no store of a study ({reason(error)}); name another"
            ) from None
        if "format" not in group.attrs:
            if not any(child.is_dir() for child in path.iterdir()):
                return None
            raise SceneError(f"{path} is a zarr group of another program; name another")
        if group.attrs["format"] != FORMAT:
            raise SceneError(
                f"{path} has format {group.attrs['format']}, this version reads {FORMAT}; run the "
                "study again into another folder"
            )
        return cls(path, group) if "about" in group.attrs else None

    def files(self) -> dict[str, bytes]:
        """Return the files of the base scene."""
        group: Any = self._group["files"]
        return {name: np.asarray(group[name][:]).tobytes() for name in group.array_keys()}

    def add_files(self, files: Mapping[str, bytes]) -> None:
        """Add files that the values of points name."""
        known = self.files()  # those whose writing was interrupted have other contents
        with writing(self.path):
            new = {name: content for name, content in files.items() if known.get(name) != content}
            _add_files(self._group["files"], new)

    def trials(self) -> list[dict[str, Any]]:
        """Return the values by address of the trials of a search, in their order."""
        trials: Any = self._group["trials"]
        return [json.loads(str(text)) for text in trials[:] if text]

    def add_trials(self, deltas: Iterable[Mapping[str, Any]]) -> None:
        """Append trials of a search."""
        trials: Any = self._group["trials"]
        texts = [json.dumps(dict(delta)) for delta in deltas]
        with writing(self.path):
            first = sum(bool(text) for text in trials[:])  # an interrupted writing left it longer
            trials.resize((first + len(texts),))
            trials[first:] = np.array(texts, dtype=object)

    @property
    def ended(self) -> str:
        """Why a search ended; empty if it did not."""
        return str(self._group.attrs.get("ended", ""))

    def set_ended(self, why: str) -> None:
        """Keep why a search ended."""
        with writing(self.path):
            self._group.attrs["ended"] = why

    def add(self, ids: list[str], about: Mapping[str, Any] | None = None) -> None:
        """Replace the description, and add rows for points and columns for its new figures."""
        self.about = self.about if about is None else dict(about)
        shapes = [array.shape for array in self._arrays.values()]
        first, count = len(self.ids), len(self.ids) + len(ids)
        # whole chunks, so that few additions of a search grow the arrays; an interrupted addition
        # left some of them larger
        rows = max(-(-count // ROWS) * ROWS, *(shape[0] for shape in shapes))
        width = max(len(self.about["figures"]), *(shape[-1] for shape in shapes if shape[1:]))
        with writing(self.path):
            for name, (_, empty) in ARRAYS.items():
                shape = (rows,) if name in ONE_COLUMN else (rows, width)
                old = self._values[name]
                if old.shape != shape:
                    self._arrays[name].resize(shape)
                    values = np.full(shape, empty, dtype=object if empty == "" else old.dtype)
                    values[tuple(map(slice, old.shape))] = old
                    self._values[name] = values
            if about is not None:  # after the columns of its figures; now it is a store
                self._group.attrs["about"] = self.about
            self._values["id"][first:count], self.ids = ids, [*self.ids, *ids]
            if ids:  # last, since the store has the rows that have an id
                self._write("id", first, count)

    def write(self, block: Block, answers: Answers) -> None:
        """Write a block; the statuses come last."""
        at = np.ix_(block.rows, self._columns(block.figures))
        rows = list(block.rows)
        spent = np.nan_to_num(self._values["seconds"][rows])
        self._values["seconds"][rows] = spent + answers.seconds
        self._values["error"][at] = answers.errors
        self._values["value"][at] = answers.values
        self._values["status"][at] = answers.statuses
        silent = (self._values["message"][at] == "").all() and (answers.messages == "").all()
        self._values["message"][at] = answers.messages
        with writing(self.path):
            for name in list(ARRAYS)[int(silent) : -1]:  # not the ids, and rarely messages
                self._write(name, min(block.rows), max(block.rows) + 1)

    def _write(self, name: str, first: int, end: int) -> None:
        """Write the whole chunks with some rows of an array."""
        rows = slice(first // ROWS * ROWS, -(-end // ROWS) * ROWS)
        self._arrays[name][rows] = self._values[name][rows]

    def column(self, name: str, figures: Iterable[str] = ()) -> NDArray[Any]:
        """Return an array: seconds (rows,), or another one with the columns of some figures."""
        values = self._values[name][: len(self.ids)]
        return values if name in ONE_COLUMN else values[:, self._columns(figures)]

    def _columns(self, figures: Iterable[str]) -> list[int]:
        names = [figure["name"] for figure in self.about["figures"]]
        return [names.index(figure) for figure in figures]


def _add_files(group: Any, files: Mapping[str, bytes]) -> None:
    """Write files into a group, each as one chunk of bytes."""
    for name, content in files.items():
        data = np.frombuffer(content, np.uint8)
        group.create_array(name, data=data, chunks=(max(1, len(data)),), overwrite=True)


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Refuse a second process that writes the same store."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY)
    try:
        try:
            import fcntl

            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SceneError(
                f"{path} is being written by another process; wait until it has ended"
            ) from None
        except (ImportError, OSError):  # Windows, or a file system without locks
            pass
        else:
            for draft in path.rglob("*.partial"):  # zarr's, left by a killed process
                draft.unlink(missing_ok=True)
        yield
    finally:
        os.close(folder)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Convert what a damaged store raises, codecs' and parsers' own errors, to one line."""
    try:
        yield
    except NlosError:
        raise
    except Exception as error:
        raise SceneError(
            f"{path}: the store is damaged ({reason(error)}); restore it from a copy, or run the "
            "study into another folder"
        ) from None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Convert a failure of the disk to one line."""
    try:
        yield
    except OSError as error:
        raise SceneError(
            f"{path}: the store cannot be written ({error.strerror or error}); finished blocks are "
            "kept; mend that, or use another folder, and run the study again"
        ) from None
