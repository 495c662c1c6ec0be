"""`nlosoptics view`: files of every kind, and one line for whatever is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from nlosoptics import views
from nlosoptics.cli import main
from nlosoptics.errors import MissingExtraError
from nlosoptics.views import stages

pytest.importorskip("pyvista")


@pytest.fixture
def scene(examples: Path) -> str:
    return str(examples / "scenes" / "letter_wavy.toml")


@pytest.fixture
def untried():
    """A process that has not tried to render yet, and will have to again."""
    stages._trial.cache_clear()
    yield
    stages._trial.cache_clear()


def run(capsys, *words: str) -> tuple[int, str, str]:
    """Exit code and what is said on stdout and stderr."""
    with pytest.raises(SystemExit) as ended:
        main(["view", *words])
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err


@pytest.mark.thorough
def test_a_page_shows_what_is_asked_for(scene, capsys, tmp_path):
    out = tmp_path / "room.html"
    code, said, wrong = run(
        capsys, scene, "--out", str(out), "--paths", "50", "--colour", "path_length"
    )
    assert (code, wrong) == (0, "")
    assert said.startswith(f"written to {out}, ")
    text = out.read_text()
    assert "path length from the source (m)" in text
    assert "relay wall, slopes up to 2.5 mrad" in text


@pytest.mark.thorough
def test_paths_are_counted_and_chosen(scene, capsys, monkeypatch, tmp_path):
    """So many of so many reflections, though they are rare; the seed decides which."""
    drawn = []
    saved = views.save
    monkeypatch.setattr(
        views, "save", lambda plotter, path: (drawn.append(plotter), saved(plotter, path))
    )
    for seed in ("0", "0", "1"):
        words = ["--out", str(tmp_path / "x.glb"), "--paths", "20", "--bounces", "4"]
        assert run(capsys, scene, *words, "--seed", seed)[0] == 0
    legs = [plotter.actors["ray paths"].mapper.dataset for plotter in drawn]
    assert [mesh.n_cells for mesh in legs] == [5 * 20] * 3
    assert int(legs[0]["preceding reflections"].max()) == 4
    assert legs[0].points.tobytes() == legs[1].points.tobytes()
    assert legs[0].points.tobytes() != legs[2].points.tobytes()


@pytest.mark.thorough
def test_a_png_is_drawn_where_that_works(scene, capsys, tmp_path):
    try:
        stages.rendering_works()
    except MissingExtraError as error:
        pytest.skip(str(error))
    out = tmp_path / "room.png"
    assert run(capsys, scene, "--out", str(out), "--paths", "20")[0] == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    # paper alone takes a few kB
    assert out.stat().st_size > 50_000


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--out", "room.gif"], 2, "room.gif does not end in .png or .html or .glb"),
        (["--out", "room.glb", "--colour", "red"], 2, "not one of 'bounces', 'path_length'"),
        (
            ["--out", "room.glb", "--bounces", "1", "--paths", "5"],
            2,
            "none of 131072 traced rays reaches the camera with --bounces 1; --paths 0",
        ),
    ],
)
def test_bad_wishes_are_one_line(scene, capsys, monkeypatch, tmp_path, words, code, said):
    monkeypatch.chdir(tmp_path)
    found, printed, wrong = run(capsys, scene, *words)
    assert found == code
    assert said in wrong
    assert (printed, wrong.count("\n")) == ("", 1)
    assert list(tmp_path.iterdir()) == []


def test_a_machine_that_cannot_render_is_told_before_any_work(
    scene, capsys, monkeypatch, tmp_path, untried
):
    monkeypatch.setattr(stages, "TRIAL", "import os\nos.kill(os.getpid(), 11)")
    monkeypatch.setattr("nlosoptics.raytrace.trace", lambda *_, **__: 1 / 0)
    code, _, wrong = run(capsys, scene, "--out", str(tmp_path / "room.png"))
    assert code == 1
    assert "SIGSEGV" in wrong
    assert "apt-get install libegl1" in wrong
    assert wrong.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_without_a_display_a_file_is_proposed(scene, capsys, monkeypatch, untried):
    monkeypatch.setattr(stages, "TRIAL", "print('vtkEGLRenderWindow')")
    code, _, wrong = run(capsys, scene)
    assert code == 1
    assert wrong == (
        "nlosoptics: there is no display to open a window on; write a file instead, such as "
        "room.html\n"
    )
