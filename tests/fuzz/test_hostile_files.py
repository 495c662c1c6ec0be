"""Damaged files are read to finite arrays or refused in one line; `campaign` tests any number."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from .campaign import Bench, campaign
from .mutations import mutated
from .readers import READERS, Reader

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no timer of processor time")
INPUTS = 40  # for each reader; the campaign's default is 10,000


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    if name == "poppy":
        pytest.importorskip("astropy")
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


def test_a_campaign_repeats_its_inputs(tmp_path: Path) -> None:
    one, again = ([*campaign("zernikes", list(range(12)), tmp_path / name)] for name in "ab")
    assert [(o.number, o.kind) for o in one] == [(o.number, o.kind) for o in again]
    assert [o.number for o in one] == list(range(12))


def test_mutations_change_most_contents() -> None:
    text = b"[a]\nb = 1.5\nc = 2\n"
    found = {mutated(text, [text], np.random.default_rng(i), text=True) for i in range(100)}
    assert len(found) > 80
