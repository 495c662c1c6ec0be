"""The gallery's scripts run, each within its limit, and their figures show something."""

from __future__ import annotations

import runpy
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlosoptics.errors import MissingExtraError
from nlosoptics.views.stages import rendering_works

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("plot_*.py"))
#: Scripts that draw in three dimensions.
ROOMS = {"plot_ray_paths"}
#: Scripts that need torch.
TORCH = {
    "plot_blind_fit",
    "plot_design_by_gradient",
    "plot_exposure",
    "plot_occluder_by_gradient",
}
LIMIT = 240  # s; under a minute on two free cores, and tests share theirs


@pytest.fixture
def pyplot(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """pyplot without a window or any figure, its settings put back afterwards."""
    matplotlib = pytest.importorskip("matplotlib")
    monkeypatch.setenv("MPLBACKEND", "agg")
    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    with matplotlib.rc_context():
        plt.close("all")
        yield plt
        plt.close("all")


@pytest.mark.thorough
@pytest.mark.timeout(LIMIT)
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_script_draws(
    script: Path,
    pyplot: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if script.stem in TORCH:
        pytest.importorskip("torch")
    if script.stem in ROOMS:
        prepare_rooms(monkeypatch)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive")
        names = runpy.run_path(str(script), run_name="__main__")
    assert pyplot.get_fignums()
    for number in pyplot.get_fignums():
        figure = pyplot.figure(number)
        figure.canvas.draw()
        assert shown(np.asarray(figure.canvas.buffer_rgba())[..., :3]) > 0.01
        assert [axes for axes in figure.axes if axes.has_data() and not labelled(axes)] == []
    if script.stem in ROOMS:
        plotter = names["plotter"]
        assert shown(plotter.screenshot(None, return_img=True)) > 0.01
        plotter.close()
    printed = capsys.readouterr().out
    assert any(letter.isdigit() for letter in printed)
    assert "nan" not in printed.lower().split()


def prepare_rooms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw off the screen, and keep what was drawn."""
    try:
        rendering_works()
    except MissingExtraError as error:
        pytest.skip(str(error))
    import pyvista

    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.setattr(pyvista, "BUILDING_GALLERY", True)


def shown(picture: Any) -> float:
    """Share of pixels of another colour than the picture's commonest; 0 for a blank one."""
    colours, counts = np.unique(picture.reshape(-1, 3), axis=0, return_counts=True)
    return 1.0 - counts.max() / counts.sum() if len(colours) > 8 else 0.0


def labelled(axes: Any) -> bool:
    """Whether each axis whose ticks show numbers says which quantity they are of."""
    return all(
        axis.get_label_text()
        for axis in (axes.xaxis, axes.yaxis)
        if any(
            label.get_visible() and any(letter.isdigit() for letter in label.get_text())
            for tick in axis.get_major_ticks()
            for label in (tick.label1, tick.label2)
        )
    )
