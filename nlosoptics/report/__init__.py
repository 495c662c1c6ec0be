"""HTML report of a run or a design study as a single self-contained file.

All text from files is escaped, and the page's content security policy forbids network requests.
"""

from .pages import page

__all__ = ["page"]


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return __all__
