"""Walk a newcomer's first hour and print the seconds of each step: ``python docs/newcomer.py``.

The steps are those of the README and the docs, run as commands: installation into a new
environment, the lead scene, its report, the help of every command, the code of the doors and the
tutorial, the gallery and all doctests. A second, empty folder has only the built wheel. pip's
cache is used as it is. Ends with exit status 1 if a step failed, and prints its output.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^pip install .*&& nlosoptics run .*$", re.MULTILINE)
PAGES = ("tutorial.md", "doors/instrument.md", "doors/camera.md", "doors/transient.md")


class Walk:
    """Steps in one folder and one environment, with their seconds."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name, self.failed = folder, name, False
        environment = folder / "env"
        self._variables = os.environ | {
            "PATH": f"{environment / 'bin'}{os.pathsep}{os.environ['PATH']}",
            "VIRTUAL_ENV": str(environment),
            "NUMBA_CACHE_DIR": str(folder / "numba"),
            "MPLBACKEND": "agg",
        }
        self._variables.pop("PYTHONPATH", None)  # what is installed is tried, nothing else
        self("environment", f"{shlex.quote(sys.executable)} -m venv env")

    def __call__(self, step: str, command: str) -> str:
        """Run a shell command in the folder, print its seconds, and return its output."""
        start = time.perf_counter()
        done = subprocess.run(
            command,
            shell=True,
            executable="/bin/bash",
            cwd=self.folder,
            env=self._variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - start
        print(f"{seconds:7.1f} s  {self.name}: {step}", flush=True)
        if done.returncode:
            self.failed = True
            print(f"failed with {done.returncode}: {command}\n{done.stdout[-3000:]}", flush=True)
        return done.stdout

    def help_of_every_command(self) -> None:
        """Print the seconds of ``nlosoptics COMMAND --help`` for every command."""
        listed = self("nlosoptics --help", "COLUMNS=200 nlosoptics --help")
        commands = re.findall(r"^  ([a-z][\w-]+) ", listed.partition("Commands:")[2], re.MULTILINE)
        self.failed |= not commands
        for command in commands:
            self(f"nlosoptics {command} --help", f"nlosoptics {command} --help")

    def page(self, name: str) -> None:
        """Run a documentation page: its commands and its Python in their order, as one file."""
        code = ["import subprocess"]
        for language, block in FENCE.findall((ROOT / "docs" / name).read_text()):
            if language == "console":
                code += [
                    f"subprocess.run({line.removeprefix('$ ')!r}, shell=True, check=True)"
                    for line in re.sub(r"\\\n>?", " ", block).splitlines()
                    if line.startswith("$ nlosoptics ") and "# not run in the tests" not in line
                ]
            elif language == "python" and "# not run in the tests" not in block:
                code.append(block)
        script = self.folder / f"{Path(name).stem}.py"
        script.write_text("\n".join(code))
        self(f"docs/{name}", f"python {script.name}")


def fresh_clone(folder: Path) -> bool:
    """Walk through a new clone as the README and the docs say; return whether all went well."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
    walk = Walk(folder, "clone")
    found = COMMAND.search((ROOT / "README.md").read_text())
    assert found is not None
    install, run = found[0].split(" && ")
    walk("installation", f"{install} --quiet")
    walk("lead scene, first picture", run)
    walk("lead scene, again", f"{run} --out again")
    walk("report", "nlosoptics report corner")
    walk("room in 3-D", "nlosoptics view examples/scenes/corner.toml --out room.html")
    walk.help_of_every_command()
    for name in PAGES:
        walk.page(name)
    for script in sorted((ROOT / "examples").glob("plot_*.py")):
        walk(f"examples/{script.name}", f"python examples/{script.name}")
    walk("test tools", "pip install -q -c constraints.txt -e '.[all,test]'")
    walk("doctests", "pytest -q -n 0 --doctest-modules nlosoptics -p no:cacheprovider")
    return not walk.failed


def wheel_only(folder: Path) -> bool:
    """Walk through an empty folder with the built wheel; return whether all went well."""
    folder.mkdir()
    walk = Walk(folder, "wheel")
    root = shlex.quote(str(ROOT))
    walk("build", f"pip wheel -q --no-deps --wheel-dir . {root}")
    walk(
        "installation",
        f'pip install -q -c {root}/constraints.txt "$(echo nlosoptics-*.whl)[all]"',
    )
    walk.help_of_every_command()
    (example,) = (b for k, b in FENCE.findall((ROOT / "README.md").read_text()) if k == "python")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "readme.py").write_text(example)
    walk("the README's Python", "python readme.py")
    return not walk.failed


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    with tempfile.TemporaryDirectory() as work:
        passed = [fresh_clone(Path(work) / "clone"), wheel_only(Path(work) / "wheel")]
    sys.exit(not all(passed))
