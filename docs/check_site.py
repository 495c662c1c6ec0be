"""Walk the built site: ``python docs/check_site.py out/docs``.

Every link, anchor, picture, style sheet and script must be there, nothing may be fetched from
elsewhere, and every picture needs a text in its place. No page may scroll sideways on a phone;
this is measured where Chromium is installed.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: What a browser fetches by itself.
FETCHED = {"img": "src", "script": "src", "link": "href", "source": "src", "iframe": "src"}
STYLE_URL = re.compile(r"(?:url\(|@import\s+)[\"']?((?:https?:)?//[^\"')\s;]+)")
#: Width of a phone's screen, pixels.
PHONE = 420
#: Opens each page in a frame of a phone's width and writes down those that are wider. The theme
#: lets the article scroll, so that the page itself does not become wider.
PROBE = """<!doctype html><ul></ul><script>
const frame = document.createElement("iframe");
frame.width = %d;
frame.height = 900;
frame.style.border = "none";
document.body.append(frame);
(async () => {
  for (const page of %s) {
    await new Promise((loaded) => { frame.onload = loaded; frame.src = page; });
    const shown = frame.contentDocument;
    const parts = [shown.documentElement, ...shown.querySelectorAll(".bd-article-container")];
    const wide = Math.max(...parts.map((part) => part.scrollWidth));
    if (wide > frame.width) {
      document.querySelector("ul").innerHTML += `<li>${page} ${wide}</li>`;
    }
  }
  document.body.append("all measured");
})();
</script>"""


class Page(HTMLParser):
    """Anchors of a page, and where it leads.

    Attributes
    ----------
    anchors : set of str
    links : list of str
        Targets that a reader may follow.
    fetched : list of str
        Addresses that the browser asks for.
    unnamed : list of str
        Pictures without a text in their place.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.unnamed: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Book what a tag names."""
        given = {name: value or "" for name, value in attributes}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") in ("search", "next", "prev", "index", "canonical"):
            return
        if tag in FETCHED and given.get(FETCHED[tag]):
            self.fetched.append(given[FETCHED[tag]])
        if tag == "img" and "alt" not in given:  # empty where the text beside says it
            self.unnamed.append(given.get("src", ""))


def faults(site: Path) -> list[str]:
    """Return a line for everything that is wrong with a site, none where all is well."""
    files = (path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts)
    pages = {path: Page(path.read_text()) for path in files}
    found = []
    for path, page in pages.items():
        name = path.relative_to(site)
        found += [f"{name}: picture {source} has no alt text" for source in page.unnamed]
        for address in page.fetched:
            if urlsplit(address).netloc:
                found.append(f"{name}: fetches {address}")
        for address in (*page.links, *page.fetched):
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                found.append(f"{name}: {address} is not there")
            elif parts.fragment and target in pages:
                anchors = pages[target].anchors
                if unquote(parts.fragment) not in anchors:
                    found.append(f"{name}: {address} has no such anchor")
    for path in sorted(site.rglob("*.css")):
        outside = STYLE_URL.findall(path.read_text())
        found += [f"{path.relative_to(site)}: fetches {address}" for address in outside]
    return found


def wide_pages(site: Path) -> list[str]:
    """Return a line for every page that is wider than a phone, measured by Chromium."""
    browser = shutil.which("chromium")
    if browser is None:
        print("chromium is not installed: the widths of the pages are not checked")
        return []
    pages = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
    with tempfile.TemporaryDirectory() as folder:
        probe = Path(folder) / "probe.html"
        probe.write_text(PROBE % (PHONE, json.dumps([path.as_uri() for path in pages])))
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
        options += [f"--user-data-dir={folder}/profile", "--timeout=300000", "--dump-dom"]
        done = subprocess.run(
            [browser, *options, probe.as_uri()], capture_output=True, text=True, check=True
        )
    measured = done.stdout.rpartition("</script>")[2] + done.stdout.partition("<script>")[0]
    if "all measured" not in measured:
        return [f"the widths of the pages could not be measured: {done.stderr[-300:]}"]
    return [
        f"{Path(urlsplit(page).path).relative_to(site)}: {width} pixels wide, limit {PHONE}"
        for page, width in re.findall(r"<li>(\S+) (\d+)</li>", measured)
    ]


if __name__ == "__main__":
    place = Path(sys.argv[1]).resolve()
    wrong = faults(place) + wide_pages(place)
    sys.exit("\n".join(wrong) or None)
