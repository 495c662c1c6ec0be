"""A capture file over random steps: changed captures, interrupted and failed writes."""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from nlosoptics import transient
from nlosoptics.errors import SceneError
from nlosoptics.transient import TransientCapture, wall_grid

from ...stateful import bounded

ORIGIN = (-0.5, 0.0, 0.25)


def drawn(seed: int) -> TransientCapture:
    """A capture with random points, bins, parts and details."""
    draw = np.random.default_rng(seed)
    sensors = wall_grid(draw.uniform(0.5, 2.0), int(draw.integers(1, 4)))
    confocal = bool(draw.random() < 0.5)
    lasers = sensors if confocal else (0.1, 0.2, 0.0)
    dtype = np.float32 if draw.random() < 0.3 else np.float64
    H = draw.random((int(draw.integers(2, 9)), *sensors.shape[:2])).astype(dtype)
    with_parts, legs = draw.random() < 0.5, bool(draw.random() < 0.5)
    return TransientCapture(
        H=H,
        laser_points=lasers,
        sensor_points=sensors,
        pairing="confocal" if confocal else "all",
        delta_t=draw.uniform(0.001, 0.1),
        t_start=draw.uniform(0.0, 1.0),
        by_bounce={3: 0.75 * H, 4: 0.25 * H} if with_parts else {},
        standard_error=0.5 * H if with_parts else None,
        outer_legs=legs,
        laser_origin=ORIGIN if legs or draw.random() < 0.5 else None,
        sensor_origin=ORIGIN if legs else None,
        details={"seed": seed, "heights": draw.random(3)},
    )


def same(one: Any, other: Any) -> bool:
    """Whether two values of a capture have the same bits."""
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        return one.shape == other.shape and one.tobytes() == other.tobytes()
    return bool(one == other)


class Steps(RuleBasedStateMachine):
    """The file against the capture that was last saved without an error."""

    @initialize(seed=st.integers(0, 999))
    def first(self, seed: int) -> None:
        """Begin with a random capture and no file."""
        self.folder = Path(tempfile.mkdtemp())
        self.path = self.folder / "x.hdf5"
        self.capture = drawn(seed)
        self.saved: TransientCapture | None = None

    @rule(seed=st.integers(0, 999))
    def another(self, seed: int) -> None:
        """Take another capture, with other shapes."""
        self.capture = drawn(seed)

    @rule(seed=st.integers(0, 9))
    def detail(self, seed: int) -> None:
        """Add a detail to the capture."""
        self.capture = self.capture.with_details(again=seed, table={"a": [seed, 0.5]})

    @rule()
    @precondition(lambda self: hasattr(self, "capture") and self.capture.H.shape[0] > 3)
    def gate(self) -> None:
        """Cut the first bins off."""
        t = self.capture.t_start
        self.capture = transient.gated(self.capture, start=t + 2.0 * self.capture.delta_t)

    @rule(compression=st.integers(0, 9))
    def save(self, compression: int) -> None:
        """Save the capture over the file."""
        self.capture.save(self.path, compression=compression)
        self.saved = self.capture

    @rule(where=st.sampled_from(["create_dataset", "__setitem__"]))
    def fail(self, where: str) -> None:
        """The disk is full after some of the file."""
        full = OSError(errno.ENOSPC, "No space left on device")
        with patch.object(h5py.Group, where, side_effect=full), pytest.raises(SceneError):
            self.capture.save(self.path)

    @rule()
    def interrupt(self) -> None:
        """Ctrl-C when the file is complete, but not in its place."""
        with (
            patch.object(Path, "replace", side_effect=KeyboardInterrupt),
            pytest.raises(KeyboardInterrupt),
        ):
            self.capture.save(self.path)

    @rule()
    @precondition(lambda self: getattr(self, "saved", None) is not None)
    def load(self) -> None:
        """Go on with what the file has."""
        self.capture = TransientCapture.load(self.path)

    @invariant()
    def the_file_is_the_last_saved(self) -> None:
        """The file has the bits of the capture, and its folder nothing else."""
        if not hasattr(self, "path"):
            return
        names = [path.name for path in self.folder.iterdir()]
        assert names == ([] if self.saved is None else ["x.hdf5"])
        if self.saved is not None:
            found = TransientCapture.load(self.path)
            for entry in fields(TransientCapture):
                one, other = getattr(found, entry.name), getattr(self.saved, entry.name)
                if entry.name == "details":
                    one = {key: one[key] for key in other}
                assert same(one, other), entry.name

    def teardown(self) -> None:
        """Remove the folder."""
        if hasattr(self, "folder"):
            shutil.rmtree(self.folder)


TestSteps = Steps.TestCase
TestSteps.settings = bounded(examples=15, steps=12)
