"""The rules of ARCHITECTURE.md, checked on the syntax trees of the package."""

from __future__ import annotations

import ast
import functools
import importlib.util
import json
import re
from operator import gt, le
from pathlib import Path

import pytest

from nlosoptics import errors

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "nlosoptics"


def _house():
    """The script that reads and draws the imports; ARCHITECTURE.md shows its drawing."""
    spec = importlib.util.spec_from_file_location("house", ROOT / "docs" / "house.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


house = _house()


@functools.cache
def arrows() -> dict[tuple[str, str], list[str]]:
    """The package's imports, file by file."""
    return house.arrows(house.read())


@functools.cache
def prices() -> dict[str, tuple[int, int, int]]:
    """Lines of code, public names and constants of each room."""
    return house.prices()


#: The only places that may import a heavy or optional package, relative to the package.
ONLY_IN = {
    "torch": ("inverse/",),
    "safetensors": ("inverse/",),
    "matplotlib": ("views/",),
    "pyvista": ("views/",),
    "vtk": ("views/",),
    "optuna": ("study/search/with_optuna.py",),
    "dask": ("study/",),
    "distributed": ("study/",),
    "zarr": ("study/",),
    "xarray": ("study/", "_xarray.py"),
    "typer": ("cli/",),
    "rich": ("cli/",),
}

#: Packages that a package on a higher floor must not import all the same.
APART = {
    "transient": {"psf", "imaging", "limits", "inverse"},
    "psf": {"transient"},
    "imaging": {"transient"},
    "limits": {"transient"},
    "inverse": {"transient"},
    "views": {"report", "cli"},
}

COMPILERS = {"njit", "jit", "vectorize", "guvectorize", "cfunc", "prange"}


def violations(path: str, source: str) -> list[str]:
    """What one file breaks; ``path`` is relative to the package."""
    sources = dict.fromkeys(house.files(), "") | {path: source}
    return house.upward(house.arrows(sources)) + misplaced(path, source)


def misplaced(path: str, source: str) -> list[str]:
    """Imports of one file that belong elsewhere, and compiled functions outside their files."""
    found, tree, here = [], ast.parse(source), path.split("/")[0]
    for line, name in house.imported(tree, path):
        first, *rest = name.split(".")
        if first == "nlosoptics":
            # `__version__` is a string of the root, not a part
            if rest in ([], ["*"]):
                found.append(f"{path}:{line} must not import the root of the package")
            elif rest[0] in APART.get(here, ()):
                found.append(f"{path}:{line} {here} must not import {rest[0]}")
        elif first in ONLY_IN and not path.startswith(ONLY_IN[first]):
            found.append(f"{path}:{line} {first} is imported outside {', '.join(ONLY_IN[first])}")
    if path != "_html.py":  # which asks for the registry of notebook pictures by its name
        for node in ast.walk(tree):
            name = getattr(node, "id", None) or getattr(node, "attr", None)
            if name in ("import_module", "__import__"):
                found.append(f"{path}:{node.lineno} {name} hides an import from these checks")
    if not (path.startswith("kernels/") or path.endswith("_kernels.py")):
        for node in ast.walk(tree):
            name = getattr(node, "id", None) or getattr(node, "attr", None)
            if name in COMPILERS:
                found.append(f"{path}:{node.lineno} {name} outside kernels/ and *_kernels.py")
    return found


def test_files_keep_the_rules() -> None:
    """Imports point down, heavy packages stay in their room, kernels in their files."""
    sources = house.read()
    assert house.upward(arrows()) == []
    assert [fault for path, text in sources.items() for fault in misplaced(path, text)] == []


def test_no_circle_among_rooms_or_files() -> None:
    """Neither rooms nor files import one another in a ring, lazily or for types included."""
    found = arrows()
    assert house.circles(house.between_rooms(found)) == []
    assert house.circles(house.between_files(found)) == []


def test_psf_is_at_most_seven_layers_of_rooms() -> None:
    """The longest chain of imports among the rooms of psf, which once was 23 files."""
    assert house.layers(house.between_rooms(arrows()), "psf") <= 7


def test_no_folder_holds_more_than_twenty_files() -> None:
    """A folder that grows beyond that has rooms of its own to find."""
    assert house.crowded() == {}


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("psf/walls/scene_psf.py", "from ...imaging import form_image"),
        ("psf/transform/fft.py", "from ..rough.mean import mean_point_spread"),
        ("psf/wave/fits.py", "def f():\n    from ..transform import fft"),
        ("psf/transform/fft.py", "from .. import point_spread"),
        ("psf/transform/fft.py", "def f():\n    from nlosoptics import inverse"),
        ("scene/walls/analytic.py", "from ... import raytrace"),
        ("scene/parts/laser.py", "from ..walls import analytic"),
        ("scene/file/scene_file.py", "from ..scene import Scene"),
        ("scene/walls/analytic.py", "import nlosoptics"),
        ("errors.py", "from .scene import Scene"),
        ("kernels/random.py", "from .._checks import positive"),
        ("runs/plan.py", "from ..views import image"),
        ("runs/plan.py", "def _repr_html_(self):\n    from ..views import image"),
        ("runs/simulate.py", "from ..cli import shell"),
        ("scene/scene.py", "import importlib\nimportlib.import_module('nlosoptics.views')"),
        ("imaging/images.py", "import nlosoptics.transient.rendering.render"),
        ("imaging/images.py", "def f():\n    import torch.fft"),
        ("transient/rendering/render.py", "import torch"),
        ("cli/shell.py", "from matplotlib.figure import Figure"),
        ("report/pages.py", "import xarray as xr"),
        ("runs/plan.py", "from rich.table import Table"),
        ("psf/pupil/exit_pupil.py", "from numba import njit\n@njit\ndef f(): pass"),
        ("psf/pupil/exit_pupil.py", "import numba\nf = numba.njit(lambda: 0)"),
    ],
)
def test_broken_rule_is_seen(path: str, source: str) -> None:
    """The checker itself: each of these must be reported."""
    assert len(violations(path, source)) == 1


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("psf/transform/fft.py", "from ...errors import SamplingError\nfrom ..window import grids"),
        ("inverse/known/wiener.py", "import torch\nfrom ...imaging import ForwardModel"),
        ("raytrace/light/trace.py", "from ...kernels.heights import surface"),
        ("kernels/heights.py", "from numba import njit\n@njit\ndef f(): pass"),
        ("cli/forward.py", "from .. import __version__, views\nfrom ..runs.plan import plan"),
        ("scene/scene.py", "from .file import read_scene"),
    ],
)
def test_kept_rule_is_passed(path: str, source: str) -> None:
    """The checker itself: none of these may be reported."""
    assert violations(path, source) == []


