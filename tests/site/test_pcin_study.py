"""The study of the paper's experiments: its data, and its smallest case from end to end."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from pytest import approx

pytest.importorskip("torch")

SIZE = 48


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module."""
    folder = Path(__file__).parents[2] / "examples" / "pcin_study"
    monkeypatch.syspath_prepend(str(folder))
    import study

    return study


@pytest.mark.thorough
def test_smallest_case_runs_and_is_not_run_again(
    study: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line a case, tables and pictures; a line that was cut off is made again, others not."""
    arguments = ["--setting", "smallest", "--out", str(tmp_path)]
    study.main(arguments)
    path = tmp_path / "smallest.jsonl"
    lines = [json.loads(text) for text in path.read_text().splitlines()]
    found = {line["method"]: line for line in lines}
    assert list(found) == [key["method"] for key in study.keys("smallest")]
    # with the blur known, a filter undoes some of it
    assert found["inverse_filter"]["correlation"] > found["image"]["correlation"] + 0.1
    # two frames tell the wave of 0.50 to a fiftieth of a wave
    assert found["evidence_2frames"]["wave_error"] < 0.02
    table = (tmp_path / "tables.md").read_text()
    assert f"{found['tv']['correlation']:.3f}\\* (1)" in table
    assert f"{found['inverse_filter']['correlation']:.3f}" in table
    for name in ("smooth_walls", "smooth_exposures", "smooth_objects"):
        assert (tmp_path / f"{name}.png").stat().st_size > 5_000

    texts = path.read_text().splitlines()
    cut = next(i for i, line in enumerate(lines) if line["method"] == "tv")
    texts[cut], texts[-1] = texts[-1], texts[cut][:30]
    path.write_text("\n".join(texts) + "\n")
    capsys.readouterr()
    study.main(arguments)
    told = [line for line in capsys.readouterr().out.splitlines() if line]
    assert len(told) == 1
    assert told[0].startswith("smooth-letter-concave-40ms-48-seed1-tv ")
    assert len(study.finished(path)) == len(lines)


def test_cases_of_a_setting_differ(study: ModuleType) -> None:
    """No case is asked for twice, under the names that tell finished ones."""
    for setting in study.SETTINGS:
        names = [study.report.name_of(key, key["method"]) for key in study.keys(setting)]
        assert len(set(names)) == len(names)


def test_exposures_scale_and_walls_bend(study: ModuleType) -> None:
    """Light goes with time, the second frame has its half wave, and the walls their waves."""
    data = study.data
    place = ("smooth", "letter", "flat", SIZE, 0)
    long, short = (data.exposure_of(place, ms, 1) for ms in (40, 10))
    assert np.max(np.abs(long.truth - 4.0 * short.truth)) <= 1e-9 * long.truth.max()
    # a white pixel has what it has in the paper's geometry, 1090 electrons, to a few percent
    assert long.truth.max() == approx(1090.0, rel=0.05)
    for scale in data.SCALES:
        # Noll 4 of a small change of focus: its fourth order is (radius/distance)^2/4 of it
        assert abs(data.defocus_waves(scale, SIZE)) == approx(data.DIVERSITY, rel=2e-3)
    lengths = {w: float(np.linalg.norm(data.wall_waves(w, SIZE))) for w in data.WALLS}
    assert lengths["flat"] < 1e-3  # of an aligned flat wall nothing but the lens's focus is left
    assert 0.45 < lengths["concave"] < 0.55
    assert 0.45 < lengths["convex"] < 0.55
    # focus of the two spheres has either sign
    assert data.wall_waves("concave", SIZE)[0] * data.wall_waves("convex", SIZE)[0] < 0.0


@pytest.mark.thorough
def test_facets_make_speckle(study: ModuleType) -> None:
    """Walls of facets have developed speckle, each its own.

    Developed speckle has a mean square of twice the squared mean. The facets' envelope raises it,
    and pixels half as wide as a grain lower it by at most a fifth.
    """
    spreads = []
    for seed in (1, 2):
        kernel = study.data.known_model(("rough", "letter", "flat", 96, seed), mean=True).kernel
        low = len(kernel) // 2 - 16
        spreads.append(kernel[low : low + 32, low : low + 32].ravel())
    for spread in spreads:
        assert np.mean(spread**2) / np.mean(spread) ** 2 > 1.6
    # independent walls correlate by 0.06, as 32 x 32 pixels hold some 300 grains; here five times
    assert abs(np.corrcoef(*spreads)[0, 1]) < 0.3
