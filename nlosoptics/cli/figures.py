"""Figures of a run, drawn by two other processes where the system can fork.

They load matplotlib while the run loads its kernels and computes. One draws the scene, and the
point spread as soon as it is known. The other draws each part of the overview as soon as it is
known, and cuts the other figures out of it. This process draws whatever they do not report.
"""

from __future__ import annotations

import importlib.util
import os
import pickle
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

from .processes import can_help, forked

if TYPE_CHECKING:
    from ..psf import ScenePointSpread
    from ..runs.results import Result
    from ..scene import Scene
    from ..views.run_overview import AwaitedOverview
    from ..views.saving import Panels

#: Functions that draw figures and return the axes of their files; called only where they are drawn.
Figures = dict[str, Callable[[], "Panels"]]
#: Longest time for one figure, s. A process that takes longer is ended.
LONGEST: Final = 30.0
#: Time within which processes end after their last figure, s.
ENDING: Final = 5.0
#: Niceness of the process with less to draw: the run and the other one have the cores first.
NICE: Final = 5


class Painters:
    """Processes that draw, as seen by the run.

    Parameters
    ----------
    ends : sequence of Connection
        Connections to the processes; none if this process draws all figures.
    held : file
        Nameless file that the processes share. The result goes through it, since a process that
        hangs would never empty a pipe.
    """

    def __init__(self, ends: Sequence[Connection] = (), held: IO[bytes] | None = None) -> None:
        self.ends, self._held = ends, held

    def send(self, *values: Any) -> None:
        """Send values to all processes; leave them out from now on if that is impossible."""
        if self._held is None:
            return
        try:
            start = self._held.tell()
            pickle.dump(values, self._held, protocol=pickle.HIGHEST_PROTOCOL)
            self._held.flush()
        except OSError:
            self.ends = ()
        for end in self.ends:
            with suppress(OSError):
                end.send((start, self._held.tell() - start))


@contextmanager
def painters() -> Iterator[Painters]:
    """Start two processes that draw figures; end them if the block fails.

    Yields
    ------
    Painters
        The processes. There are none where the system cannot fork, has one core, or lacks
        matplotlib. They expect the scene, the point spread with its wave, the result without its
        reconstruction, and finally the reconstruction and the folder.
    """
    if not can_help() or importlib.util.find_spec("matplotlib") is None:
        yield Painters()
        return
    pipes = [Pipe() for _ in range(2)]
    with tempfile.TemporaryFile() as held:
        first = forked(_first, pipes, held.fileno())
        group = first.pid or 0
        _group(group)
        for _, theirs in pipes:
            theirs.close()
        ours = [end for end, _ in pipes]
        try:
            yield Painters(ours, held)
            first.join(ENDING)
        finally:
            for end in ours:
                end.close()
            with suppress(OSError):
                os.killpg(group, signal.SIGKILL)
            first.join()


def _group(leader: int) -> None:
    """Make a process the leader of a group, in which both processes are ended at once."""
    with suppress(OSError):
        os.setpgid(leader, leader)


def write_figures(result: Result, folder: Path, drawing: Painters | None = None) -> None:
    """Write an overview picture and one PNG for each part of the result.

    Parameters
    ----------
    result : Result
        Result of the run.
    folder : Path
        Folder that receives the files.
    drawing : Painters, optional
        Processes of `painters`, which were sent all that they expect. Without them, this process
        draws all figures.
    """
    missing = {**_of_scene(result.scene), **_of_wave(result), **_of_run(result)}
    for end in drawing.ends if drawing else ():
        with suppress(EOFError, OSError):
            while end.poll(LONGEST) and (name := end.recv()) is not None:
                del missing[name]
    for draw in missing.values():
        _write(folder, _drawn(draw))


def _of_scene(scene: Scene) -> Figures:
    """Return the figure that needs no result."""
    from .. import views

    return {"scene": lambda: {"scene": views.scene_sketch(scene)}}


def _of_wave(found: ScenePointSpread | Result) -> Figures:
    """Return the figures of the point spread and its wave that are no part of the overview."""
    from .. import views

    drawn: Figures = {
        "point_spread": lambda: {"point_spread": [views.point_spread(found.point_spread)]}
    }
    if found.pupil_field is not None:
        drawn["wavefront"] = lambda: {"wavefront": [views.wavefront(found.wavefront)]}
    return drawn


def _of_run(result: Result) -> Figures:
    """Return the figure of the whole run."""
    from ..views.run_overview import overview_panels

    return {"overview": lambda: overview_panels(result)}


def _overview(scene: Scene) -> AwaitedOverview:
    """Begin the overview."""
    from ..views.run_overview import AwaitedOverview

    return AwaitedOverview(scene)


def _drawn(draw: Callable[[], Panels]) -> dict[str, bytes]:
    """Draw a figure; return its PNG files by their names."""
    from ..views.saving import panel_files

    return panel_files(draw())


def _write(folder: Path, files: dict[str, bytes]) -> None:
    for name, content in files.items():
        (folder / f"{name}.png").write_bytes(content)


def _first(pipes: list[tuple[Connection, Connection]], held: int) -> None:
    """Load matplotlib, start the second process, draw the scene and the point spread."""
    _group(0)  # also done by the parent, whichever comes first
    # While one of these processes holds the run's own ends, the other would never see them closed.
    for ours, _ in pipes:
        ours.close()
    (_, here), (_, there) = pipes
    _load()
    forked(_second, here, there, held)
    there.close()
    os.nice(NICE)
    ready: dict[str, dict[str, bytes]] = {}
    for figures in (_of_scene, _of_wave):
        (known,) = _received(here, held)
        ready |= {name: _drawn(draw) for name, draw in figures(known).items()}
    _received(here, held)
    _, folder = _received(here, held)
    _report(here, folder, ready)


def _second(other: Connection, own: Connection, held: int) -> None:
    """Draw the overview."""
    other.close()
    overview = _overview(*_received(own, held))
    overview.draw_optics(*_received(own, held))
    complete = overview.awaiting(*_received(own, held))
    fit, folder = _received(own, held)
    _report(own, folder, {"overview": complete(fit)})


def _load() -> None:
    """Import all that both processes need."""
    from .. import inverse, limits
    from ..views.canvas import load_for_drawing

    load_for_drawing()
    # the results that are received are of classes in these packages
    _ = inverse.Reconstruction, limits.object_scale


def _received(end: Connection, held: int) -> Any:
    """Wait for the next values of `Painters.send`; they come from this run alone."""
    start, count = end.recv()
    return pickle.loads(os.pread(held, count, start))


def _report(end: Connection, folder: Path, ready: dict[str, dict[str, bytes]]) -> None:
    """Write the files of figures and report the name of each figure, then None."""
    for name, files in ready.items():
        _write(folder, files)
        end.send(name)
    end.send(None)
