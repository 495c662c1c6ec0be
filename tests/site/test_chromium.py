"""Browser that other tests use: it reports requests and errors, and drags."""

from __future__ import annotations

PAGE = """<!doctype html><html lang="en"><head><title>t</title>
<link rel="icon" href="data:,"></head><body style="margin:0;background:#fff">
<div id="box" style="width:200px;height:200px;background:#08c"></div>
<script>
window.moved = 0;
addEventListener("mousemove", event => { if (event.buttons === 1) moved += event.movementX; });
%s
</script></body></html>"""


def test_a_quiet_page_says_and_asks_nothing(page, tmp_path):
    (tmp_path / "quiet.html").write_text(PAGE % "")
    page.open(tmp_path / "quiet.html")
    page.drag("#box", 50, 0)
    assert page.wait("window.moved") == 50
    assert page.complaints() == []
    assert page.requests() == []
    assert page.picture()[100, 100].tolist() == [0x00, 0x88, 0xCC]


def test_a_loud_page_is_heard(page, tmp_path):
    (tmp_path / "loud.html").write_text(
        PAGE % "console.error('no'); fetch('https://example.org/x').catch(() => window.done = 1);"
    )
    page.open(tmp_path / "loud.html")
    page.wait("window.done")
    assert any("no" in line for line in page.complaints())
    assert page.requests() == ["https://example.org/x"]
