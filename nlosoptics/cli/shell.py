"""Parts shared by all commands: options, exit codes, one-line errors, progress, output checks."""

from __future__ import annotations

import errno
import importlib.util
import os
import re
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from .._checks import lasting, path_of
from .._whole_files import beside, check_folder
from ..errors import MissingExtraError, NlosError, SceneError

if TYPE_CHECKING:
    from ..scene import Scene

DONE, FAILED, BAD_INPUT, DOES_NOT_FIT, INTERRUPTED = 0, 1, 2, 3, 130
# typer exports no name for UsageError: old versions use click's class, new ones a copy
_UsageError: Any = typer.BadParameter.__base__


class Group(TyperGroup):
    """Group of commands that prints its help when it is called without arguments."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; without any, show the help."""
        return list(super().parse_args(ctx, args or ["--help"]))


class _Program(Group):
    """The program, whose help lists the commands in the order in which one works."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands in groups."""
        for heading, names in {
            "Simulate": "new plan run view trace",
            "Design": "analyse study",
            "Reconstruct": "feasibility reconstruct deblur",
            "Time-resolved": "transient capture image",
            "Tools": "report materials schema warmup verify",
        }.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [(f"{name:11}", self.commands[name].short_help) for name in names.split()]
                )


app = typer.Typer(
    name="nlosoptics",
    cls=_Program,
    help="Simulate what a camera sees of an object around a corner, by way of a visible wall, and "
    "reconstruct the object. A first picture: nlosoptics run corner --size 64. A scene of your "
    "own: nlosoptics new room.toml. More about a command: nlosoptics COMMAND --help.",
    rich_markup_mode=None,  # plain help: rich would take longer to load than all else
)

SceneFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCENE",
        help="Scene file (TOML) of laser, wall, object and camera, or the name of an example, such "
        "as corner. nlosoptics new FILE writes a scene file to start from.",
    ),
]
Out = Annotated[
    Path | None, typer.Option(help="Output folder; by default named after the input file.")
]
Tol = Annotated[
    float,
    typer.Option(
        help="Largest error of the point spread (image of a point) relative to its peak, 1e-12 to "
        "0.1. The error of the wall's diffuse light in the image is fixed at 1e-3."
    ),
]
Size = Annotated[
    int | None,
    typer.Option(
        help="Width of the image in pixels, for the same field of view; by default that of the "
        "scene. A small size, such as 64, makes a quick run."
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a value of the scene file: table and key (nlosoptics schema lists all), and "
        "the new value with its unit, such as wall.radius=2m. May be repeated.",
    ),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the Python traceback of an error.")]
Memory = Annotated[
    float | None,
    typer.Option(min=1e-3, help="Memory limit of the run, GiB; by default 3/4 of the free memory."),
]
MaxSeconds = Annotated[
    float, typer.Option(min=1e-3, help="Refuse a run whose predicted time exceeds this, s.")
]
Seed = Annotated[
    int,
    typer.Option(
        min=0, max=2**64 - 1, help="Seed of all random numbers; the same seed repeats the result."
    ),
]


def load(path: Path, size: int | None, changes: list[str] | None) -> Scene:
    """Load a scene file with changes, and resize its image to ``size`` pixels along x if given."""
    from ..scene import Scene
    from ..scene.file.addresses import parsed

    scene = Scene.load(file_or_example(path, "scenes"), parsed(changes or []))
    return scene if size is None else scene.resized(size)


def file_or_example(path: Path, kind: str) -> Path:
    """Return an input file, or the example of this name if there is no such file."""
    from ..scene.examples import example_file

    bare = path.name == str(path) and not path.suffix and not path_of("file", path).is_file()
    return example_file(path.name, kind) if bare else path


def in_bytes(memory: float | None) -> float | None:
    """Convert GiB to bytes."""
    return None if memory is None else memory * 2**30


def require(package: str, extra: str) -> None:
    """Raise `MissingExtraError` if a package is not installed, before any work is done."""
    if importlib.util.find_spec(package) is None:
        raise MissingExtraError(
            f"{package} is not installed; run pip install 'nlosoptics[{extra}]'"
        )


def can_draw() -> bool:
    """Return whether matplotlib is installed; if not, say that no pictures are written."""
    try:
        require("matplotlib", "views")
    except MissingExtraError as error:
        typer.echo(f"nlosoptics: no pictures are written, because {error}", err=True)
        return False
    return True


@contextmanager
def errors_told(debug: bool) -> Iterator[None]:
    """Convert an exception to one line on stderr and an exit code."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        raise SystemExit(tell(error)) from None


def tell(error: BaseException) -> int:
    """Print an error as one line on stderr; return its exit code."""
    code = BAD_INPUT
    if isinstance(error, typer.Exit):
        return int(error.exit_code)
    if isinstance(error, BrokenPipeError):  # the reader of the output has ended, such as head
        return FAILED
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        code, message = INTERRUPTED, "interrupted; no partial result was written"
    elif isinstance(error, _UsageError):
        message = error.format_message().rstrip(".").replace("Value error, ", "")
        if not re.search(r"; |\?$", message):  # without a remedy of its own
            context = getattr(error, "ctx", None)
            message += f"; {context.command_path if context else 'nlosoptics'} --help shows how"
    elif isinstance(error, NlosError):
        message = str(error)
        code = FAILED if isinstance(error, MissingExtraError) else BAD_INPUT
    elif isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        message = f"{error.filename} is too long for a path ({error.strerror}); give another path"
    else:
        code, message = FAILED, f"{type(error).__name__}: {error}; --debug shows where"
    line = " ".join(message.split())
    if len(line) > 800:  # of a very long argument; the remedy at the end stays
        line = f"{line[:400]} ... {line[-400:]}"
    typer.echo(f"nlosoptics: {line}", err=True)
    return code


def typed(context: typer.Context) -> str:
    """Return the command line as typed, for the record of a run."""
    return shlex.join(["nlosoptics", *(context.obj or ())])


def numbers(option: str, text: str | None) -> tuple[float, ...]:
    """Parse a comma-separated list of numbers; an empty text gives an empty tuple."""
    try:
        return tuple(float(part) for part in (text or "").split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is not a list of numbers; give for example '0, 0.5'", param_hint=option
        ) from None


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells if Ctrl-C was pressed; a second Ctrl-C interrupts at once.

    SIGTERM counts like Ctrl-C.
    """
    asked = False

    def ask(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    kinds = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(kind, ask) for kind in kinds]
    try:
        yield lambda: asked
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)


