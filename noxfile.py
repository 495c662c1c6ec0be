#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.10.14"]
# ///
"""Sessions for `nox`: tests with the newest and the oldest supported packages, lint, types."""

import os
import tomllib
from pathlib import Path

import nox

nox.needs_version = ">=2025.10.14"
nox.options.default_venv_backend = "uv|virtualenv"
PROJECT = tomllib.loads(Path("pyproject.toml").read_text())["project"]
#: Quick tests that need neither torch nor matplotlib.
QUICK = [f"tests/{room}" for room in ("scene", "psf/wave", "psf/aperture", "psf/window", "kernels")]
#: What the tests of a checkout need besides the core.
TESTING = ["hypothesis", "mpmath", "pytest", "pytest-timeout", "pytest-xdist"]
#: Tests of each extra alone; what they need of another extra is skipped.
EXTRAS = {
    "views": ["tests/views"],
    "inverse": ["tests/inverse/known", "tests/inverse/published/test_unets.py"],
    "study": ["tests/study"],
}


@nox.session
def lint(session: nox.Session) -> None:
    """Run ruff."""
    session.install("-c", "constraints.txt", "ruff")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """Run mypy."""
    session.install("-c", "constraints.txt", "-e", ".[all,test]")
    session.run("mypy")


@nox.session(python=["3.11", "3.12", "3.13", "3.14"])
def tests(session: nox.Session) -> None:
    """Run the tests with the packages of `constraints.txt`."""
    session.install("-c", "constraints.txt", "-e", ".[all,test]")
    session.run("pytest", *session.posargs)


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """Build the documentation site and walk it."""
    session.install("-c", "constraints.txt", "-e", ".[all,docs]")  # pages of studies are run
    session.run("sphinx-build", "-W", "-n", "--keep-going", "docs", "out/docs")
    session.run("python", "docs/check_site.py", "out/docs")
    session.run("python", "docs/check_widths.py", "out/docs")


@nox.session(python="3.11", default=False)
def oldest(session: nox.Session) -> None:
    """Run the quick tests with the minimum version of every dependency of the core."""
    pins = [requirement.replace(">=", "==") for requirement in PROJECT["dependencies"]]
    session.install(*pins, *TESTING)
    session.install("--no-deps", "-e", ".")
    session.run("nlosoptics", "verify")
    session.run("pytest", *(session.posargs or QUICK))


@nox.session(python=["3.11", "3.12", "3.13", "3.14"], default=False)
def quick(session: nox.Session) -> None:
    """Run the quick tests with the newest version of every dependency of the core."""
    session.install("-e", ".", *TESTING)
    session.run("pytest", *(session.posargs or QUICK))


@nox.session(default=False)
@nox.parametrize("extra", list(EXTRAS))
def extras(session: nox.Session, extra: str) -> None:
    """Run the tests of one extra in an environment without the others."""
    session.install("-e", f".[{extra}]", *TESTING)
    session.run("pytest", *(session.posargs or EXTRAS[extra]))


@nox.session(default=False)
def ytal(session: nox.Session) -> None:
    """Let y-tal, in an environment of its own, read our captures and make pictures of them."""
    session.install("-c", "constraints.txt", "-e", ".[all,test]")
    peer = Path(session.create_tmp()) / "ytal"
    session.run("python", "-m", "venv", str(peer))
    python = peer / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    session.run(str(python), "-m", "pip", "install", "-q", "y-tal==0.20.0", external=True)
    where = {"NLOSOPTICS_YTAL_PYTHON": str(python.absolute())}
    session.run("pytest", "-m", "", "tests/transient/capture/test_ytal.py", env=where)


@nox.session(default=False)
def newest(session: nox.Session) -> None:
    """Run the tests with the newest version of every dependency."""
    session.install("-e", ".[all,test]")
    session.run("pytest", *session.posargs)


@nox.session(default=False)
def fuzz(session: nox.Session) -> None:
    """Damage files for every reader, 10,000 inputs each; `-- --inputs N` for another number."""
    session.install("-c", "constraints.txt", "-e", ".[all,test]")
    session.run("python", "-m", "tests.fuzz.campaign", *session.posargs)


@nox.session(default=False)
def kills(session: nox.Session) -> None:
    """Kill every writing command at 50 moments; `-- --moments N` for another number."""
    session.install("-c", "constraints.txt", "-e", ".[all,test]")
    moments = session.posargs or ["--moments", "50"]
    session.run("python", "-m", "tests.fuzz.kills", *moments)


@nox.session(default=False)
def mutants(session: nox.Session) -> None:
    """Change the source at 100 random places, and count what the tests notice."""
    session.install("-c", "constraints.txt", "-e", ".[all,test]")
    session.run("python", "-m", "tests.fuzz.mutants", *session.posargs)


if __name__ == "__main__":
    nox.main()
