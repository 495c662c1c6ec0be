"""Atomic writing of files and folders: complete or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import SceneError

#: Record of an output folder; it lists the files that nlosoptics wrote.
RECORD = "result.json"


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
    """Yield a temporary folder that replaces ``target`` if the block ends without an error."""
    target = target.absolute()
    with tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as beside:
        new, old = Path(beside) / "new", Path(beside) / "old"
        new.mkdir()
        yield new
        try:
            if target.exists():
                target.rename(old)
            new.rename(target)
        except BaseException:
            if old.exists() and not target.exists():
                old.rename(target)
            raise
