"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from .errors import SceneError


def write_whole(contents: Mapping[Path, bytes]) -> None:
    """Write files beside their places and, once all are written, rename them; old ones go.

    Raises
    ------
    SceneError
        If a folder does not exist or cannot be written.
    """
    drafts = {path: path.with_name(f".{path.name}.{os.getpid()}") for path in contents}
    for path in contents:
        if not path.parent.is_dir():
            raise SceneError(f"{path}: there is no folder {path.parent}; make it first")
        if path.is_dir():
            raise SceneError(f"{path} is a folder; name a file")
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
