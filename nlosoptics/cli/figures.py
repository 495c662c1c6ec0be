"""Figures of a run, drawn by two other processes where the system can fork.

They load matplotlib and draw the scene while the run computes. They get the point spread with its
wave, then the result before its reconstruction, draw the rest meanwhile, and complete it when the
reconstruction is known. One draws
the overview, the other all single figures. This process draws whatever they do not report.
"""

from __future__ import annotations

import importlib.util
import os
import pickle
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

from .processes import can_help, forked

if TYPE_CHECKING:
    from ..inverse import Reconstruction
    from ..psf import ScenePointSpread
    from ..runs.results import Result
    from ..scene import Scene

#: Function that draws a figure; called only where it is drawn.
Figures = dict[str, Callable[[], Any]]
#: Longest time for one figure, s. A process that takes longer is ended.
LONGEST: Final = 30.0
#: Time within which processes end after their last figure, s.
ENDING: Final = 5.0


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
def painters(scene: Scene) -> Iterator[Painters]:
    """Start two processes that draw figures; end them if the block fails.

    Parameters
    ----------
    scene : Scene
        Scene of the run.

    Yields
    ------
    Painters
        The processes. There are none where the system cannot fork, has one core, or lacks
        matplotlib.
    """
    if not can_help() or importlib.util.find_spec("matplotlib") is None:
        yield Painters()
        return
    pipes = [Pipe() for _ in range(2)]
    with tempfile.TemporaryFile() as held:
        first = forked(_first, scene, pipes, held.fileno())
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
        Processes of `painters`, which were sent the point spread with its wave, the result, and
        then the reconstruction and the folder.
        Without them, this process draws all figures.
    """
    missing = {**_of_scene(result.scene), **_of_wave(result), **_of_image(result)}
    missing |= {**_of_fit(result), **_of_run(result)}
    for end in drawing.ends if drawing else ():
        with suppress(EOFError, OSError):
            while end.poll(LONGEST) and (name := end.recv()) is not None:
                del missing[name]
    for name, draw in missing.items():
        _write(folder, name, _drawn(draw))


def _of_scene(scene: Scene) -> Figures:
    """Return the figure that needs no result."""
    from .. import views

    return {"scene": lambda: views.scene_sketch(scene)}


def _of_run(result: Result) -> Figures:
    """Return the figure of the whole run."""
    from .. import views

    return {"overview": lambda: views.overview(result)}


def _of_wave(found: ScenePointSpread | Result) -> Figures:
    """Return the figures of the point spread and of the wave that forms it."""
    from .. import views

    drawn: Figures = {
        "wavefront": lambda: views.wavefront(found.wavefront),
        "point_spread": lambda: views.point_spread(found.point_spread),
    }
    if (field := found.pupil_field) is not None:
        drawn["pupil_phase"] = lambda: views.pupil_field(field)
    return drawn


def _of_image(result: Result) -> Figures:
    """Return the figure of the camera image."""
    from .. import limits, views

    scale = limits.object_scale(result.scene)
    return {"image": lambda: views.image(result.image, object_scale=scale)}


def _of_fit(result: Result) -> Figures:
    """Return the figure of the reconstruction, if there is one."""
    from .. import limits, views
    from ..views.run_overview import ground_truth

    fit = result.reconstruction
    if fit is None:
        return {}
    truth = ground_truth(result)
    pitch = limits.object_scale(result.scene) * result.image.pitch
    return {"reconstruction": lambda: views.reconstruction(fit, truth, pitch=pitch)}


def _drawn(draw: Callable[[], Any]) -> bytes:
    """Draw a figure; return it as a PNG file."""
    from ..views.saving import figure_file

    return figure_file(draw(), ".png")


def _write(folder: Path, name: str, content: bytes) -> None:
    (folder / f"{name}.png").write_bytes(content)


def _first(scene: Scene, pipes: list[tuple[Connection, Connection]], held: int) -> None:
    """Load matplotlib, start the second process, draw the scene and then the single results."""
    _group(0)  # also done by the parent, whichever comes first
    # While one of these processes holds the run's own ends, the other would never see them closed.
    for ours, _ in pipes:
        ours.close()
    (_, here), (_, there) = pipes
    _load()
    forked(_second, here, there, held)
    there.close()
    ready = {name: _drawn(draw) for name, draw in _of_scene(scene).items()}
    _serve(here, held, ready, (_of_wave, _of_image, _of_fit), place=-1)


def _second(other: Connection, own: Connection, held: int) -> None:
    """Draw the overview."""
    from ..views.run_overview import FIT

    other.close()
    _serve(own, held, {}, (lambda _: {}, lambda _: {}, _of_run), place=FIT)


def _load() -> None:
    """Import all that both processes need."""
    from .. import inverse, limits
    from ..views.canvas import load_for_drawing

    load_for_drawing()
    # the results that are received are of classes in these packages
    _ = inverse.Reconstruction, limits.object_scale


def _serve(
    end: Connection,
    held: int,
    ready: dict[str, bytes],
    kinds: tuple[Callable[[Any], Figures], ...],
    *,
    place: int,
) -> None:
    """Draw figures; write and report all of them when the run is finished, and then report None.

    Parameters
    ----------
    end : Connection
        Connection to the run.
    held : int
        File descriptor of the shared file.
    ready : dict of str to bytes
        Figures that need no result.
    kinds : three callables
        Return the figures of the point spread with its wave, those of the result that do not show
        the reconstruction, and those that do.
    place : int
        Index of the reconstruction among the axes of a late figure.
    """
    *known, late = kinds
    for figures in known:
        (result,) = _received(end, held)
        ready |= {name: _drawn(draw) for name, draw in figures(result).items()}
    complete = _awaiting(result, late, place)
    fit, folder = _received(end, held)
    for name, content in ready.items():
        _write(folder, name, content)
        end.send(name)
    for name, content in complete(fit).items():
        _write(folder, name, content)
        end.send(name)
    end.send(None)


def _received(end: Connection, held: int) -> Any:
    """Wait for the next values of `Painters.send`; they come from this run alone."""
    start, count = end.recv()
    return pickle.loads(os.pread(held, count, start))


def _awaiting(
    result: Result, late: Callable[[Result], Figures], place: int
) -> Callable[[Reconstruction | None], dict[str, bytes]]:
    """Draw what is known of late figures; return a function that completes their files."""
    from ..views.saving import awaited_file

    if not result.plan.runs("reconstruction"):
        files = {name: _drawn(draw) for name, draw in late(result).items()}
        return lambda _: files

    def drawn(name: str) -> Callable[[Reconstruction], Any]:
        return lambda fit: late(replace(result, reconstruction=fit))[name]()

    any_fit: Any = object()  # decides which figures there are
    shape = result.image.electrons.shape
    complete: dict[str, Callable[[Any], bytes]] = {
        name: awaited_file(drawn(name), place, shape)
        for name in late(replace(result, reconstruction=any_fit))
    }
    return lambda fit: {name: file(fit) for name, file in complete.items()}