def test_circle_is_seen() -> None:
    """The search for circles itself: a ring of two rooms that no single file closes."""
    sources = {
        "psf/wave/a.py": "from ..pupil import b",
        "psf/pupil/b.py": "",
        "psf/pupil/c.py": "from ..wave import d",
        "psf/wave/d.py": "",
    }
    found = house.arrows(sources | {f"psf/{room}/__init__.py": "" for room in ("wave", "pupil")})
    assert house.circles(house.between_rooms(found)) == [["psf/pupil", "psf/wave"]]
    assert house.circles(house.between_files(found)) == []


def test_every_room_has_its_place() -> None:
    """A new folder must be given its floor in the drawing's order."""
    assert {house.room_of(path) for path in house.files()} <= set(house.order())


def test_no_file_is_too_long() -> None:
    """A file of more than 600 lines is to be split where a seam shows."""
    lengths = {p: len(p.read_text().splitlines()) for p in PACKAGE.rglob("*.py")}
    assert {p.name: n for p, n in lengths.items() if n > 600} == {}


def remedies_lacking(source: str) -> list[str]:
    """The texts of deliberate errors that name no remedy, or neither a value nor a name."""
    classes = {name for name, kind in vars(errors).items() if isinstance(kind, type)}
    lacking = []
    for node in ast.walk(ast.parse(source)):
        call = node.exc if isinstance(node, ast.Raise) else None
        if not (isinstance(call, ast.Call) and ast.unparse(call.func).split(".")[-1] in classes):
            continue
        text = next(iter(call.args), None)
        if not isinstance(text, ast.JoinedStr | ast.Constant):
            continue  # made by a function
        words = "".join(
            part.value
            for part in getattr(text, "values", [text])  # without the formats of values
            if isinstance(part, ast.Constant) and isinstance(part.value, str)
        )
        is_wrapped = words.endswith(": ") or not re.search("[a-z]{3,}.*[a-z]{3,}", words)
        if not (is_wrapped or re.search(r"; |\b(use|give|must)\b", words)):
            lacking.append(words)
    return lacking


