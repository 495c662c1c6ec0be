"""What `import nlosoptics` brings, and that everything public is documented."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import importlib.metadata
import inspect
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import nlosoptics

ROOT = Path(__file__).parents[1]
STUB = ROOT / "nlosoptics" / "__init__.pyi"
#: Packages with a face; the command line is a program, `kernels` and `runs` are met through others.
SUBPACKAGES = sorted(
    {p.parent.name for p in (ROOT / "nlosoptics").glob("*/__init__.py")} - {"kernels", "runs"}
)

HEAVY = {
    "astropy",
    "dask",
    "ducc0",
    "matplotlib",
    "numba",
    "numpy",
    "optuna",
    "pydantic",
    "pyvista",
    "rich",
    "scipy",
    "torch",
    "trimesh",
    "typer",
    "xarray",
    "zarr",
}


def loaded_by(code: str) -> set[str]:
    """Top-level packages in memory after ``code`` ran in a fresh interpreter."""
    code += "\nimport json, sys\nprint(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    # EAGER_IMPORT, which CI sets to find broken imports, would undo what is tested here
    program = f"import os; os.environ.pop('EAGER_IMPORT', None)\n{code}"
    answer = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(json.loads(answer.stdout))


def test_import_is_light() -> None:
    """A bare import loads no numerical package at all."""
    assert loaded_by("import nlosoptics") & HEAVY == set()


@pytest.mark.parametrize(
    ("subpackage", "allowed"),
    [
        ("scene", {"numpy"}),
        ("raytrace", {"numpy"}),
        ("psf", {"numpy", "scipy", "ducc0"}),
        ("imaging", {"numpy", "scipy", "ducc0"}),
        ("views", {"numpy"}),
        ("limits", {"numpy", "scipy", "ducc0"}),
        ("transient", {"numpy"}),
        ("study", set()),
        ("runs.plan", {"numpy", "scipy", "ducc0"}),
        ("report", {"numpy", "scipy", "ducc0", "pydantic"}),
    ],
)
def test_subpackage_import_is_light(subpackage: str, allowed: set[str]) -> None:
    """Only `inverse` may load torch on import, and only a picture loads matplotlib."""
    assert loaded_by(f"import nlosoptics.{subpackage}") & HEAVY <= allowed


def test_version_is_told_once() -> None:
    """Package, metadata, change log and citation name the same version."""
    version = nlosoptics.__version__
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    try:
        assert importlib.metadata.version("nlosoptics") == version
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("nlosoptics is on the path but not installed, so it has no metadata")


def stub_names() -> set[str]:
    """Names that the root's stub promises."""
    tree = ast.parse(STUB.read_text())
    return {a.asname or a.name for n in tree.body if isinstance(n, ast.ImportFrom) for a in n.names}


def test_stub_matches_package() -> None:
    """Each promised name resolves, and each subpackage is promised."""
    names = stub_names()
    assert set(nlosoptics.__all__) == names
    # the command line is a program: scripts name it, `import nlosoptics` does not
    assert set(SUBPACKAGES) - {"cli"} <= names
    for name in names:
        assert getattr(nlosoptics, name) is not None


def public_objects() -> list[Any]:
    """(label, object) for each name in a subpackage's ``__all__`` and for the root's own."""
    found = []
    for subpackage in SUBPACKAGES:
        module = importlib.import_module(f"nlosoptics.{subpackage}")
        for name in module.__all__:
            found.append(pytest.param(getattr(module, name), id=f"{subpackage}.{name}"))
    for name in sorted(stub_names() - set(SUBPACKAGES)):
        found.append(pytest.param(getattr(nlosoptics, name), id=name))
    return found