def print_table(rows: Iterable[tuple[str, str]]) -> None:
    """Print quantities and their values."""
    rows = [("quantity", "value"), *rows]
    wide = max(len(quantity) for quantity, _ in rows)
    lines = [f"  {quantity:{wide}}   {value}" for quantity, value in rows]
    typer.echo("\n".join(["", lines[0], "-" * max(map(len, lines)), *lines[1:], ""]))


def stage_rows(report: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the run time of each stage of a record."""
    for stage, seconds in report["seconds"].items():
        yield f"  {stage}", lasting(seconds)


@contextmanager
def progress_bar(width: int = 17) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar with the current stage on stderr, unless stderr is not a terminal."""
    if not sys.stderr.isatty():  # and rich need not be loaded
        yield lambda stage, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn(f"{{task.description:{width}}}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def check_file(path: Path, *suffixes: str, option: str = "--out") -> None:
    """Raise `typer.BadParameter` if the output file has another suffix or could not be written."""
    target = Path(os.path.realpath(path_of("path", path)))
    parent = target.parent
    for wrong, what in (
        (
            suffixes and path.suffix.lower() not in suffixes,
            f"does not end in {' or '.join(suffixes)}; give a name that does",
        ),
        (path.is_dir(), "is a folder; name a file"),
        (not parent.is_dir(), f"is in {parent}, which is no folder; create it first"),
        (not os.access(parent, os.W_OK), f"is in {parent}, which cannot be written; use another"),
    ):
        if wrong:
            raise typer.BadParameter(f"{path} {what}", param_hint=option)
    try:  # a file system such as /proc denies what the permissions allow
        with beside(target):
            pass
    except OSError as error:
        raise typer.BadParameter(
            f"{path} is in {parent}, which takes no file ({error.strerror}); use another",
            param_hint=option,
        ) from None


def check_target(folder: Path) -> None:
    """Raise `typer.BadParameter` for an output folder that is not writable or has foreign files."""
    try:
        check_folder(folder)
    except SceneError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from None