@pytest.mark.thorough
def test_errors_name_a_remedy() -> None:
    """Each deliberate error says what its reader can do."""
    lacking = {path: remedies_lacking(text) for path, text in house.read().items()}
    assert {path: words for path, words in lacking.items() if words} == {}


def test_error_without_remedy_is_seen() -> None:
    """The checker itself."""
    assert remedies_lacking("raise SceneError(f'size = {size} is too large')")
    assert not remedies_lacking("raise SceneError(f'size = {size}, limit 3; give less')")


#: Machinery that patches other libraries, forks, or runs text as code.
FORBIDDEN = (
    "eval(",
    "os.fork",
    "renameat2",
    "_chain_init_hook",
    "get_call_template",
    "_update_ticks",
)


def patches(source: str) -> list[str]:
    """Forbidden words of a file, and the private attributes of other modules that it sets."""
    out = [word for word in FORBIDDEN if re.search(r"(?<!\w)" + re.escape(word), source)]
    tree = ast.parse(source)
    modules = {
        (alias.asname or alias.name).split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    for node in ast.walk(tree):
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            if isinstance(target, ast.Attribute) and target.attr.startswith("_"):
                name = ast.unparse(target)
                out += [name] if name.split(".")[0] in modules else []
    return out


@pytest.mark.thorough
def test_no_other_library_is_patched() -> None:
    """No machinery that forks, runs texts as code, or hangs on others' private names."""
    faults = {path: patches(text) for path, text in house.read().items()}
    assert {path: names for path, names in faults.items() if names} == {}
    assert patches("import numba\nnumba.core._cache = eval('1')") == ["eval(", "numba.core._cache"]


def test_no_room_grows() -> None:
    """The price of each room stays within its ceiling, which is lowered when the room shrinks."""
    ceilings = json.loads((ROOT / "docs" / "ceilings.json").read_text())
    assert prices().keys() == ceilings.keys()
    assert {r: p for r, p in prices().items() if any(map(gt, p, ceilings[r]))} == {}


#: What the library may weigh without the capabilities below, and what each of them may add.
#: Lines of package, tests and benchmarks; code lines, public names and constants of the package.
WEIGHTS = {
    "the library after its pruning": (70_000, 45_000, 6_500, 42_000, 200, 650),
    "bursts": (1_000, 400, 70, 600, 2, 5),
    "pictures from shadows": (3_000, 800, 550, 1_800, 5, 20),
    "captures that read by themselves": (600, 250, 0, 350, 3, 5),
    "the way in: photographs, analysis, nouns at the top": (1_500, 500, 0, 1_500, 20, 10),
    "checks on the user's machine": (500, 80, 130, 330, 3, 5),
    "status on pictures of users, ablation of the search": (0, 0, 335, 0, 0, 0),
    "images from few photons": (450, 100, 80, 260, 1, 5),
}


def test_the_whole_stays_small() -> None:
    """The library, and what comes with it, can be read in days."""
    lines = [
        sum(p.read_text().count("\n") for p in ROOT.glob(f"{folder}/**/*.py"))
        for folder in ("nlosoptics", "tests", "benchmarks")
    ]
    weights = *lines, *map(sum, zip(*prices().values(), strict=True))
    most = map(sum, zip(*WEIGHTS.values(), strict=True))
    assert all(map(le, weights, most)), weights


def test_tests_mirror_the_rooms() -> None:
    """A folder of tests has the name of a room; what spans rooms lies one folder up."""
    folders = {p.parent.relative_to(ROOT / "tests").as_posix() for p in ROOT.glob("tests/**/*.py")}
    assert folders - set(house.order()) <= {".", "site", "fuzz"}


def test_tests_are_no_package() -> None:
    """With ``--import-mode=importlib`` an ``__init__.py`` would hide equal file names."""
    assert list((ROOT / "tests").rglob("__init__.py")) == []
