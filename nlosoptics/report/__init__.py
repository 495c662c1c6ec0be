"""One HTML page about a run: all in one file, read from the run's folder.

`page` takes a folder that ``nlosoptics run``, ``reconstruct`` or ``phasor`` wrote and shows what is
there. Text of files is escaped in one place (`_html.tag`), and the page's own policy forbids
every request.
"""

from .folders import Folder
from .pages import page

__all__ = ["Folder", "page"]
