"""Damaged files are read to finite arrays or refused in one line; `campaign` tests any number."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from nlosoptics.errors import SceneError
from nlosoptics.scene import MeshObject

from .campaign import Bench, campaign
from .readers import READERS, Reader

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no timer of processor time")
INPUTS = 20  # for each reader; the campaign's default is 10,000


@pytest.mark.parametrize(
    "name",
    [n if n != "store" else pytest.param(n, marks=pytest.mark.thorough) for n in READERS],
)
def test_damaged_files_are_read_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    if name in ("study", "store"):
        pytest.importorskip("zarr")
    bench = Bench(name, tmp_path)
    outcomes = [bench.run(number) for number in range(INPUTS)]
    assert [one for one in outcomes if one.kind not in ("read", "refused")] == []
    assert sum(one.kind == "refused" for one in outcomes) > INPUTS / 4  # damage is noticed


def _traps(folder: Path) -> list[Path]:
    (folder / "a.bin").write_bytes(bytes(64))
    return [folder / "a.bin"]


def _fall(_: Path, file: Path):
    """A reader with one fault for each size of the file."""
    from nlosoptics.errors import SceneError

    size = file.stat().st_size
    if size == 64:
        return []
    if size % 4 == 0:
        raise KeyError("a")
    if size % 4 == 1:
        raise SceneError("two\nlines")
    if size % 4 == 2:
        while True:
            pass
    return [np.frombuffer((file.parent / "canary.bin").read_bytes())]


def test_faults_are_found(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(READERS, "trap", Reader(_traps, _fall))
    monkeypatch.setattr(f"{Bench.__module__}.MOST_SECONDS", 0.02)
    bench = Bench("trap", tmp_path)
    kinds = {bench.run(number).kind for number in range(60)}
    assert {"KeyError", "not one line", "hang", "AssertionError"} <= kinds  # the last: canary


@pytest.mark.thorough
def test_a_campaign_repeats_its_inputs(tmp_path: Path) -> None:
    one, again = ([*campaign("zernikes", list(range(12)), tmp_path / name)] for name in "ab")
    assert [(o.number, o.kind) for o in one] == [(o.number, o.kind) for o in again]
    assert [o.number for o in one] == list(range(12))


def gltf(uri: str) -> bytes:
    """A triangle whose vertices are in another file."""
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 36}]
    views += [{"buffer": 0, "byteOffset": 36, "byteLength": 12}]
    part = {"attributes": {"POSITION": 0}, "indices": 1}
    file = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [part]}],
        "buffers": [{"byteLength": 48, "uri": uri}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
    }
    text = json.dumps(file).encode()
    return text + b" " * (-len(text) % 4)


@pytest.mark.parametrize("uri", ["../other.bin", "ROOT/other.bin"])
def test_a_mesh_reads_no_other_file(uri: str, tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [7, 0, 0], [0, 7, 0]], dtype=np.float32).tobytes()
    (tmp_path / "sub").mkdir()
    for folder in (tmp_path, tmp_path / "sub"):
        (folder / "other.bin").write_bytes(vertices + np.arange(3, dtype=np.uint32).tobytes())
    content = gltf(uri.replace("ROOT", str(tmp_path)))
    file = tmp_path / "sub" / "a.gltf"
    file.write_bytes(content)
    with pytest.raises(SceneError, match="is not a mesh"):
        _ = MeshObject(file, position=(0.0, 0.0, 1.0)).surface
