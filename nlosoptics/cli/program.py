"""The program with all its commands."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated

import typer

from .. import __version__
from . import (  # imported to register their commands
    analyses,  # noqa: F401
    captures,  # noqa: F401
    forward,  # noqa: F401
    photographs,  # noqa: F401
    pictures,  # noqa: F401
    reconstructions,  # noqa: F401
    reports,  # noqa: F401
    starts,  # noqa: F401
    studies,  # noqa: F401
    traces,  # noqa: F401
    verification,  # noqa: F401
)
from .shell import DONE, INTERRUPTED, app, tell


def run(arguments: Sequence[str] | None) -> None:
    """Run a command line and end the process with its exit code; see `nlosoptics.cli.main`."""
    words = tuple(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        code = app(args=words, prog_name="nlosoptics", standalone_mode=False, obj=words)
        if code == INTERRUPTED:  # before the command began; typer says nothing
            code = tell(KeyboardInterrupt())
    except SystemExit as ended:  # of a command
        code = ended.code
    except (Exception, KeyboardInterrupt) as error:
        code = tell(error)
    if arguments is not None:
        sys.exit(code or DONE)
    # End without freeing all modules one by one, which takes 0.3 s.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # none, or closed by its reader
            stream.flush()
    os._exit(code or DONE)


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
