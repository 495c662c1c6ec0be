"""Figures of a run, drawn by two other processes where the system can fork.

They load matplotlib and draw the scene while the run computes. One then draws the overview, the
other all single figures. This process draws whatever they do not report.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ..runs.results import Result
    from ..scene import Scene

#: Function that draws a figure; called only where it is drawn.
Figures = dict[str, Callable[[], Any]]
#: Longest time for one figure, s. A process that takes longer is ended.
LONGEST: Final = 30.0
#: Time within which processes end after their last figure, s.
ENDING: Final = 5.0


@contextmanager
def painters(scene: Scene) -> Iterator[Sequence[Connection]]:
    """Start two processes that draw figures; end them if the block fails.

    Parameters
    ----------
    scene : Scene
        Scene of the run.

    Yields
    ------
    sequence of Connection
        Connections to the processes for `write_figures`; none where the system cannot fork, has one
        core, or lacks matplotlib.
    """
    if (
        not sys.platform.startswith("linux")
        or (os.cpu_count() or 1) < 2
        or importlib.util.find_spec("matplotlib") is None
    ):
        yield ()
        return
    context = multiprocessing.get_context("fork")
    pipes = [context.Pipe() for _ in range(2)]
    first = context.Process(target=_first, args=(scene, pipes))
    with warnings.catch_warnings():
        # The processes only draw: they take no lock that another thread may hold.
        warnings.simplefilter("ignore", DeprecationWarning)
        first.start()
    group = first.pid or 0
    _group(group)
    for _, theirs in pipes:
        theirs.close()
    ours = [end for end, _ in pipes]
    try:
        yield ours
        first.join(ENDING)
    finally:
        for end in ours:
            end.close()
        with suppress(OSError):
            os.killpg(group, signal.SIGKILL)
        first.join()


def _ends_with_parent() -> None:
    """Let the system end this process when its parent is killed, so that it writes no more."""
    import ctypes

    on_death = 1  # PR_SET_PDEATHSIG of linux/prctl.h
    ctypes.CDLL(None).prctl(on_death, signal.SIGKILL)


def _group(leader: int) -> None:
    """Make a process the leader of a group, in which both processes are ended at once."""
    with suppress(OSError):
        os.setpgid(leader, leader)


def write_figures(result: Result, folder: Path, connections: Sequence[Connection] = ()) -> None:
    """Write an overview picture and one PNG for each part of the result.

    Parameters
    ----------
    result : Result
        Result of the run.
    folder : Path
        Folder that receives the files.
    connections : sequence of Connection
        From `painters`; without any, this process draws all figures.
    """
    missing = {**_of_scene(result.scene), **_of_run(result), **_of_parts(result)}
    if connections:
        # A file, since a process that hangs would never empty a pipe. It is next to the folder, in
        # the temporary folder of `whole_folder`, which is removed even if this process is killed.
        with suppress(OSError), tempfile.NamedTemporaryFile(dir=folder.parent) as held:
            pickle.dump((result, folder), held, protocol=pickle.HIGHEST_PROTOCOL)
            held.flush()
            for end in connections:
                with suppress(OSError):
                    end.send(held.name)
            for end in connections:
                with suppress(EOFError, OSError):
                    while end.poll(LONGEST) and (name := end.recv()) is not None:
                        del missing[name]
    for name, draw in missing.items():
        _write(folder, name, _drawn(draw))


def _of_scene(scene: Scene) -> Figures:
    """Return the figures that need no result."""
    from .. import views

    return {
        "scene": lambda: views.scene_sketch(scene),
        "scene_narrow": lambda: views.scene_sketch(scene, stacked=True),
    }


def _of_run(result: Result) -> Figures:
    """Return the figure of the whole run."""
    from .. import views

    return {"overview": lambda: views.overview(result)}


def _of_parts(result: Result) -> Figures:
    """Return the figures of single results."""
    from .. import limits, views
    from ..views.run_overview import ground_truth

    scale = limits.object_scale(result.scene)
    found: Figures = {
        "wavefront": lambda: views.wavefront(result.wavefront),
        "point_spread": lambda: views.point_spread(result.point_spread),
        "image": lambda: views.image(result.image, object_scale=scale),
    }
    if (field := result.pupil_field) is not None:
        found["pupil_phase"] = lambda: views.pupil_field(field)
    if (fit := result.reconstruction) is not None:
        truth, pitch = ground_truth(result), scale * result.image.pitch
        found["reconstruction"] = lambda: views.reconstruction(fit, truth, pitch=pitch)
    return found


def _drawn(draw: Callable[[], Any]) -> bytes:
    """Draw a figure; return it as a PNG file."""
    from ..views.saving import figure_file

    return figure_file(draw(), ".png")


def _write(folder: Path, name: str, content: bytes) -> None:
    (folder / f"{name}.png").write_bytes(content)


def _first(scene: Scene, pipes: list[tuple[Connection, Connection]]) -> None:
    """Load matplotlib, start the second process, draw the scene and then the single results."""
    _ends_with_parent()
    _group(0)  # also done by the parent, whichever comes first
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run itself ends its processes
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    warnings.simplefilter("ignore", DeprecationWarning)
    # While one of these processes holds the run's own ends, the other would never see them closed.
    for ours, _ in pipes:
        ours.close()
    (_, here), (_, there) = pipes
    with _silent():
        from ..views.canvas import drawing_classes

        drawing_classes()
        second = multiprocessing.get_context("fork").Process(target=_second, args=(here, there))
        second.start()
        there.close()
        _serve(here, _of_parts, {name: _drawn(draw) for name, draw in _of_scene(scene).items()})


def _second(other: Connection, own: Connection) -> None:
    """Draw the overview."""
    _ends_with_parent()
    other.close()
    with _silent():
        _serve(own, _of_run, {})


@contextmanager
def _silent() -> Iterator[None]:
    """End a process that fails without a word: the run draws its figures, and tells its errors."""
    try:
        yield
    except Exception:
        os._exit(1)


def _serve(end: Connection, figures: Callable[[Result], Figures], ready: dict[str, bytes]) -> None:
    """Wait for the result, write and report figures one by one, and then None."""
    with Path(end.recv()).open("rb") as held:
        result, folder = pickle.load(held)  # written by this run, readable by its user alone
    for name, content in ready.items():
        _write(folder, name, content)
        end.send(name)
    for name, draw in figures(result).items():
        _write(folder, name, _drawn(draw))
        end.send(name)
    end.send(None)
