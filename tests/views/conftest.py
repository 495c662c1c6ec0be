"""What tests of pictures share."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def assert_drawn():
    """Check that a picture, rendered, is more than paper, and return its pixels (ny, nx, 3)."""

    def check(picture):
        first = picture if hasattr(picture, "get_figure") else next(iter(picture))
        canvas = first.get_figure(root=True).canvas
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
        colours, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
        # labels alone leave 97 % paper, in some dozens of greys
        assert counts.max() < 0.97 * counts.sum()
        assert len(colours) > 30
        return pixels

    return check
