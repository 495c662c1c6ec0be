"""The README's commands and example, taken from the README itself."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_commands_are_whole_lines() -> None:
    """Each command is one line that can be pasted; CI reads the second from here."""
    lines = README.splitlines()
    run = (
        "pip install -c constraints.txt '.[all]' && nlosoptics run examples/scenes/letter_flat.toml"
    )
    develop = "pip install -c constraints.txt -e '.[all,test]' && pytest"
    assert lines.count(run) == 1
    assert lines.count(develop) == 1


def test_links_lead_somewhere() -> None:
    """Relative links and pictures exist."""
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", README)
    assert targets
    assert [t for t in targets if not (ROOT / t).is_file()] == []


def test_examples_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    code_blocks: Callable[[Path, str], list[str]],
) -> None:
    """The Python examples, one after the other, in a folder of their own beside the examples."""
    examples = code_blocks(ROOT / "README.md", "python")
    assert [len(example.splitlines()) <= 15 for example in examples] == [True] * 4
    script = (ROOT / "examples" / "reconstruct.py").read_text()
    assert script.split('"""\n\n', 1)[1] == examples[1]
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for example in examples:
        exec(compile(example, "README.md", "exec"), names)
        if example is examples[0]:  # whose image is what the next one reads
            names["scene"].save("letter.toml")
            np.save("letter.npy", names["result"].image.electrons)
            monkeypatch.setattr(sys, "argv", ["reconstruct.py", "letter.toml", "letter.npy"])
    printed = capsys.readouterr().out
    assert "waves rms" in printed
    assert "\nrecoverable\n" in printed
    assert "converged, residual" in printed
    assert "W detected of 0.005 W" in printed
    assert "is the cheapest within tol = 1e-06" in printed
    assert "quadrature" in printed
    assert (tmp_path / "letter.png").stat().st_size > 10_000
