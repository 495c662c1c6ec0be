"""Figures drawn by two other processes."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from nlosoptics import simulate
from nlosoptics.cli import figures
from nlosoptics.psf import ScenePointSpread
from nlosoptics.runs.plan import Plan
from nlosoptics.views import maps, run_overview
from nlosoptics.views.run_overview import AwaitedOverview, overview_panels
from nlosoptics.views.saving import panel_files

HERE = os.getpid()
forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")


@pytest.fixture
def drawn_by(tmp_path, monkeypatch, flat_scene):
    """Function that draws fake figures and returns the process that drew each of them.

    Its arguments are functions that are called before the figure of their name is drawn.
    """

    def run(cores=2, **before):
        def named(name):
            def draw():
                before.get(name, lambda: None)()
                return {name: str(os.getpid()).encode()}

            return lambda _: {name: draw}

        monkeypatch.setattr(figures, "_of_scene", named("scene"))
        monkeypatch.setattr(figures, "_of_wave", named("point_spread"))
        monkeypatch.setattr(figures, "_of_run", named("overview"))
        late = named("overview")(None)["overview"]
        awaited = SimpleNamespace(draw_optics=id, awaiting=lambda _: lambda _: late())
        monkeypatch.setattr(figures, "_overview", lambda _: awaited)
        monkeypatch.setattr(figures, "_drawn", lambda draw: draw())
        monkeypatch.setattr(figures.os, "cpu_count", lambda: cores)
        plan = Plan(stages=(), skipped=(), tol=1e-3, waves=0.0, exit_pupil=None, budget=None)
        result = SimpleNamespace(scene=flat_scene, plan=plan)
        with figures.painters() as beside:
            beside.send(flat_scene)
            beside.send(None)
            beside.send(result)
            beside.send(None, tmp_path)
            figures.write_figures(result, tmp_path, beside)
        return {path.stem: int(path.read_text()) for path in tmp_path.iterdir()}

    return run


def elsewhere(action):
    """Return a function that does something in other processes than this one."""
    return lambda: action() if os.getpid() != HERE else None


def awaited(result):
    """Return the function that completes the overview of a result without reconstruction."""
    overview = AwaitedOverview(result.scene)
    overview.draw_optics(result)
    return overview.awaiting(result)


def fail():
    raise MemoryError


@forks
def test_two_other_processes_draw(drawn_by):
    found = drawn_by()
    assert found["scene"] == found["point_spread"]
    assert len({HERE, found["scene"], found["overview"]}) == 3


def test_one_core_draws_all_here(drawn_by):
    assert drawn_by(cores=1) == dict.fromkeys(("scene", "point_spread", "overview"), HERE)


@pytest.mark.parametrize("name", ["scene", "point_spread", "overview"])
def test_figures_of_a_process_that_fails_are_drawn_here(drawn_by, capfd, name):
    assert drawn_by(**{name: elsewhere(fail)})[name] == HERE
    assert capfd.readouterr().err == ""


def test_an_error_reaches_the_caller(drawn_by):
    def broken():
        raise ValueError("no such colour")

    with pytest.raises(ValueError, match="no such colour"):
        drawn_by(overview=broken)


@forks
@pytest.mark.parametrize("name", ["scene", "overview"])
def test_a_process_that_hangs_is_ended(drawn_by, monkeypatch, name):
    """Its figures are drawn here; no process is left, whichever of the two hangs."""
    monkeypatch.setattr(figures, "LONGEST", 2.0)
    monkeypatch.setattr(figures, "ENDING", 0.1)
    ends = []
    monkeypatch.setattr(figures.os, "killpg", lambda *call: (ends.append(call), kill(*call)))
    assert drawn_by(**{name: elsewhere(lambda: time.sleep(60))})[name] == HERE
    assert_gone(ends[0][0])


@forks
def test_what_cannot_be_sent_is_drawn_here(drawn_by, monkeypatch):
    """A full disk, for example: nobody waits for processes that wait for the result."""

    def full(*_, **__):
        raise OSError("disk full")

    monkeypatch.setattr(figures.pickle, "dump", full)
    assert set(drawn_by().values()) == {HERE}


@pytest.mark.parametrize("reconstruct", [True, False])
def test_an_awaited_overview_is_the_one_drawn_at_once(flat_scene, monkeypatch, reconstruct):
    """To the last byte, whether the fit is as expected, so that only its image is drawn, or not."""
    dim = replace(flat_scene, laser=replace(flat_scene.laser, power=1e-4))  # no full pixel
    result = simulate(dim.resized(32), tol=1e-2, reconstruct=reconstruct)
    fits = [result.reconstruction]
    if reconstruct:
        fit = result.reconstruction
        assert (fit.status, fit.object.min(), fit.object.max()) == ("converged", 0.0, 1.0)
        fits += [
            replace(fit, status="not_converged"),
            replace(fit, object=fit.object + 1.0),
            replace(fit, object=2.0 * fit.object),
        ]
    wanted = [panel_files(overview_panels(replace(result, reconstruction=each))) for each in fits]
    assert set(wanted[0]) == {"overview", "wavefront", "image", *["reconstruction"] * reconstruct}
    complete = awaited(replace(result, reconstruction=None))
    assert [complete(each) for each in fits[1:]] == wanted[1:]
    monkeypatch.setattr(run_overview, "panel_files", None)  # not needed for what is expected
    assert complete(fits[0]) == wanted[0]


def test_an_awaited_overview_with_longer_labels_is_drawn_anew(flat_scene, monkeypatch):
    """Its labels do not fit the places that a layout tries first."""
    result = simulate(flat_scene.resized(32), tol=1e-2)
    monkeypatch.setitem(maps.MEANING, result.point_spread.normalisation, "energy\n" * 6)
    complete = awaited(result)
    assert complete(None) == panel_files(overview_panels(result))


def test_panels_are_cut_out_with_all_their_labels(flat_scene):
    """The outline of a panel is blank, so that no label is cut, and the rest of it is not."""
    result = simulate(flat_scene.resized(32), tol=1e-2, reconstruct=True)
    whole, *panels = (
        np.asarray(Image.open(BytesIO(content)).convert("L"))
        for content in panel_files(overview_panels(result)).values()
    )
    for panel in panels:
        blank = panel == 255
        assert blank[[0, -1]].all()
        assert blank[:, [0, -1]].all()
        assert not blank[10:-10, 10:-10].all(axis=0).all()
        assert panel.shape[0] < whole.shape[0] / 2


@forks
def test_other_processes_draw_the_same_figures(flat_scene, tmp_path, monkeypatch):
    """To the last byte, although matplotlib does less in them."""
    monkeypatch.setattr(figures.os, "cpu_count", lambda: 2)
    result = simulate(flat_scene.resized(32), tol=1e-2, reconstruct=True)
    folders = [tmp_path / name for name in ("here", "there")]
    for folder in folders:
        folder.mkdir()
    figures.write_figures(result, folders[0])
    with figures.painters() as beside:
        beside.send(flat_scene)
        wave = {name: getattr(result, name) for name in ScenePointSpread.__dataclass_fields__}
        beside.send(ScenePointSpread(**wave))
        beside.send(replace(result, reconstruction=None))
        beside.send(result.reconstruction, folders[1])
        monkeypatch.setattr(figures, "_drawn", None)  # nothing is left to draw here
        figures.write_figures(result, folders[1], beside)
    here, there = (
        {file.name: file.read_bytes() for file in folder.iterdir()} for folder in folders
    )
    assert len(here) == 6
    assert here == there


@forks
def test_processes_end_with_a_run_that_fails(monkeypatch):
    monkeypatch.setattr(figures.os, "cpu_count", lambda: 2)
    ends = []
    monkeypatch.setattr(figures.os, "killpg", lambda *call: (ends.append(call), kill(*call)))
    with pytest.raises(KeyboardInterrupt), figures.painters():
        raise KeyboardInterrupt
    assert_gone(ends[0][0])


kill = getattr(os, "killpg", None)


def assert_gone(group):
    """Check that a process group has no running member left."""
    for _ in range(100):
        try:
            kill(group, 0)
        except OSError:
            return
        time.sleep(0.05)
    raise AssertionError(f"processes of the group {group} still run")
