"""Atomic writing of files and folders: complete or not at all."""

from __future__ import annotations

import errno
import glob
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import SceneError

#: Record of an output folder; it lists the files that nlosoptics wrote.
RECORD = "result.json"
_LOCK = "lock"  # file of a temporary folder that its process holds
_NEW = 60.0  # age up to which an empty temporary folder may be in use, s
_IS_LINUX = sys.platform == "linux"


def write_whole(contents: Mapping[Path, bytes]) -> None:
    """Write temporary files and rename them once all are complete; existing files are replaced.

    Parameters
    ----------
    contents : mapping of Path to bytes
        Contents by file path.

    Raises
    ------
    SceneError
        If a folder does not exist or cannot be written.
    """
    for path in contents:
        if not path.parent.is_dir():
            raise SceneError(f"{path}: there is no folder {path.parent}; make it first")
        if path.is_dir():
            raise SceneError(f"{path} is a folder; name a file")
    drafts = {path: path.with_name(f".{path.name}.{os.getpid()}") for path in contents}
    try:
        for path, content in contents.items():
            drafts[path].write_bytes(content)
        for path, draft in drafts.items():
            draft.replace(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror}); choose another") from None
    finally:
        for draft in drafts.values():
            with suppress(OSError):
                draft.unlink()


def check_folder(folder: Path) -> None:
    """Check that an output folder can be written and has no files of other origin.

    Raises
    ------
    SceneError
        If it cannot be written, or contains a file that nlosoptics did not write.
    """
    if folder.exists():
        if not folder.is_dir():
            raise SceneError(f"{folder} is a file; name a folder")
        found = {p.name for p in folder.iterdir()}
        try:
            ours = set(json.loads((folder / RECORD).read_text())["files"])
        except (OSError, ValueError, KeyError, TypeError):
            ours = set()
        if found - ours:
            raise SceneError(
                f"{folder} holds {min(found - ours)}, which nlosoptics did not write; name another "
                "folder"
            )
    parent = folder.absolute().parent
    if not parent.is_dir():
        raise SceneError(f"{folder} is in {parent}, which is no folder; create it first")
    if not os.access(parent, os.W_OK):
        raise SceneError(f"{folder} is in {parent}, which cannot be written; name another place")


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder that takes the place of ``target`` if the block ends without error.

    The two folders are exchanged in one step where the system can (Linux), so that a process killed
    at any time leaves the old folder or the new one. Elsewhere the next call puts an old folder
    back that was left between two steps. It also removes what killed processes left behind.
    """
    target = Path(os.path.realpath(target))
    _sweep(target)
    with (
        tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as beside,
        _locked(Path(beside) / _LOCK),
    ):
        new, old = Path(beside) / "new", Path(beside) / "old"
        new.mkdir()
        yield new
        for path in (*new.rglob("*"), new):
            _written_through(path)
        try:
            if not target.exists() or not _exchanged(new, target):
                if target.exists():
                    target.rename(old)
                new.rename(target)
        except BaseException:
            if old.exists() and not target.exists():
                old.rename(target)
            raise
        _written_through(target.parent)


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; return False where the system has no such call."""
    import ctypes

    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if _IS_LINUX else None
    if call is None:
        return False
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of linux/fs.h
    if call(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):  # an old kernel, or NFS
        return False
    raise OSError(code, os.strerror(code), str(other))


def _written_through(path: Path) -> None:
    """Wait until a file or the entries of a folder are on the disk, as far as the system tells."""
    with suppress(OSError):  # Windows opens no folders
        number = os.open(path, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


@contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Hold a lock file, which ends with the process; yield False if another process holds it."""
    with path.open("w") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (ImportError, OSError):  # Windows has no fcntl
            yield False
        else:
            yield True


def _sweep(target: Path) -> None:
    """Remove the temporary folders of killed processes, and put back an old folder in one."""
    for left in target.parent.glob(f".{glob.escape(target.name)}-*"):
        lock, old = left / _LOCK, left / "old"
        if not lock.is_file():  # killed at once, or just being made
            with suppress(OSError):
                if time.time() - left.stat().st_mtime > _NEW:
                    left.rmdir()  # if empty
            continue
        with suppress(OSError), _locked(lock) as unused:
            if unused:
                if old.is_dir() and not target.exists():
                    old.rename(target)
                shutil.rmtree(left)
