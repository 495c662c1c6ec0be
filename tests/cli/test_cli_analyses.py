"""`nlosoptics analyse`: the page and its tables."""

from __future__ import annotations

import json

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import psf
from nlosoptics.cli import main
from nlosoptics.cli.shell import check_target

pytest.importorskip("matplotlib")


@pytest.mark.parametrize(
    ("scene", "perfect"),
    [pytest.param("letter_flat", True, marks=pytest.mark.thorough), ("letter_wavy", False)],
)
def test_tables_of_a_scene(scene, perfect, examples, tmp_path, capsys):
    """A flat wall has the MTF of its pupil; the aberration of a wavy one is that of its terms."""
    with pytest.raises(SystemExit) as ended:
        main(["analyse", str(examples / "scenes" / f"{scene}.toml"), "--out", str(tmp_path / "a")])
    assert not ended.value.code, capsys.readouterr().err
    check_target(tmp_path / "a")  # a second call may replace the folder
    tables = {
        path.stem: np.loadtxt(path, delimiter=",", skiprows=1)
        for path in (tmp_path / "a").glob("*.csv")
    }
    assert {*tables} == {"mtf", "encircled_energy", "through_focus", "zernikes"}
    assert (tmp_path / "a" / "analysis.png").stat().st_size > 10_000
    _, x, y, ideal = tables["mtf"].T
    assert (np.abs(np.stack([x, y]) - ideal).max() < 1e-5) == perfect  # the pupil is not quite even
    assert np.all(np.diff(tables["encircled_energy"][:, 1]) > 0.0)
    noll, terms = tables["zernikes"].T
    waves = np.linalg.norm(terms[noll > 3]) / 632.8
    out = capsys.readouterr().out
    assert waves == pytest.approx(_printed(out, "wave aberration"), rel=0.02, abs=1e-9)
    focus = psf.best_focus(psf.wavefront(nlos.example(scene)))
    report = json.loads((tmp_path / "a" / "result.json").read_text())
    assert report["figures"]["best_focus"] == pytest.approx(focus, rel=1e-3, abs=1e-9)
    assert 1e-3 * _printed(out, "best focus") == pytest.approx(focus, rel=1e-3, abs=1e-9)


def _printed(out: str, quantity: str) -> float:
    """The number that the table of a command has for a quantity."""
    return float(out.split(quantity)[1].split()[0])
