"""What every command shares: exit codes, one-line errors, progress, folders written whole."""

from __future__ import annotations

import importlib.util
import os
import shlex
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._whole_files import check_folder
from ..errors import MissingExtraError, NlosError, SceneError

if TYPE_CHECKING:
    from ..scene import Scene

DONE, FAILED, BAD_INPUT = 0, 1, 2
MOST_SEED = 2**64 - 1  # that of _random, which would load numpy
MOST_SECONDS = 900.0  # that of runs.plan, which would load numpy too

# typer has no public name for it: click's own class in old versions, its copy in new ones
_UsageError: Any = typer.BadParameter.__base__

app = typer.Typer(
    name="nlosoptics",
    help="The optics of seeing around corners: what a camera sees by way of a relay wall.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).")]
Tol = Annotated[
    float,
    typer.Option(
        help="Wanted error of the point spread, 1e-12 to 0.1 of its peak. The image's own error is "
        "fixed: 1e-3 of the wall's diffuse light."
    ),
]
Size = Annotated[
    int | None,
    typer.Option(help="Image pixels along x, over the same field; the scene's own by default."),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Memory = Annotated[
    float | None,
    typer.Option(min=1e-3, help="GiB that the run may take; 3/4 of what is free by default."),
]
MaxSeconds = Annotated[
    float, typer.Option(min=1e-3, help="Predicted seconds beyond which nothing is started.")
]
Seed = Annotated[int, typer.Option(min=0, max=MOST_SEED, help="Of all random draws.")]


def load(path: Path, size: int | None) -> Scene:
    """Scene of a file, over so many pixels if said."""
    from ..scene import Scene

    scene = Scene.load(path)
    return scene if size is None else scene.resized(size)


def in_bytes(memory: float | None) -> float | None:
    """GiB as bytes."""
    return None if memory is None else memory * 2**30


def require(package: str, extra: str, otherwise: str = "") -> None:
    """Raise `MissingExtraError` before any work that would end at a missing package."""
    if importlib.util.find_spec(package) is None:
        raise MissingExtraError(
            f"{package} is not installed; run pip install 'nlosoptics[{extra}]'{otherwise}"
        )


@contextmanager
def errors_told(debug: bool) -> Iterator[None]:
    """Turn an exception into one line on stderr and an exit code."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        raise typer.Exit(tell(error)) from None


def tell(error: BaseException) -> int:
    """Print an error as one line on stderr; return its exit code."""
    code = FAILED
    if isinstance(error, typer.Exit):
        return int(error.exit_code)
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        message = "interrupted; nothing was written"
    elif isinstance(error, _UsageError):
        message = f"{error.format_message().rstrip('.')}; nlosoptics --help shows how"
        code = BAD_INPUT
    elif isinstance(error, NlosError):
        message = str(error)
        code = FAILED if isinstance(error, MissingExtraError) else BAD_INPUT
    else:
        message = f"{type(error).__name__}: {error}; --debug shows where"
    typer.echo(f"nlosoptics: {' '.join(message.split())}", err=True)
    return code


def typed(context: typer.Context) -> str:
    """The command line as it was typed, for the records of a run."""
    return shlex.join(["nlosoptics", *(context.obj or ())])


def numbers(option: str, text: str) -> tuple[float, ...]:
    """Numbers of a list with commas; none where it is empty."""
    try:
        return tuple(float(part) for part in text.split(",")) if text.strip() else ()
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is no list of numbers, such as '0, 0.5'", param_hint=option
        ) from None


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Let the first Ctrl-C be asked for; a second one interrupts at once."""
    asked = False

    def ask(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def progress_bar(width: int = 17) -> Iterator[Callable[[str, float], None]]:
    """Bar on stderr that names the stage at work; silent where stderr is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn(f"{{task.description:{width}}}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def check_file(path: Path) -> None:
    """Refuse a file that could not be written in the end."""
    parent = path.absolute().parent
    for wrong, what in (
        (path.is_dir(), "is a folder; name a file"),
        (not parent.is_dir(), f"is in {parent}, which is no folder; create it first"),
        (not os.access(parent, os.W_OK), f"is in {parent}, which cannot be written"),
    ):
        if wrong:
            raise typer.BadParameter(f"{path} {what}", param_hint="--out")


def check_target(folder: Path) -> None:
    """Refuse an output folder that could not be written, or whose contents are not ours."""
    try:
        check_folder(folder)
    except SceneError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from None
