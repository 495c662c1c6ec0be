"""Sessions for `nox`: tests with the newest and the oldest supported packages, lint, types."""

import tomllib
from pathlib import Path

import nox

nox.options.sessions = ["lint", "types", "tests"]
PROJECT = tomllib.loads(Path("pyproject.toml").read_text())["project"]


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


@nox.session
def docs(session: nox.Session) -> None:
    """Build the documentation site and walk it."""
    session.install("-c", "constraints.txt", "-e", ".[docs]")
    session.run("sphinx-build", "-W", "-n", "--keep-going", "docs", "out/docs")
    session.run("python", "docs/check_site.py", "out/docs")


@nox.session(python=["3.11", "3.12", "3.13"])
def tests(session: nox.Session) -> None:
    """Run the tests with the newest packages."""
    session.install("-e", ".[all,test]")
    session.run("pytest", *session.posargs)


@nox.session(python="3.11")
def oldest(session: nox.Session) -> None:
    """Run the tests with the minimum version of every dependency."""
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *extras["views"], *extras["inverse"], *extras["exchange"]]
    pins = [requirement.replace(">=", "==") for requirement in wanted]
    session.install(*pins, "-e", ".[test]")
    session.run("pytest", *session.posargs)
