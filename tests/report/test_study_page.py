"""The page about a study: its structure, its truth to the store, its manners in a browser."""

from __future__ import annotations

import html
from pathlib import Path

import pytest

from nlosoptics import report
from nlosoptics.errors import SceneError
from nlosoptics.report.elements import quantity
from nlosoptics.study import Results, Study, run_study

from .test_report import Outline, plain, told

SCENE = str(Path(__file__).parents[2] / "examples" / "scenes" / "letter_flat.toml")
SMALL = {"camera.binning": 64}
FOCUS = "camera.focus_distance"
DESIGNS = {
    # the last focus is within the focal length, so that its points fail
    "axes": {"axes": {FOCUS: ["2 m", "2.05 m", "0.01 m"], "camera.f_number": [16, 22]}},
    "case": {"one_at_a_time": {FOCUS: ["1.95 m", "0.01 m"], "camera.f_number": [22]}},
    "draws": {"draws": {"count": 8, "of": {FOCUS: {"from": "2 m", "to": "2.1 m"}}}},
    "saltelli": {
        "draws": {
            "count": 4,
            "method": "saltelli",
            "of": {
                FOCUS: {"from": "2 m", "to": "2.1 m"},
                "camera.f_number": {"from": 16, "to": 22},
            },
        }
    },
}


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Stores of small studies, the name of one of which does harm where it is not escaped."""
    place = tmp_path_factory.mktemp("studies")
    found = {}
    for name, design in DESIGNS.items():
        tables = {"scene": SCENE, "figures": ["strehl", "spot_rms"], "set": SMALL} | design
        found[name] = place / f"{name}<b>&.zarr"
        run_study(Study.from_tables(tables), found[name], workers=0)
    return found


@pytest.fixture(scope="module")
def pages(stores: dict[str, Path]) -> dict[str, str]:
    return {n: report.page(store, computed=n == "axes") for n, store in stores.items()}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "pictures"),
    [
        # of both figures a map and curves, a tornado, a yield and a cloud, bars and clouds;
        # and the point spreads
        ("axes", 2 * 2 + 1),
        ("case", 2 * 1),
        ("draws", 2 * 2),
        ("saltelli", 2 * 2),
    ],
)
def test_structure(name: str, pictures: int, pages: dict[str, str]) -> None:
    outline = Outline(pages[name])
    sections = ["design", "figure-0", "figure-1", "spreads", "failures", "provenance"]
    if name not in ("axes", "case"):
        sections.remove("failures")
    if name != "axes":
        sections.remove("spreads")
    assert [a["id"] for a in outline.named("section")] == sections
    assert [a["href"] for a in outline.named("a")] == [f"#{anchor}" for anchor in sections]
    assert len(outline.named("img")) == len(outline.named("figure")) == pictures
    assert all(a["alt"] for a in outline.named("img"))
    for _, attributes in outline.elements:
        for key in ("src", "href", "data", "srcset"):
            assert attributes.get(key, "#").startswith(("data:", "#"))
    assert "url(" not in pages[name]
    assert "<script" not in pages[name]
    assert "default-src 'none'" in outline.named("meta")[-1]["content"]
    title = pages[name].split("<title>")[1].split("</title>")[0]
    assert html.unescape(title) == f"{name}<b>&.zarr, nlosoptics study"


@pytest.mark.thorough
def test_tells_what_the_store_holds(stores: dict[str, Path], pages: dict[str, str]) -> None:
    results = Results.load(stores["axes"])
    words = told(pages["axes"])
    assert "2 figures of merit at 6 points" in words
    assert "Points done 4 Points failed 2" in words
    assert "camera.focus_distance 3 2 m, 2.05 m, 10 mm" in words
    values = results.values("strehl")
    best, worst = int(values.argsort()[3]), int(values.argsort()[0])
    assert f"worst {values[worst]:.4g} {worst} camera.focus_distance" in words
    assert f"best {values[best]:.4g} {best} camera.focus_distance" in words
    # a spot is best where it is smallest
    spots = results.values("spot_rms")
    assert plain(f"best {quantity(min(spots[:4]), 'm')} {spots.argsort()[0]}") in words
    ((message, count),) = results.failures().items()
    assert f"{' '.join(message.split())} {count}" in words
    assert '"camera.binning": 64' in words


def test_unfinished_study_says_so(stores: dict[str, Path], tmp_path: Path) -> None:
    tables = {"scene": SCENE, "figures": ["strehl"], "set": SMALL} | DESIGNS["saltelli"]
    path = tmp_path / "part.zarr"
    run_study(
        Study.from_tables(tables), path, workers=0, interrupted=iter([False, *[True] * 99]).__next__
    )
    words = told(report.page(path, computed=False))
    pending = Results.load(path).counts["pending"]
    assert pending > 0
    assert f"{pending} points of 16 are pending" in words
    assert "A picture is left out, because" in words
    assert "Worst, median and best" not in words


def test_no_store_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="holds no result.json"):
        report.page(tmp_path)
