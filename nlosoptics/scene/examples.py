"""Example scenes, which are part of the installed package."""

from __future__ import annotations

import difflib
from pathlib import Path

from .._checks import shown
from ..errors import SceneError
from .scene import Scene


def example(name: str) -> Scene:
    """Return an example scene by its name.

    Parameters
    ----------
    name : str
        Name of the scene's file without ``.toml``, such as "corner". A wrong name is answered by
        the list of all names.

    Returns
    -------
    Scene
        Scene with its picture and meshes. The commands, such as ``nlosoptics run corner``, know
        the same names.

    Raises
    ------
    SceneError
        If there is no example of this name.

    See Also
    --------
    Scene.load : Read a scene file of your own; ``nlosoptics new FILE`` writes one to start from.

    Examples
    --------
    >>> import nlosoptics as nlos
    >>> scene = nlos.example("corner")
    >>> scene.wall.radius, scene.camera.shape
    (2.5, (256, 256))
    """
    return Scene.load(example_file(name))


def example_file(name: str, kind: str = "scenes") -> Path:
    """Return the file of an example scene, or of an example study by ``kind="studies"``."""
    package = Path(__file__).parents[1]
    inside = package / "examples"  # of a wheel; in a clone the folder is next to the package
    folder = (inside if inside.is_dir() else package.parent / "examples") / kind
    files = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    names = [known for known in files if not known.startswith("camera_")]  # those are no scenes
    if name not in names:
        near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}? The examples are" if near else "use one of the examples"
        raise SceneError(f"{shown(name)} names no example, and no file; {hint} {', '.join(names)}")
    return files[name]
