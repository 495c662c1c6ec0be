"""Walk the built site: ``python docs/check_site.py out/docs``.

Every link, anchor, picture, style sheet and script must be there, nothing may be fetched from
elsewhere, and every picture needs a text in its place.
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: What a browser fetches by itself.
FETCHED = {"img": "src", "script": "src", "link": "href", "source": "src", "iframe": "src"}
STYLE_URL = re.compile(r"(?:url\(|@import\s+)[\"']?((?:https?:)?//[^\"')\s;]+)")


class Page(HTMLParser):
    """Anchors of a page, links that a reader may follow, what is fetched, and unnamed pictures."""

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
    found = [] if pages else [f"{site} has no page; build the site first"]
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


if __name__ == "__main__":
    sys.exit("\n".join(faults(Path(sys.argv[1]).resolve())) or None)