def missing_parameters(documented: str, parameters: list[str]) -> list[str]:
    """Parameters that no ``name :`` or ``name, other :`` line nor the summary describes."""
    if reference := re.search(r"Parameters are those of `(\w+)`", documented):
        documented += inspect.getdoc(getattr(nlosoptics.scene, reference[1])) or ""
    described = set(re.findall(r"``(\w+)``", documented.split("\n\n")[0]))
    for line in documented.splitlines():
        if match := re.match(r"^([\w*][\w*, ]*?)(?: : .*)?$", line):
            described.update(name.strip(" *") for name in match[1].split(","))
    return [name for name in parameters if name not in described]


@pytest.mark.parametrize("thing", public_objects())
def test_public_name_has_numpydoc(thing: Any) -> None:
    """A summary line and every parameter."""
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return  # constants and type aliases are described where they are defined
    text = inspect.getdoc(thing) or ""
    summary = text.split("\n\n")[0]
    assert summary.rstrip().endswith((".", ":"))
    parameters = list(inspect.signature(thing).parameters)
    if inspect.isclass(thing):
        # a dataclass passes on the fields of its bases, an error its message
        text = "\n".join(inspect.cleandoc(base.__doc__ or "") for base in thing.__mro__[:-1])
        if issubclass(thing, Exception) or not dataclasses.is_dataclass(thing):
            return
    assert missing_parameters(text, parameters) == []


def related(text: str) -> list[str]:
    """Names in the section See Also of a docstring."""
    section = re.search(r"^See Also\n-+\n((?:.+\n?)+)", text, re.MULTILINE)
    lines = section[1].splitlines() if section else []
    heads = [line.split(" : ")[0] for line in lines if not line.startswith(" ")]
    return [name for head in heads for name in head.split(", ")]


@pytest.mark.parametrize("thing", public_objects())
def test_public_name_points_to_related_ones(thing: Any) -> None:
    """Section See Also with names of other public objects."""
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return
    # a bare name is in the same package; `runs` is met through the root
    home = thing.__module__.split(".")[1]
    names = related(inspect.cleandoc(thing.__doc__ or ""))
    assert names
    for name in names:
        full = name if name.startswith("nlosoptics.") else f"nlosoptics.{home}.{name}"
        parts = full.replace("nlosoptics.runs.", "nlosoptics.").split(".")[1:]
        found: Any = nlosoptics
        for part in parts:
            assert not part.startswith("_")
            found = getattr(found, part)
        assert found is not thing


def test_completion_shows_public_names_only() -> None:
    rooms = [getattr(nlosoptics, name) for name in SUBPACKAGES if name != "cli"]
    for module in (nlosoptics.errors, nlosoptics.reconstructing, *rooms):
        shown = {name for name in dir(module) if not name.startswith("_")}
        assert shown == set(module.__all__), module.__name__


def test_the_logger_tells_the_seconds_of_each_stage(flat_scene, caplog) -> None:
    with caplog.at_level("DEBUG", logger="nlosoptics"):
        nlosoptics.simulate(flat_scene, tol=1e-2)
    told = [re.sub(r"\d+\.\d\d", "0", record.getMessage()) for record in caplog.records]
    stages = ("exit pupil", "wave aberration", "point spread", "image")
    assert told == [f"{name}: 0 s" for name in stages]


def test_conda_recipe_asks_what_pip_asks() -> None:
    """Version and lowest versions of the packages are those of ``pyproject.toml``."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = project["dependencies"], extras["views"] + extras["inverse"]
    names = {"torch": "pytorch", "matplotlib": "matplotlib-base"}  # on conda-forge
    recipe = (ROOT / "conda" / "recipe.yaml").read_text()
    _, run, constraints = re.split(r"  run(?:_constraints)?:.*\n", recipe)
    for section, packages in zip((run, constraints), needed, strict=True):
        asked = dict(re.findall(r"^    - (\S+) (>=\S+)$", section, re.M))
        asked.pop("python", None)
        pairs = (re.match(r"(\w+)(>=[^;]+)", package) for package in packages)
        wanted = {names.get(pair[1], pair[1]): pair[2] for pair in pairs if pair}
        assert asked == wanted
    assert f'version: "{nlosoptics.__version__}"' in recipe
