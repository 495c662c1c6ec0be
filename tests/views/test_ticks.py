"""Labels of figures: none overlaps another or is cut off, at any size of axes and labels."""

from __future__ import annotations

import itertools
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from nlosoptics import views
from nlosoptics.transient import Volume, VolumeImage

pytest.importorskip("matplotlib")


def gaps(axes):
    """Distances between neighbouring tick labels of x, pixels."""
    figure = axes.get_figure(root=True)
    figure.draw_without_rendering()  # a figure that was pickled has no canvas that draws
    low, high = sorted(axes.get_xlim())
    labels = [
        tick.label1.get_window_extent()
        for tick in axes.xaxis.get_major_ticks()
        if low <= tick.get_loc() <= high and tick.label1.get_text()
    ]
    assert labels
    labels.sort(key=lambda box: box.x0)
    return [right.x0 - left.x1 for left, right in itertools.pairwise(labels)]


@pytest.mark.parametrize("pitch", [1e-7, 2e-6, 1.234e-4])
@pytest.mark.parametrize("shape", [(64, 64), (128, 30), (30, 128)])
def test_labels_of_maps_do_not_overlap(pitch, shape):
    """With matplotlib's own ticks, labels such as -0.0015 overlap in six of these nine cases."""
    values = np.arange(1.0, 1 + np.prod(shape)).reshape(shape)
    image = views.image(SimpleNamespace(electrons=values, pitch=pitch))
    found = SimpleNamespace(object=values, status="converged")
    (reconstruction,) = views.reconstruction(found, pitch=25 * pitch)
    for axes in (image, reconstruction):
        assert min(gaps(axes), default=1.0) > 0.0


@pytest.mark.parametrize("width", [0.05, 1.3])
def test_labels_of_narrow_volumes_do_not_overlap(width):
    volume = Volume(np.linspace(0, width, 4), np.linspace(0, 1.4, 4), np.linspace(1, 2, 4))
    image = VolumeImage(intensity=np.ones((4, 4, 4)), volume=volume, method="made")
    assert min(gaps(views.volume(image)), default=1.0) > 0.0


def test_labels_of_long_fits_do_not_overlap():
    axes = views.history(SimpleNamespace(history={"change": np.ones(123_456)}))
    assert min(gaps(axes[0])) > 0.0


def test_ticks_follow_a_new_size_and_survive_pickling():
    """Fewer ticks on smaller axes, also in a figure that was pickled."""
    axes = views.mtf(np.linspace(0.0, 5e5, 11), np.linspace(1.0, 0.0, 11))
    assert min(gaps(axes)) > 0.0
    many = len(axes.get_xticks())
    again = pickle.loads(pickle.dumps(axes.get_figure()))
    again.set_size_inches(1.6, 2.0)
    small = again.axes[0]
    assert min(gaps(small), default=1.0) > 0.0
    assert len(small.get_xticks()) < many


def grey(shape, largest, pitch):
    return SimpleNamespace(
        electrons=np.linspace(0.0, largest, np.prod(shape)).reshape(shape), pitch=pitch
    )


@pytest.mark.parametrize("size", [(4.0, 3.5), (5.6, 4.6), (9.0, 3.0)])
@pytest.mark.parametrize("largest", [1.0, 1e3, 123_456.0, 9.87e7, 2e-5])
@pytest.mark.parametrize("pitch", [1e-7, 1.234e-4])
def test_no_label_of_a_map_is_cut_off(size, largest, pitch):
    axes = views.image(grey((24, 24), largest, pitch))
    figure = axes.get_figure()
    figure.set_size_inches(size)
    figure.draw_without_rendering()
    box = axes.get_tightbbox()
    assert min(box.x0, box.y0) >= 0.0
    assert figure.bbox.x1 - box.x1 >= 0.0
    assert figure.bbox.y1 - box.y1 >= 0.0


@pytest.mark.parametrize("largest", [1.0, 9.87e7])
def test_labels_of_neighbours_do_not_touch(largest):
    found = SimpleNamespace(object=largest * np.eye(4), status="converged")
    left, right = views.reconstruction(found, np.eye(4), pitch=1.234e-3)
    left.get_figure().draw_without_rendering()
    assert left.get_tightbbox().x1 < right.get_tightbbox().x0
    assert right.get_tightbbox().x1 <= left.get_figure().bbox.x1
