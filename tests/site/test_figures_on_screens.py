"""Figures and names of the documentation on a phone and on a desktop, measured by Chromium."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

STATIC = Path(__file__).parents[2] / "docs" / "_static"
PAGE = """<!doctype html><html><head><meta name="viewport" content="width=device-width">
<link rel="stylesheet" href="nlosoptics.css"><link rel="icon" href="data:,">
<style>img {{ max-width: 100%; height: auto }} body {{ margin: 0 }}</style>
<script src="accessible.js"></script></head><body><article class="bd-article">
<img id="gallery" class="sphx-glr-single-img" src="wide.png" alt="">
<img id="own" src="wide.png" alt=""><img id="narrow" src="narrow.png" alt="">
<table><tr><td><code class="literal"><span class="pre">{name}</span></code></td></tr></table>
</article></body></html>"""
WIDE, NARROW = 1600, 300  # pixels
NAME = "tests/site/test_figures_on_screens.py::" + "names_of_tests_are_long_" * 4


@pytest.fixture
def site(page: Any, tmp_path: Path) -> Iterator[Any]:
    """A page of figures in a browser whose screen is set to a width by the test."""
    image = pytest.importorskip("PIL.Image")
    for name in ("nlosoptics.css", "accessible.js"):
        shutil.copy(STATIC / name, tmp_path)
    image.new("RGB", (WIDE, 400)).save(tmp_path / "wide.png")
    image.new("RGB", (NARROW, 200)).save(tmp_path / "narrow.png")
    (tmp_path / "page.html").write_text(PAGE.format(name=NAME))

    def show(width: int) -> Any:
        screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        page.open(tmp_path / "page.html")
        page.wait("document.querySelectorAll('.figure-frame.cut').length")
        return page

    yield show
    page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def widths(page: Any) -> dict[str, float]:
    """Width of each figure on the screen, pixels."""
    found: dict[str, float] = page.driver.execute_script(
        "return Object.fromEntries([...document.images].map(i => [i.id, i.clientWidth]))"
    )
    return found


@pytest.mark.parametrize("screen", [420, 1000])
def test_wide_figures_keep_their_letters_and_scroll_in_their_frame(site: Any, screen: int) -> None:
    """8 points are 8 pixels: 8 x 100 / 72 x 0.75 of the gallery's, 8 x 120 / 72 x 0.6 of others."""
    page = site(screen)
    shown = widths(page)
    assert shown["gallery"] * 8 * 100 / 72 / WIDE >= 8.0
    assert shown["own"] * 8 * 120 / 72 / WIDE == pytest.approx(max(8.0, screen / 120), rel=2e-3)
    assert shown["narrow"] == (screen if screen < 600 else NARROW)
    cut = "return [...document.querySelectorAll('.cut img')].map(i => i.id)"
    assert page.driver.execute_script(cut) == (["gallery", "own"] if screen < 960 else ["gallery"])
    assert page.driver.execute_script("return document.documentElement.scrollWidth") == screen
    # a figure leads to itself, for a reader who enlarges it
    leads = "return document.querySelector('#own').closest('a').href.split('/').pop()"
    assert page.driver.execute_script(leads) == "wide.png"


def test_long_names_break_after_their_signs(site: Any) -> None:
    """No line of a name ends within a word, and copied text is the name itself."""
    page = site(420)
    pre = "document.querySelector('.pre')"
    assert page.driver.execute_script(f"return {pre}.textContent") == NAME
    pieces = page.driver.execute_script(
        f"return [...{pre}.childNodes].map(n => n.nodeType === 3 ? n.data : '')"
    )
    assert max(len(piece) for piece in pieces) <= len("screens.")
    high = page.driver.execute_script(f"return {pre}.getClientRects().length")
    assert high >= 3
