"""Writing of files and folders that are complete or not there at all.

Everything is written to a temporary folder next to its place and renamed. The temporary folder of a
killed process is removed by the next call for the same place.
"""

from __future__ import annotations

import errno
import glob
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ._checks import path_of
from .errors import SceneError

#: Record of an output folder; it lists the files that nlosoptics wrote.
RECORD = "result.json"
SUFFIX = ".nlosoptics"  # of temporary folders


def write_whole(contents: Mapping[Path, bytes]) -> None:
    """Write files, with their contents by path, and put them in place once all are complete.

    Existing files are replaced, each in one step and in the given order.

    Raises
    ------
    SceneError
        If a folder does not exist or cannot be written.
    """
    with whole_files(*contents) as drafts:
        for draft, content in zip(drafts, contents.values(), strict=True):
            draft.write_bytes(content)


@contextmanager
def whole_files(*paths: Path) -> Iterator[list[Path]]:
    """Yield temporary files that take the places of ``paths`` if the block ends without error.

    Links are followed. It raises the same errors as `write_whole`.
    """
    for path in paths:
        if not path.parent.is_dir():
            raise SceneError(f"{path}: there is no folder {path.parent}; make it first")
        if path.is_dir():
            raise SceneError(f"{path} is a folder; name a file")
    places = [Path(os.path.realpath(path)) for path in paths]
    try:
        with ExitStack() as stack:
            drafts = [stack.enter_context(beside(place)) / "new" for place in places]
            yield drafts
            for draft, place in zip(drafts, places, strict=True):
                draft.replace(place)
    except OSError as error:
        raise SceneError(
            f"{paths[0]}: cannot be written ({error.strerror or error}); choose another"
        ) from None


def check_folder(folder: Path) -> None:
    """Raise `SceneError` if an output folder cannot be written or has files of other origin."""
    if path_of("folder", folder).exists():
        if not folder.is_dir():
            raise SceneError(f"{folder} is a file; name a folder")
        _remove_left(folder.glob(f".*{SUFFIX}"))  # left by a killed ``report``
        try:
            ours = set(json.loads((folder / RECORD).read_text())["files"])
        except (OSError, ValueError, KeyError, TypeError):
            ours = set()
        if foreign := {path.name for path in folder.iterdir()} - ours:
            raise SceneError(
                f"{folder} holds {min(foreign)}, which nlosoptics did not write; name another "
                "folder"
            )
    parent = Path(os.path.realpath(folder)).parent
    if not parent.is_dir():
        raise SceneError(f"{folder} is in {parent}, which is no folder; create it first")
    if not os.access(parent, os.W_OK):
        raise SceneError(f"{folder} is in {parent}, which cannot be written; name another place")
    try:  # a file system such as /proc denies what the permissions allow
        with beside(Path(os.path.realpath(folder))):
            pass
    except OSError as error:
        raise SceneError(
            f"{folder} is in {parent}, which takes no folder ({error.strerror}); name another place"
        ) from None


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder that takes the place of ``target`` if the block ends without error.

    An old folder is moved aside, the new one is renamed, and the old one is deleted. A process that
    is killed between the two leaves the old folder where `sweep` finds it.

    Raises
    ------
    SceneError
        If the disk is full or read-only.
    """
    target = Path(os.path.realpath(target))
    try:
        with beside(target) as place:
            new = place / "new"
            new.mkdir()
            yield new
            if target.exists():
                target.rename(place / "old")
            new.rename(target)
    except OSError as error:
        of_disk = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO
        if error.errno not in (*of_disk, errno.ENAMETOOLONG):
            raise
        raise SceneError(
            f"{target}: cannot be written ({error.strerror}); make room, or choose another place"
        ) from None


@contextmanager
def beside(target: Path) -> Iterator[Path]:
    """Yield a new temporary folder next to ``target``, which is removed at the end of the block."""
    sweep(target)
    folder = Path(tempfile.mkdtemp(SUFFIX, f".{target.name}-", target.parent))
    with ExitStack() as stack:
        stack.callback(_remove, folder)
        stack.enter_context(_locked(folder))
        yield folder


def sweep(target: Path) -> None:
    """Remove what killed processes left next to ``target``; put an old folder back if it is gone.

    Those who read a folder call this too, if it is missing.
    """
    _remove_left(target.parent.glob(f".{glob.escape(target.name)}-*{SUFFIX}"))


def _remove_left(folders: Iterator[Path]) -> None:
    for left in folders:
        with suppress(OSError), _locked(left) as unused:
            if unused:
                _remove(left)


def _remove(folder: Path) -> None:
    """Remove a temporary folder; an old folder in it goes back to its place if that is free."""
    target = folder.with_name(folder.name.removesuffix(SUFFIX)[1:].rpartition("-")[0])
    if (folder / "old").is_dir() and not target.exists():
        (folder / "old").rename(target)
    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Lock a folder until the block or the process ends; yield False if that is impossible."""
    try:
        import fcntl

        number = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):  # Windows has no fcntl and opens no folders
        yield False
        return
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        unused = True
    except OSError:  # another process writes there
        unused = False
    try:
        yield unused
    finally:
        os.close(number)
