"""Atomic writing of files and folders: complete or not at all."""

from __future__ import annotations

import errno
import glob
import json
import os
import shutil
import sys
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ._checks import path_of
from .errors import SceneError

#: Record of an output folder; it lists the files that nlosoptics wrote.
RECORD = "result.json"
_LOCK = "lock"  # file of a temporary folder that its process holds
_PLACES = "places.json"  # places of the complete files in a temporary folder
_NAME = 16  # random letters in the name of a temporary folder
_OF_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.ENAMETOOLONG)
_IS_LINUX = sys.platform == "linux"


def write_whole(contents: Mapping[Path, bytes]) -> None:
    """Write files and put them in place, in the given order, once all are complete.

    Parameters
    ----------
    contents : mapping of Path to bytes
        Contents by file path; existing files are replaced.

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

    Each file is replaced in one step, in the given order, and links are followed. A process that is
    killed between two files leaves a list of the others, by which `sweep` puts them in place.

    Raises
    ------
    SceneError
        If a folder does not exist or cannot be written.
    """
    for path in paths:
        if not path.parent.is_dir():
            raise SceneError(f"{path}: there is no folder {path.parent}; make it first")
        if path.is_dir():
            raise SceneError(f"{path} is a folder; name a file")
    places = [Path(os.path.realpath(path)) for path in paths]
    try:
        with ExitStack() as held:
            folders: dict[Path, Path] = {}
            for place in places:
                if place.parent not in folders:
                    folders[place.parent] = held.enter_context(beside(place))
            drafts = [folders[place.parent] / f"{i}.new" for i, place in enumerate(places)]
            yield drafts
            for draft in drafts:
                _written_through(draft)
            for parent, folder in folders.items():
                pairs = zip(drafts, places, strict=True)
                own = {draft.name: to.name for draft, to in pairs if to.parent == parent}
                (folder / "listed").write_text(json.dumps(own))
            try:
                for folder in folders.values():
                    (folder / "listed").replace(folder / _PLACES)
                for draft, place in zip(drafts, places, strict=True):
                    draft.replace(place)
            except BaseException:
                if all(draft.exists() for draft in drafts):  # otherwise `beside` places the others
                    for folder in folders.values():
                        (folder / _PLACES).unlink(missing_ok=True)
                raise
            for parent in folders:
                _written_through(parent)
    except OSError as error:
        told = error.strerror or str(error)
        raise SceneError(f"{paths[0]}: cannot be written ({told}); choose another") from None


def check_folder(folder: Path) -> None:
    """Check that an output folder can be written and has no files of other origin.

    Raises
    ------
    SceneError
        If it cannot be written, or contains a file that nlosoptics did not write.
    """
    if path_of("folder", folder).exists():
        if not folder.is_dir():
            raise SceneError(f"{folder} is a file; name a folder")
        _sweep(folder, f".*-{'?' * _NAME}")  # left by a killed ``report``
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
    parent = Path(os.path.realpath(folder)).parent
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

    Raises
    ------
    SceneError
        If the disk is full or read-only.
    """
    target = Path(os.path.realpath(target))
    with _disk_told(target), beside(target) as place:
        new, old = place / "new", place / "old"
        new.mkdir()
        yield new
        for path in (*new.rglob("*"), new):
            _written_through(path)
        if not target.exists() or not _exchanged(new, target):
            if target.exists():
                target.rename(old)  # `beside` puts it back if the next step fails
            new.rename(target)
        _written_through(target.parent)


@contextmanager
def _disk_told(target: Path) -> Iterator[None]:
    """Convert errors of a disk, whatever file they come from, to one line about the target."""
    try:
        yield
    except OSError as error:
        if error.errno not in _OF_DISK:
            raise
        raise SceneError(
            f"{target}: cannot be written ({error.strerror}); make room, or choose another place"
        ) from None


@contextmanager
def beside(target: Path) -> Iterator[Path]:
    """Yield a new temporary folder next to ``target``; remove what killed processes left there.

    The folder is removed at the end of the block. If signals interrupt even that, it is removed
    when the exception has been handled, or when the process ends.
    """
    sweep(target)
    # A name is chosen first, so that the folder is removed whenever a signal interrupts this.
    folder = target.with_name(f".{target.name}-{os.urandom(_NAME // 2).hex()}")
    with ExitStack() as held:
        finish = weakref.finalize(held, _finish_own, folder, os.getpid())
        try:
            while not (folder / _LOCK).exists():  # until no other process sweeps it while empty
                held.close()
                folder.mkdir(mode=0o700, exist_ok=True)
                with suppress(FileNotFoundError):
                    held.enter_context(_locked(folder / _LOCK, wait=True))
            yield folder
        finally:
            held.close()  # Windows removes no open file
            _finish(folder)
            if not folder.exists():  # an interrupt in `shutil.rmtree` may become an OSError
                finish.detach()


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
def _locked(path: Path, *, wait: bool = False) -> Iterator[bool]:
    """Hold a lock file, which ends with the process; yield False if another process holds it."""
    with path.open("a") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except (ImportError, OSError):  # Windows has no fcntl
            yield False
        else:
            yield True


def _put(folder: Path) -> None:
    """Put the complete files of a temporary folder in their places."""
    with suppress(OSError, ValueError):
        for draft, name in json.loads((folder / _PLACES).read_text()).items():
            if (folder / draft).exists():
                (folder / draft).replace(folder.parent / Path(name).name)


def sweep(target: Path) -> None:
    """Remove what killed processes left next to ``target``, or finish what they began."""
    _sweep(target.parent, f".{glob.escape(target.name)}-*")


def _sweep(parent: Path, pattern: str) -> None:
    """Remove the temporary folders of killed processes, and put back an old folder in one."""
    for left in parent.glob(pattern):
        lock = left / _LOCK
        if not lock.is_file():  # killed at once, or just being made: its process makes another
            with suppress(OSError):
                left.rmdir()  # if empty
            continue
        with suppress(OSError), _locked(lock) as unused:
            if unused:
                _finish(left)


def _finish_own(folder: Path, process: int) -> None:
    """Finish what this process has begun in a temporary folder; a forked one changes nothing."""
    if os.getpid() == process:
        _finish(folder)


def _finish(folder: Path) -> None:
    """Put an old folder back, or complete files in their places; remove the temporary folder."""
    old, target = folder / "old", folder.with_name(folder.name[1:].rpartition("-")[0])
    with suppress(OSError):
        if old.is_dir() and not target.exists():
            old.rename(target)
    _put(folder)
    _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a temporary folder as far as possible, its lock last."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif path.name != _LOCK:
                path.unlink()
        (folder / _LOCK).unlink(missing_ok=True)
        folder.rmdir()
