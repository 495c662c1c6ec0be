"""Command line: parses arguments, calls the library and writes the results.

Exit codes: 0 done, 1 failed, 2 bad input. An error is printed as one line on stderr; ``--debug``
adds the traceback. A failed run leaves no partial output folder. SIGTERM acts like Ctrl-C.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from typing import Annotated

import typer

from .. import __version__
from . import (  # imported to register their commands, in the order of the help
    captures,  # noqa: F401
    forward,  # noqa: F401
    materials,  # noqa: F401
    pictures,  # noqa: F401
    reconstructions,  # noqa: F401
    reports,  # noqa: F401
    studies,  # noqa: F401
    traces,  # noqa: F401
    warmup,  # noqa: F401
)
from .shell import DONE, app, interrupts_kept, tell

__all__ = ["main"]

INTERRUPTED = 130  # what typer returns for Ctrl-C outside of `errors_told`


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line program ``nlosoptics`` and end the process.

    The exit code is 0 (done), 1 (failed) or 2 (bad input).

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after the program's name, for example ``["plan", "scene.toml"]``; by default those
        of this process.

    See Also
    --------
    nlosoptics.plan : Predict stages, time and error.
    nlosoptics.simulate : Run a scene's plan.
    """
    # Collections would search what modules and numba's compiler keep: a seventh of a first run's
    # processor time.
    gc.set_threshold(200_000)
    # pydantic would read the metadata of all installed packages for extensions of its own.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    with interrupts_kept():
        try:
            words = tuple(sys.argv[1:] if arguments is None else arguments)
            program = _program(words)
            code = program(args=words, prog_name="nlosoptics", standalone_mode=False, obj=words)
            if code == INTERRUPTED:  # while the words were read
                code = tell(KeyboardInterrupt())
        except (Exception, KeyboardInterrupt) as error:
            code = tell(error)
    if arguments is None:
        _end(code or DONE)
    sys.exit(code or DONE)


def _program(words: Sequence[str]) -> typer.Typer:
    """Return the program with the command that the words call alone, or else with all commands.

    typer evaluates the annotations of all commands that a program has, whichever is called.
    """
    chosen = copy(app)
    called = [command for command in app.registered_commands if command.name in words[:1]]
    chosen.registered_commands = called or app.registered_commands
    return chosen


def _end(code: int) -> None:
    """End this process without freeing all modules one by one, which takes a tenth of a second."""
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # none, or closed by its reader
            stream.flush()
    os._exit(code)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"nlosoptics {__version__}")
        raise typer.Exit(DONE)


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass
