"""What the code of a page prints and draws, below each block."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image
from tables import ROOT

from nlosoptics.cli import main

if TYPE_CHECKING:
    from sphinx.application import Sphinx

#: A block of code with its language.
FENCE = re.compile(r"^```([\w-]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
#: Begins a block of Python and ends a command that cannot be run in seconds, with the reason.
NOT_RUN = re.compile(r"# not run in the tests: \S")
#: Ends of a directive that holds any printed text.
BLOCK = "`" * 8
#: Pages whose code is run at each build, by the start of their names.
SHOWN = ("tutorial", "limits", "validation", "doors/", "howto/")


def blocks(text: str, folder: Path) -> Iterator[tuple[int, str, list[Path]]]:
    """Run a page's commands and Python, in order, in one namespace, beside the examples.

    Yields where each block ends in the text, what it printed, and the pictures that it wrote.
    """
    (folder / "examples").symlink_to(ROOT / "examples")
    names: dict[str, Any] = {"__name__": "__main__"}
    before: dict[Path, int] = {}
    for block in FENCE.finditer(text):
        language, code = block.groups()
        printed = io.StringIO()
        with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
            if language == "python":
                compiled = compile(code, "<page>", "exec")
                if not NOT_RUN.match(code):
                    exec(compiled, names)
            for line in commands(code) if language == "console" else ():
                call(line)
        pictures = *sorted(folder.glob("*.png")), *sorted(folder.glob("*/*.png"))
        times = {path: path.stat().st_mtime_ns for path in pictures}
        yield block.end(), printed.getvalue(), [p for p in times if times[p] != before.get(p)]
        before = times


def commands(block: str) -> Iterator[str]:
    """Yield the program's own commands; those that install or measure are not run."""
    for line in re.sub(r"\\\n>?", " ", block).splitlines():
        if line.startswith("$ nlosoptics ") and not NOT_RUN.search(line):
            yield line.removeprefix("$ nlosoptics ")


def call(line: str) -> None:
    """Run one command; anything but success is an error."""
    try:
        main(shlex.split(line, comments=True))
    except SystemExit as end:
        if end.code:
            raise RuntimeError(f"nlosoptics {line} ended with {end.code}") from end


def directive(name: str, argument: str, *lines: str) -> str:
    """Return a block of Markdown that Sphinx draws as an output."""
    return "\n".join(("\n", f"{BLOCK}{{{name}}} {argument}", ":class: output", *lines, BLOCK))


def show(app: Sphinx, page: str, source: list[str]) -> None:
    """Put outputs into a page before it is parsed."""
    if not page.startswith(SHOWN) or page.endswith("index"):
        return
    text, parts, start = source[0], [], 0
    target = Path(app.srcdir) / "_generated" / "outputs"
    target.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        for end, printed, pictures in blocks(text, Path(work)):
            parts.append(text[start:end])
            start = end
            if printed.strip():
                parts.append(directive("code-block", "text", printed.rstrip().lstrip("\n")))
            for picture in pictures:
                with Image.open(picture) as image:
                    if image.mode not in {"RGB", "RGBA"}:  # counts of a camera, not a drawing
                        continue
                name = f"{page.replace('/', '-')}-{len(parts)}-{picture.name}"
                shutil.copy(picture, target / name)
                shown = f":alt: {picture.name}, written by these lines"
                parts.append(directive("image", f"/_generated/outputs/{name}", shown))
    source[0] = "".join(parts) + text[start:]


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect `show`, which runs before the parser."""
    app.connect("source-read", show)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
