"""A store over random steps: growth, blocks, interruptions at any write, corrupt chunks."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from unittest.mock import patch

import numpy as np
import zarr.storage._local as local
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from nlosoptics.study.design.figures import Figure
from nlosoptics.study.store import Store
from nlosoptics.study.worker import DONE, Answers, Block

from ..stateful import bounded

BLOCK = 3
FIGURES = tuple(
    Figure(
        name=f"f{i}",
        source="own",
        options={},
        unit="m",
        meaning="a figure",
        stage="scene",
        has_error=bool(i % 2),
    )
    for i in range(3)
)


def answer(name: str, figure: str) -> tuple[float, float, str]:
    """Value, error and message of a figure at a point."""
    draw = np.random.default_rng([*f"{name} {figure}".encode()])
    return draw.random(), draw.random(), "warned" if draw.random() < 0.5 else ""


class Interrupted(BaseException):
    """The process ends before a chunk is written."""


@contextmanager
def interrupted(after: int | None) -> Iterator[None]:
    """End at the write number ``after``; None lets all pass."""
    writes, put = [], local._put

    def counted(*given, **options):
        if len(writes) == after:
            raise Interrupted
        writes.append(given[0])
        return put(*given, **options)

    with patch.object(local, "_put", counted), suppress(Interrupted):
        yield


class Steps(RuleBasedStateMachine):
    """The store against a list of the points and figures that were asked for."""

    @initialize()
    def create(self) -> None:
        """Create the store; a creation that was interrupted is replaced."""
        self.folder = Path(tempfile.mkdtemp())
        self.path = self.folder / "store"
        self.points: list[str] = []
        self.figures: tuple[Figure, ...] = FIGURES[:1]
        with interrupted(2):
            self._create()
        assert Store.open(self.path) is None
        self._create()

    def _create(self) -> None:
        Store.create(self.path, block=BLOCK, about={"n": 1}, files={"a": b"abc"})

    def _store(self) -> Store:
        found = Store.open(self.path, write=True)
        assert found is not None
        return found

    @rule(count=st.integers(1, 5), end=st.none() | st.integers(0, 9))
    def grow(self, count: int, end: int | None) -> None:
        """Ask for more points."""
        self.points += [f"p{len(self.points) + i}" for i in range(count)]
        self._grow(end)

    @rule(end=st.none() | st.integers(0, 9))
    def another_figure(self, end: int | None) -> None:
        """Ask for one more figure."""
        self.figures = FIGURES[: len(self.figures) + 1]
        self._grow(end)

    def _grow(self, end: int | None) -> None:
        store = self._store()
        known = set(store.ids())
        with interrupted(end):
            store.add([name for name in self.points if name not in known], self.figures)

    @rule(which=st.integers(0, 99), end=st.none() | st.integers(0, 9))
    def compute(self, which: int, end: int | None) -> None:
        """Compute one open block, as a run does."""
        if blocks := self._open():
            with interrupted(end):
                self._compute(blocks[which % len(blocks)])

    def _open(self) -> list[Block]:
        store = self._store()
        ids, found = store.ids(), []
        codes = {figure.name: store.statuses(figure) for figure in self.figures}
        for first in range(0, len(ids), BLOCK):
            rows = [row for row in range(first, min(first + BLOCK, len(ids))) if ids[row]]
            names = [name for name, code in codes.items() if (code[rows] != DONE).any()]
            if names:
                used = tuple(ids[row] for row in rows)
                found.append(Block(first, tuple({} for _ in used), used, tuple(names)))
        return found

    def _compute(self, block: Block) -> None:
        rows = [[answer(name, figure) for figure in block.figures] for name in block.ids]
        values, errors, messages = ([[one[k] for one in row] for row in rows] for k in range(3))
        statuses = [[DONE] * len(block.figures) for _ in rows]
        self._store().write(block, Answers(values, errors, statuses, messages, [0.5] * len(rows)))

    @rule(which=st.integers(0, 99), content=st.sampled_from([b"", b"broken", bytes(64)]))
    def corrupt(self, which: int, content: bytes) -> None:
        """Damage a chunk of a figure or of its status."""
        chunks = sorted(self.path.glob("f*/c/*"))
        if chunks:
            chunks[which % len(chunks)].write_bytes(content)

    @invariant()
    def finished_points_have_their_figures(self) -> None:
        """Whatever happened, what is called done is right, and no point has two rows."""
        if not hasattr(self, "path"):
            return
        store = self._store()
        ids = store.ids()
        named = [name for name in ids if name]
        assert len(named) == len(set(named))
        assert set(named) <= set(self.points)
        for figure in self.figures:
            codes, values = store.statuses(figure), store.column(figure.name)
            assert len(codes) == len(ids)
            for row in np.flatnonzero(codes == DONE):
                assert values is not None
                assert values[row] == answer(ids[row], figure.name)[0]
                if figure.has_error:
                    errors = store.column(f"{figure.name}_error")
                    assert errors is not None
                    assert errors[row] == answer(ids[row], figure.name)[1]

    def teardown(self) -> None:
        """A run without interruption finishes every point."""
        if not hasattr(self, "path"):
            return
        self._grow(None)
        for block in self._open():
            self._compute(block)
        self.finished_points_have_their_figures()
        store = self._store()
        assert sorted(name for name in store.ids() if name) == sorted(self.points)
        assert self._open() == []
        assert store.files() == {"a": b"abc"}
        shutil.rmtree(self.folder)


TestSteps = Steps.TestCase
TestSteps.settings = bounded(examples=8, steps=10)
