"""The rules of ARCHITECTURE.md, checked on the syntax trees of the package."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "nlosoptics"

BASE = {
    "errors",
    "_checks",
    "_cost_model",
    "_html",
    "_nouns",
    "_parallel_kernels",
    "_progress",
    "_random",
    "_random_kernels",
    "_whole_files",
}
OPTICS = {"scene", "raytrace", "psf", "imaging", "limits", "inverse", "transient"}

#: What each part may import from the rest of the package; itself is understood.
MAY_IMPORT = {
    "errors": set(),
    "_checks": {"errors"},
    "_cost_model": BASE,
    "_html": {"errors"},
    "_nouns": {"errors"},
    "_parallel_kernels": set(),
    "_progress": set(),
    "_random": {"errors", "_checks", "_random_kernels"},
    "_random_kernels": set(),
    "_whole_files": {"errors"},
    "scene": BASE,
    "raytrace": BASE | {"scene"},
    "psf": BASE | {"scene", "raytrace"},
    "transient": BASE | {"scene", "raytrace"},
    "imaging": BASE | {"scene", "raytrace", "psf"},
    "limits": BASE | {"scene", "raytrace", "psf", "imaging"},
    "inverse": BASE | {"scene", "raytrace", "psf", "imaging", "limits"},
    "records": BASE | {"scene"},
    "planning": BASE | OPTICS,
    "result_files": BASE | OPTICS | {"planning", "records"},
    "results": BASE | OPTICS | {"planning", "records", "result_files"},
    "simulation": BASE | OPTICS | {"planning", "results"},
    "study": BASE | OPTICS | {"planning", "simulation"},
    "views": BASE | OPTICS | {"planning", "results", "simulation"},
    "cards": {"views"},
    "reconstructing": BASE | OPTICS | {"planning", "simulation", "records"},
    "report": BASE | OPTICS | {"planning", "simulation", "study", "views"},
    "cli": BASE
    | OPTICS
    | {
        "planning",
        "simulation",
        "results",
        "reconstructing",
        "records",
        "study",
        "views",
        "report",
    },
}

#: Looks for a module by a name that no import shows: the cards' registry, and one of its own room.
LOOKUPS = ("_html.py", "inverse/pcin.py")

#: The only places that may import a heavy or optional package, relative to the package.
ONLY_IN = {
    "torch": ("inverse/", "transient/_gpu.py"),
    "deepinv": ("inverse/",),
    "safetensors": ("inverse/",),
    "matplotlib": ("views/",),
    "pyvista": ("views/",),
    "vtk": ("views/",),
    "dask": ("study/",),
    "distributed": ("study/",),
    "zarr": ("study/",),
    "xarray": ("study/",),
    "typer": ("cli/",),
    "rich": ("cli/",),
    "astropy": ("psf/poppy_files.py",),
}

COMPILERS = {"njit", "jit", "vectorize", "guvectorize", "cfunc", "prange"}


def part(path: str) -> str:
    """First component below the package, without its suffix: ``psf/field.py`` is in psf."""
    return path.split("/")[0].removesuffix(".py")


def imported(tree: ast.AST, path: str) -> Iterator[tuple[int, str]]:
    """Absolute dotted names that a file imports, at any depth, with their lines."""
    folders = ["nlosoptics", *path.split("/")[:-1]]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = folders[: len(folders) - node.level + 1] if node.level else []
            stem = ".".join([*above, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{stem}.{alias.name}") for alias in node.names)


def violations(path: str, source: str) -> list[str]:
    """What a file breaks; ``path`` is relative to the package."""
    tree, found, here = ast.parse(source), [], part(path)
    for line, name in imported(tree, path):
        first, *rest = name.split(".")
        if first == "nlosoptics":
            there = rest[0] if rest else "__init__"
            # `__version__` is a string of the root, not a part
            if there not in MAY_IMPORT[here] | {here, "__version__"}:
                found.append(f"{path}:{line} {here} must not import {there}")
        elif first in ONLY_IN and not path.startswith(ONLY_IN[first]):
            found.append(f"{path}:{line} {first} is imported outside {', '.join(ONLY_IN[first])}")
    for node in ast.walk(tree):
        name = getattr(node, "id", None) or getattr(node, "attr", None)
        if name in ("import_module", "__import__") and path not in LOOKUPS:
            found.append(f"{path}:{node.lineno} {name} outside {', '.join(LOOKUPS)}")
    if not Path(path).name.endswith("_kernels.py"):
        for node in ast.walk(tree):
            name = getattr(node, "id", None) or getattr(node, "attr", None)
            if name in COMPILERS:
                found.append(f"{path}:{node.lineno} {name} outside _kernels.py")
    return found


def files() -> list[str]:
    """Every Python file of the package but its root, relative to the package."""
    found = sorted(p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*.py"))
    return [p for p in found if p != "__init__.py"]


@pytest.mark.parametrize("path", files())
def test_file_keeps_the_rules(path: str) -> None:
    """Imports point one way, heavy packages stay in their part, kernels in their file."""
    assert violations(path, (PACKAGE / path).read_text()) == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("psf/transforms.py", "from ..imaging import form_image"),
        ("psf/transforms.py", "def f():\n    from nlosoptics import inverse"),
        ("scene/walls.py", "from .. import raytrace"),
        ("scene/walls.py", "import nlosoptics"),
        ("errors.py", "from . import _checks"),
        ("planning.py", "from .views import image"),
        ("planning.py", "def _repr_html_(self):\n    from .views import image"),
        ("planning.py", "def _repr_html_(self):\n    from . import simulation"),
        ("scene/scene.py", "class Scene:\n    def save(self):\n        from .. import views"),
        (
            "scene/scene.py",
            "class Scene:\n    def _repr_html_(self):\n        from .. import views",
        ),
        ("scene/scene.py", "import importlib\nimportlib.import_module('nlosoptics.views')"),
        ("imaging/noise.py", "import nlosoptics.transient.render"),
        ("imaging/noise.py", "def f():\n    import torch.fft"),
        ("transient/render.py", "import torch"),
        ("cli/shell.py", "from matplotlib.figure import Figure"),
        ("report.py", "import xarray as xr"),
        ("planning.py", "from rich.table import Table"),
        ("psf/exchange.py", "def f():\n    from astropy.io import fits"),
        ("psf/pupils.py", "from numba import njit\n@njit\ndef f(): pass"),
        ("psf/pupils.py", "import numba\nf = numba.njit(lambda: 0)"),
    ],
)
def test_broken_rule_is_seen(path: str, source: str) -> None:
    """The checker itself: each of these must be reported."""
    assert len(violations(path, source)) == 1


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("psf/transforms.py", "from ..errors import SamplingError\nfrom . import _kernels"),
        ("inverse/wiener.py", "import torch\nfrom ..imaging import ForwardModel"),
        ("transient/_gpu.py", "import torch"),
        ("raytrace/_kernels.py", "from numba import njit\nfrom ..scene._kernels import surface"),
        ("cli/forward.py", "from .. import __version__, views\nfrom ..planning import plan"),
        ("cards.py", "from . import views"),
    ],
)
def test_kept_rule_is_passed(path: str, source: str) -> None:
    """The checker itself: none of these may be reported."""
    assert violations(path, source) == []


def test_every_part_has_a_rule() -> None:
    """A new subpackage or module must be given its place in the order."""
    assert {part(path) for path in files()} <= set(MAY_IMPORT)


def test_no_file_is_too_long() -> None:
    """A file of more than 600 lines is to be split where a seam shows."""
    lengths = {p: len(p.read_text().splitlines()) for p in PACKAGE.rglob("*.py")}
    assert {p.name: n for p, n in lengths.items() if n > 600} == {}


def test_tests_are_no_package() -> None:
    """With ``--import-mode=importlib`` an ``__init__.py`` would hide equal file names."""
    assert list((ROOT / "tests").rglob("__init__.py")) == []
