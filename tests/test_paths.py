"""Paths that no system takes, for every function and option that takes one; links."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import _whole_files, cli, imaging, psf, report, views
from nlosoptics.errors import SceneError
from nlosoptics.scene import HeightMapWall, MeshObject, PlanarObject
from nlosoptics.study import Results, Study
from nlosoptics.transient import TransientCapture

CAPTURE = TransientCapture(
    H=np.ones((2, 1, 1)),
    laser_points=np.zeros((1, 1, 3)),
    sensor_points=np.zeros((1, 1, 3)),
    t_start=0.5,
    delta_t=0.003,
    pairing="confocal",
)
AHEAD = (0.0, 0.0, 1.0)
TAKING_PATHS: dict[str, Callable[[Any], Any]] = {
    "Scene.load": nlos.Scene.load,
    "load_result": nlos.load_result,
    "PlanarObject": lambda path: PlanarObject(path, 0.1, position=AHEAD),
    "MeshObject": lambda path: MeshObject(path, position=AHEAD).surface,
    "HeightMapWall": lambda path: HeightMapWall(path, 0.1),
    "camera_image": imaging.camera_image,
    "TransientCapture.load": TransientCapture.load,
    "TransientCapture.save": CAPTURE.save,
    "read_zernikes": psf.read_zernikes,
    "write_zernikes": lambda path: psf.write_zernikes(path, {4: 5e-8}),
    "Study.load": Study.load,
    "Results.load": Results.load,
    "report.page": report.page,
    "views.save": partial(views.save, None),  # type: ignore[arg-type]
}
PATHS = {
    "null": "a\0b",
    "name": "x" * 100_000,
}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("function", TAKING_PATHS)
def test_paths_that_no_system_takes_are_one_short_line(function: str, path: str) -> None:
    with pytest.raises(SceneError, match="cannot be the path of a file or folder") as caught:
        TAKING_PATHS[function](PATHS[path])
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    "words",
    [
        "plan PATH",
        "run SCENE --out PATH",
        "reconstruct SCENE --scene PATH",
        "image PATH",
        "report PATH",
        "view SCENE --out PATH.html",
    ],
)
def test_a_long_path_is_bad_input_in_one_line(
    words: str, examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = str(examples / "scenes" / "letter_flat.toml")
    given = words.replace("SCENE", scene).replace("PATH", PATHS["name"]).split()
    with pytest.raises(SystemExit) as ended:
        cli.main(given)
    told = capsys.readouterr().err
    assert ended.value.code == 2, told[:200]
    assert told.count("\n") == 1
    assert len(told) < 1000
    assert "File name too long" in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
class TestLinks:
    def test_a_linked_file_is_replaced_and_the_link_stays(self, tmp_path: Path) -> None:
        """The linked file may be missing; its folder gets the temporary files."""
        (tmp_path / "disk").mkdir()
        real, link = tmp_path / "disk" / "file", tmp_path / "link"
        link.symlink_to(real)
        for value in (b"1", b"2"):
            _whole_files.write_whole({link: value})
            assert link.is_symlink()
            assert real.read_bytes() == value
            assert sorted(p.name for p in tmp_path.iterdir()) == ["disk", "link"]
            assert [p.name for p in real.parent.iterdir()] == ["file"]

    def test_a_linked_folder_may_be_missing(self, tmp_path: Path) -> None:
        link = tmp_path / "link"
        link.symlink_to(tmp_path / "real")
        _whole_files.check_folder(link)
        with _whole_files.whole_folder(link) as new:
            (new / "a").write_text("1")
        assert link.is_symlink()
        assert (tmp_path / "real" / "a").read_text() == "1"

    @pytest.mark.parametrize(
        ("target", "words"),
        [("missing/real", "missing, which is no folder"), ("link", "symbolic links")],
    )
    @pytest.mark.parametrize("command", ["run"])
    def test_links_that_lead_nowhere_are_told_before_any_work(
        self, command, target, words, examples, tmp_path, capsys
    ) -> None:
        (tmp_path / "link").symlink_to(tmp_path / target)
        scene = examples / "scenes" / "letter_flat.toml"
        with pytest.raises(SystemExit) as ended:
            cli.main([command, str(scene), "--out", str(tmp_path / "link")])
        told = capsys.readouterr().err
        assert ended.value.code == 2, told
        assert told.count("\n") == 1
        assert words in told
        assert [p.name for p in tmp_path.iterdir()] == ["link"]
