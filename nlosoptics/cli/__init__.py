"""Command line: parses arguments, calls the library and writes the results.

Exit codes: 0 done, 1 failed, 2 bad input, 3 (with ``--strict``) the image contradicts the model,
130 interrupted by Ctrl-C or SIGTERM. An error is one line on stderr; ``--debug`` adds the
traceback. A failed run leaves no partial output folder.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line program ``nlosoptics`` and end the process with its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after the program's name, for example ``["plan", "scene.toml"]``; by default those
        of this process.

    See Also
    --------
    nlosoptics.simulate : Run a scene's plan.
    """
    try:
        from .program import run
    except KeyboardInterrupt:  # before any command began
        sys.stderr.write("nlosoptics: interrupted\n")
        os._exit(130)
    run(arguments)
