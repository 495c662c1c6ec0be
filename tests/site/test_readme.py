"""The README's commands, links and example, taken from the README itself."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_one_screen() -> None:
    """At most 120 lines; what is longer belongs to the documentation."""
    assert len(README.splitlines()) <= 120


def test_commands_are_whole_lines() -> None:
    """Each command is one line that can be pasted; CI reads the second from here."""
    lines = README.splitlines()
    run = "pip install -c constraints.txt '.[all]' && nlosoptics run corner"
    develop = "pip install -c constraints.txt -e '.[all,test]' && pytest"
    assert lines.count(run) == 1
    assert lines.count(develop) == 1


def test_links_lead_somewhere() -> None:
    """Relative links and images exist."""
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", README)
    assert targets
    assert [t for t in targets if not (ROOT / t).is_file()] == []


def test_example_runs(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    code_blocks: Callable[[Path, str], list[str]],
) -> None:
    """The Python example, in an empty folder next to the examples."""
    (example,) = code_blocks(ROOT / "README.md", "python")
    assert len(example.splitlines()) <= 12
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    assert "waves rms, PSF error" in capsys.readouterr().out
    assert (tmp_path / "overview.png").stat().st_size > 50_000


def test_script_for_camera_images_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``examples/reconstruct.py`` on the image of another scene, of the camera's pixels."""
    import nlosoptics as nlos

    scene = nlos.Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml").resized(64)
    scene.save(tmp_path / "letter.toml")
    np.save(tmp_path / "letter.npy", nlos.simulate(scene, seed=0).image.electrons)
    script = shutil.copy(ROOT / "examples" / "reconstruct.py", tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["reconstruct.py", "letter.toml", "letter.npy"])
    exec(compile(Path(script).read_text(), str(script), "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out
    assert printed.startswith("recoverable\n")
    assert "converged, residual" in printed
    assert (tmp_path / "object.png").stat().st_size > 5_000
