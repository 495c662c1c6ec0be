"""HTML report of a run or a design study as a single self-contained file.

`page` shows the contents of a folder written by ``nlosoptics run``, ``reconstruct`` or ``phasor``,
`study_page` those of a study's store.
All text from files is escaped in one place (`_html.tag`), and the page's content security policy
forbids network requests.
"""

from .folders import Folder
from .pages import page
from .studies import study_page

__all__ = ["Folder", "page", "study_page"]
