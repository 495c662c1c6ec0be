"""Base scene of a study: its tables and the contents of all files that it names."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ..._nouns import Noun
from ...errors import SceneError
from ...scene import Scene
from ...scene.file.addresses import changed
from ...scene.file.errors import validated
from ...scene.file.scene_file import own_tables, scene_from_tables, scene_tables, with_units
from ...scene.file.tables import SceneFile
from ...scene.parts._sources import SourceFile
from .values import canonical

#: Keys of a scene file whose values are names of files.
FILE_KEYS = ("image", "mesh", "heights")


@dataclass(frozen=True, eq=False, kw_only=True)
class Base(Noun):
    """Base scene of a study, complete without the files it was read from.

    Parameters
    ----------
    source : str
        Scene file, for messages.
    tables : dict
        Tables of the scene file, with quantities in SI units. Files have the names of ``files``.
    files : mapping of str to bytes
        Contents by names that contain a hash of the contents.
    names : mapping of str to str
        These names by the paths that the scene or study file gives.
    """

    source: str
    tables: dict[str, Any]
    files: dict[str, bytes]
    names: dict[str, str]

    @classmethod
    def read(cls, path: Path, changes: Mapping[str, Any]) -> Base:
        """Read a scene file with changes by address; raises as `Scene.load` does."""
        Scene.load(path, changes)  # checks all values and opens all files
        base = cls(source=str(path), tables={}, files={}, names={})
        base.tables.update(base._packed(scene_tables(path, changes)))
        return base

    @classmethod
    def of(cls, scene: Scene, changes: Mapping[str, Any]) -> Base:
        """Return the base of a scene in memory, with changes by address."""
        tables, files = own_tables(scene)
        base = cls(source="scene", tables={}, files={}, names={})
        for name, content in files.items():
            base._keep(name, content)
        base.tables.update(base._packed(changed(tables, with_units(tables, changes))))
        base.scene({})
        return base

    def packed(self, delta: Mapping[str, Any]) -> dict[str, Any]:
        """Return values by address in SI units; files that they name become part of the base."""
        return {a: self._packed(value, a.rpartition(".")[2]) for a, value in delta.items()}

    def _packed(self, value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {name: self._packed(inner, name) for name, inner in value.items()}
        if isinstance(value, list | tuple) and any(isinstance(inner, dict) for inner in value):
            return [self._packed(inner) for inner in value]
        return (
            self._stored(value) if key in FILE_KEYS and isinstance(value, str) else canonical(value)
        )

    def _stored(self, name: str) -> str:
        """Store the contents of a file; return its name in `files`."""
        if name in self.names:
            return self.names[name]
        path = Path(self.source).parent / name
        try:
            content = path.read_bytes()
        except OSError as error:
            raise SceneError(
                f"{path}: the file cannot be read ({error.strerror}); correct its path, which is "
                f"relative to {self.source}"
            ) from None
        return self._keep(name, content)

    def _keep(self, name: str, content: bytes) -> str:
        path = Path(name)
        stored = f"{path.stem}_{hashlib.sha256(content).hexdigest()[:12]}{path.suffix}"
        self.files[stored], self.names[name] = content, stored
        return stored

    def checked(self, delta: Mapping[str, Any]) -> None:
        """Raise `SceneError` if an address or the form of a value is wrong."""
        validated(SceneFile, changed(self.tables, delta))

    def scene(self, delta: Mapping[str, Any]) -> Scene:
        """Return the scene with other values at some addresses."""
        if len(self._parts) > 64:  # walls, objects and occluders
            self._parts.clear()
        return scene_from_tables(
            self.tables, Path(self.source), self._opened, Scene, delta, self._parts
        )

    @cached_property
    def _parts(self) -> dict[str, Any]:
        """Walls and objects of earlier scenes, which hold their meshes and pictures."""
        return {}

    def _opened(self, name: str) -> Path:
        """Return a file with its contents, so that no process needs it on its disk."""
        path = Path(self.source).parent / name
        return SourceFile.held(path, self.files[name]) if name in self.files else path

    def differences(self, other: Base) -> list[str]:
        """Return the addresses at which another base differs, with both values."""
        return differing_leaves(self.tables, other.tables)


def differing_leaves(tables: Any, others: Any) -> list[str]:
    """Return the addresses at which other tables differ, with both values."""
    mine, theirs = dict(_leaves(tables)), dict(_leaves(others))
    return [
        f"{address} = {mine.get(address, 'absent')} instead of {theirs.get(address, 'absent')}"
        for address in sorted(mine.keys() | theirs.keys())
        if mine.get(address) != theirs.get(address)
    ]


def _leaves(tables: Any, address: str = "") -> Iterator[tuple[str, str]]:
    """Yield all values of tables as JSON, with their addresses."""
    if isinstance(tables, dict):
        for key, inner in tables.items():
            yield from _leaves(inner, f"{address}.{key}" if address else key)
    elif isinstance(tables, list) and any(isinstance(inner, dict) for inner in tables):
        for index, inner in enumerate(tables):
            yield from _leaves(inner, f"{address}[{index}]")
    else:
        yield address, json.dumps(tables)
