"""Store of a study: one zarr group with a row for each point, written block by block.

Rows are in the order of computation, so that a study can grow without moving what is finished.
``id`` names the point of each row. For a figure ``f`` there are ``f``, ``f_error`` where it has
one, and ``f_status``, whose chunk is written last: a block without it is computed again.
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

    from .design.figures import Figure

FORMAT = 1
ROWS = 65_536  # ids in a chunk
TRIALS = 1000  # in a chunk
STATUSES = ("pending", "done", "failed", "lost")


class Store:
    """Rows of a study in a zarr group.

    Parameters
    ----------
    path : Path
        Folder of the group.
    group : zarr.Group
        Open group.
    """

    def __init__(self, path: Path, group: zarr.Group) -> None:
        self.path, self._group = path, group
        self._columns: dict[str, Any] = {}  # opening an array takes as long as writing a block

    @classmethod
    def create(
        cls, path: Path, *, block: int, about: Mapping[str, Any], files: Mapping[str, bytes]
    ) -> Store:
        """Create an empty store.

        Parameters
        ----------
        path : Path
            Folder to create; what a killed creation left there is replaced.
        block : int
            Rows in a block.
        about : mapping
            What describes the study, as JSON.
        files : mapping of str to bytes
            Files of the base scene.
        """
        import zarr  # here, so that a script's workers, which import what it does, load without

        with writing(path):
            group = zarr.open_group(path, mode="w", zarr_format=3)
            store = cls(path, group)
            store._array("id", str, ROWS, "", "hash of the values of the point")
            store._array("seconds", "f8", block, np.nan, "time of the point", "s")
            store._array("message", str, block, "", "failures and warnings by figure, as JSON")
            kept = group.create_group("files")
            for name, content in files.items():
                data = np.frombuffer(content, np.uint8)
                kept.create_array(name, data=data, chunks=(max(1, len(data)),))
            # written last, so that a store with it is complete
            group.attrs.update({"format": FORMAT, "block": block, "about": dict(about)})
        return store

    @classmethod
    def open(cls, path: Path, *, write: bool = False) -> Store | None:
        """Open a store; None if there is none, or one whose creation was interrupted."""
        if not path.exists():
            return None
        import zarr

        try:
            group = zarr.open_group(path, mode="r+" if write else "r", zarr_format=3)
        except (OSError, ValueError, KeyError) as error:
            if path.is_dir() and not any(path.iterdir()):
                return None
            raise SceneError(
                f"{path} is no store of a study ({reason(error)}); name another"
            ) from None
        if "format" not in group.attrs:
            # the folders themselves: zarr warns of an array whose creation was interrupted
            folders = {child.name for child in path.iterdir() if child.is_dir()}
            if folders <= {"id", "seconds", "message", "files"}:
                return None
            raise SceneError(f"{path} is a zarr group of another program; name another")
        if group.attrs["format"] != FORMAT:
            raise SceneError(
                f"{path} has format {group.attrs['format']}, this version reads {FORMAT}; run the "
                "study again into another folder"
            )
        return cls(path, group)

    @property
    def about(self) -> dict[str, Any]:
        """Description of the study."""
        found: Any = self._group.attrs["about"]
        return dict(found)

    def set_about(self, about: Mapping[str, Any]) -> None:
        """Replace the description."""
        with writing(self.path):
            self._group.attrs["about"] = dict(about)

    @property
    def block(self) -> int:
        """Rows in a block."""
        return int(self._group.attrs["block"])  # type: ignore[arg-type]

    def files(self) -> dict[str, bytes]:
        """Return the files of the base scene."""
        group = self._group["files"]
        return {
            name: np.asarray(group[name][:]).tobytes()  # type: ignore[index]
            for name in group.array_keys()  # type: ignore[union-attr]
        }

    def add_files(self, files: Mapping[str, bytes]) -> None:
        """Add files that new values name."""
        with writing(self.path):
            kept: Any = self._group["files"]
            for name in files.keys() - set(kept.array_keys()):
                data = np.frombuffer(files[name], np.uint8)
                kept.create_array(name, data=data, chunks=(max(1, len(data)),))

    def ids(self) -> list[str]:
        """Return the id of each row; empty for rows without a point."""
        return [str(name) for name in self._read("id")]

    def trials(self) -> list[dict[str, Any]]:
        """Return the values by address of the trials of a search, in their order."""
        if "search/trials" not in self._group:
            return []
        found = []
        for text in self._read("search/trials"):
            if not text:  # its writing was interrupted
                break
            found.append(json.loads(str(text)))
        return found

    def add_trials(self, first: int, deltas: Iterable[Mapping[str, Any]]) -> None:
        """Append trials of a search to the ``first`` ones."""
        with writing(self.path):
            if "search/trials" not in self._group:
                self._group.require_group("search").create_array(
                    "trials", shape=(0,), chunks=(TRIALS,), dtype=str, fill_value=""
                )
            texts = np.array([json.dumps(dict(delta)) for delta in deltas], dtype=object)
            self._at("search/trials").resize((first + len(texts),))
            self._at("search/trials")[first:] = texts

    @property
    def ended(self) -> str:
        """Why a search ended; empty if it did not."""
        group: Any = self._group.get("search", None)
        return "" if group is None else str(group.attrs.get("ended", ""))

    def set_ended(self, why: str) -> None:
        """Keep why a search ended."""
        with writing(self.path):
            self._group.require_group("search").attrs["ended"] = why

    def fast(self, figure: str, key: str) -> NDArray[np.float64] | None:
        """Return the values of a figure in all draws of the fast tier; None if it has not these.

        ``key`` names what the values depend on.
        """
        if f"fast/{figure}" not in self._group:
            return None
        array = self._at(f"fast/{figure}")
        if array.attrs.get("of") != key:
            return None
        try:
            return np.asarray(array[:], dtype=np.float64)
        except Exception:  # a corrupt chunk is computed again
            return None

    def set_fast(
        self, figure: str, key: str, values: NDArray[np.float64], meaning: str, unit: str
    ) -> None:
        """Keep the values of a figure in all draws of the fast tier; the key is written last."""
        with writing(self.path):
            self._columns.pop(f"fast/{figure}", None)
            array: Any = self._group.require_group("fast").create_array(
                figure, data=values, chunks=(len(values),), overwrite=True
            )
            told = {"long_name": meaning} | ({"units": unit} if unit else {})
            array.attrs.update(told | {"of": key})

    def add(self, ids: list[str], figures: tuple[Figure, ...], spare: int = 0) -> range:
        """Add figures that the store does not have, and rows for points, from a new block on.

        Parameters
        ----------
        ids : list of str
            Names of the points.
        figures : tuple of Figure
            Figures of the study; those that the store has are left as they are.
        spare : int
            Further rows, which `place` fills.

        Returns
        -------
        range
            New rows.
        """
        with writing(self.path):
            for figure in figures:
                about = figure.meaning, figure.unit
                if figure.has_error:
                    self._array(f"{figure.name}_error", "f8", self.block, np.nan, *about)
                self._array(figure.name, "f8", self.block, np.nan, *about)
                self._array(
                    f"{figure.name}_status",
                    "i1",
                    self.block,
                    0,
                    f"status of {figure.name}",
                    flag_values=list(range(len(STATUSES))),
                    flag_meanings=" ".join(STATUSES),
                )
            first = -(-self._rows() // self.block) * self.block
            rows = first + len(ids) + spare if ids else self._rows()
            # the ids come last, since a store has as many rows as ids
            for name in sorted(self._group.array_keys(), key=lambda name: name == "id"):
                self._at(name).resize((rows,))
        if ids:
            self.place(first, ids)
        return range(first, rows)

    def place(self, first: int, ids: list[str]) -> None:
        """Name the points of empty rows."""
        with writing(self.path):
            self._at("id")[first : first + len(ids)] = np.array(ids, dtype=object)

    def write(self, block: Block, answers: Answers) -> None:
        """Write a block; the statuses come last."""
        rows = slice(block.row, block.row + len(block.ids))
        with writing(self.path):
            told = self._told(rows)
            for kept, row in zip(told, answers.messages, strict=True):
                kept |= dict(zip(block.figures, row, strict=True))
            texts = [json.dumps(kept) if (kept := _without_empty(k)) else "" for k in told]
            self._set("message", rows, np.array(texts, dtype=object))
            spent = np.nan_to_num(self._seconds(rows))
            self._set("seconds", rows, spent + np.array(answers.seconds))
            for i, name in enumerate(block.figures):
                if f"{name}_error" in self._group:
                    self._set(f"{name}_error", rows, np.array([row[i] for row in answers.errors]))
                self._set(name, rows, np.array([row[i] for row in answers.values]))
            for i, name in enumerate(block.figures):
                statuses = np.array([row[i] for row in answers.statuses], dtype=np.int8)
                self._set(f"{name}_status", rows, statuses)

    def _set(self, name: str, rows: slice, values: NDArray[Any]) -> None:
        """Write rows of a block; a chunk of which zarr cannot decode the other rows is replaced."""
        array = self._at(name)
        try:
            array[rows] = values
        except OSError:
            raise
        except Exception:  # codecs raise arbitrary exceptions
            (self.path / name / "c" / str(rows.start // array.chunks[0])).unlink(missing_ok=True)
            array[rows] = values

    def _seconds(self, rows: slice) -> NDArray[np.float64]:
        try:
            return np.asarray(self._at("seconds")[rows], dtype=np.float64)
        except Exception:  # a corrupt chunk is replaced
            return np.zeros(rows.stop - rows.start)

    def _told(self, rows: slice) -> list[dict[str, str]]:
        try:
            texts = self._at("message")[rows]
            return [json.loads(str(text)) if str(text) else {} for text in np.asarray(texts)]
        except Exception:  # a corrupt chunk is replaced
            return [{} for _ in range(rows.stop - rows.start)]

    def column(self, name: str) -> NDArray[Any] | None:
        """Return all rows of an array; None if the store has no such array."""
        # a growth that was interrupted leaves some arrays longer
        return self._read(name)[: self._rows()] if name in self._group else None

    def statuses(self, figure: Figure) -> NDArray[np.int8]:
        """Return the status codes of a figure; rows with a corrupt chunk are pending."""
        empty = np.zeros(self._rows(), dtype=np.int8)
        found = self.column(f"{figure.name}_status")
        if found is None:
            return empty
        names = [figure.name, *([f"{figure.name}_error"] if figure.has_error else [])]
        broken = np.zeros(len(found), dtype=bool)
        for name in [*names, f"{figure.name}_status", "message"]:
            broken |= self._broken(name)[: len(broken)]
        return np.where(broken, np.int8(0), found)

    def _read(self, name: str) -> NDArray[Any]:
        """Return an array; chunks that cannot be decoded get the fill value."""
        array = self._at(name)
        try:
            return np.asarray(array[:])
        except Exception:  # codecs raise arbitrary exceptions
            return self._by_chunk(name)[0]

    def _broken(self, name: str) -> NDArray[np.bool_]:
        try:
            self._at(name)[:]
        except Exception:  # codecs raise arbitrary exceptions
            return self._by_chunk(name)[1]
        return np.zeros(self._at(name).shape[0], dtype=bool)

    def _by_chunk(self, name: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return an array read chunk by chunk, and which rows could not be read."""
        array = self._at(name)
        count, step = array.shape[0], array.chunks[0]
        found = np.full(count, array.metadata.fill_value, dtype=object)
        broken = np.zeros(count, dtype=bool)
        for start in range(0, count, step):
            rows = slice(start, min(count, start + step))
            try:
                found[rows] = np.asarray(array[rows])
            except Exception:  # codecs raise arbitrary exceptions
                broken[rows] = True
        return found if array.dtype.kind in "OT" else found.astype(array.dtype), broken

    def _rows(self) -> int:
        return int(self._at("id").shape[0])

    def _at(self, name: str) -> Any:
        """Return an array of the group."""
        if name not in self._columns:
            self._columns[name] = self._group[name]
        return self._columns[name]

    def _array(
        self,
        name: str,
        dtype: Any,
        chunk: int,
        fill: Any,
        meaning: str,
        unit: str = "",
        **attributes: Any,
    ) -> None:
        if name in self._group:
            return
        rows = self._at("id").shape[0] if name != "id" else 0
        told = {"long_name": meaning} | ({"units": unit} if unit else {}) | attributes
        self._group.create_array(
            name,
            shape=(rows,),
            chunks=(chunk,),
            dtype=dtype,
            fill_value=fill,
            dimension_names=("point",),
            attributes=told,
        )


def _without_empty(texts: Mapping[str, str]) -> dict[str, str]:
    return {name: text for name, text in texts.items() if text}


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
    """Convert what damaged metadata of a store raise, codecs' and parsers' own, to one line."""
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
