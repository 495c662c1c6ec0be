"""HTML report of a run or a design study as a single self-contained file.

`page` shows the contents of a folder written by ``nlosoptics run``, ``reconstruct`` or ``phasor``,
and `study_page` the results of a design study. All text from files is escaped, and the page's
content security policy forbids network requests.
"""

from .folders import Folder
from .pages import page
from .studies import study_page

__all__ = ["Folder", "page", "study_page"]
