"""Studies on a dask cluster whose client, worker or scheduler is killed at random moments.

python -m tests.fuzz.clusters [--moments 12] [--first 0]

Each moment kills one of them with SIGKILL once a random number of blocks is in the store. A client
that survives must finish, or end with one line; the study is then resumed and must have the bits of
an undisturbed run. The table counts what happened; each fault is printed with its number.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .readers import ROOT

VICTIMS = ("client", "worker", "scheduler")
POINTS, LONGEST = 40, 120.0  # points of the study; longest time of a client, s
STUDY = f"""
scene = "{ROOT}/examples/scenes/letter_concave.toml"
figures = ["own_figures:slow", "own_figures:drawn"]
[axes]
"laser.power" = {{ from = "1 mW", to = "9 mW", count = {POINTS} }}
"""


class Cluster:
    """A scheduler and a worker with a nanny, as processes of dask's command line."""

    def __init__(self, folder: Path) -> None:
        file = folder / f"scheduler-{time.monotonic_ns()}.json"
        scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        worker = ["worker", "--nworkers", "1", "--nthreads", "1", "--no-dashboard"]
        self._log = (folder / "dask.log").open("a")
        self._folder = folder
        named = ["--scheduler-file", str(file)]
        self.scheduler = self._started(*scheduler, *named)
        while not file.exists() or not file.read_text().endswith("}"):
            time.sleep(0.05)
        local = ["--local-directory", str(folder / "local")]
        self.nanny = self._started(*worker, *named, *local)
        import distributed

        client: Any = distributed.Client
        with client(scheduler_file=str(file), timeout=60) as found:
            self.address = found.scheduler.address
            found.wait_for_workers(1)

    def worker(self) -> int:
        """Return the process that computes, a child of the nanny."""
        import psutil

        found = psutil.Process(self.nanny.pid).children(recursive=True)
        return next(int(one.pid) for one in found if "spawn_main" in " ".join(one.cmdline()))

    def close(self) -> None:
        """End both processes and the worker's."""
        for process in (self.nanny, self.scheduler):
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(30)
            process.kill()
            process.wait()
        self._log.close()

    def _started(self, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
        return subprocess.Popen(command, cwd=self._folder, stdout=self._log, stderr=self._log)


def moment(number: int, folder: Path, cluster: Cluster, wanted: Any) -> tuple[str, str]:
    """Kill one process of a study; return what happened and a fault."""
    from nlosoptics.study import Study, run_study

    draw = np.random.default_rng([number, 23])
    victim = VICTIMS[number % 3]
    delay, store = draw.uniform(0.0, 2.0), folder / f"store-{number}"
    words = ["study", str(folder / "study.toml"), "--out", str(store)]
    words += ["--scheduler", cluster.address]
    client = subprocess.Popen(
        [sys.executable, "-c", "from nlosoptics.cli import main; main()", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    started = time.monotonic()
    while client.poll() is None and not list(store.glob("status/c/*/*")):
        if time.monotonic() - started > LONGEST:
            break
        time.sleep(0.003)
    time.sleep(delay)
    process = {
        "client": lambda: client.pid,
        "worker": cluster.worker,
        "scheduler": lambda: cluster.scheduler.pid,
    }[victim]()
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
    fault = ""
    try:
        told = client.communicate(timeout=LONGEST)[1]
    except subprocess.TimeoutExpired:
        client.kill()
        told, fault = client.communicate()[1], f"the client hung after the {victim} was killed"
    code = client.returncode
    if not fault and victim != "client" and code not in (0, 1, 2):
        fault = f"exit {code}: {told}"
    lines = [line for line in told.splitlines() if line.startswith("nlosoptics: ")]
    if not fault and code > 0 and (len(lines) != 1 or "Traceback" in told):
        fault = f"not one line: {told}"
    spent = _seconds(store)
    found = run_study(Study.load(folder / "study.toml"), store, workers=0).dataset
    if not fault and not found.drop_vars("seconds").identical(wanted):
        fault = "the resumed study has other bits"
    known = np.isfinite(spent)
    if not fault and not np.array_equal(_seconds(store)[known], spent[known]):
        fault = "a finished point was computed again"
    shutil.rmtree(store)
    end = "finished" if code == 0 else "one line" if code > 0 else "killed"
    return f"{victim} killed, client {end}", f"{fault} ({known.sum()} points)" if fault else ""


def _seconds(store: Path) -> Any:
    """Return the computing time of each point of a store; NaN if it is not finished."""
    from nlosoptics.study import Results
    from nlosoptics.study.store import Store

    if Store.open(store) is None:
        return np.full(POINTS, np.nan)
    data = Results.load(store).dataset
    return np.where(data["status"] == "done", data["seconds"], np.nan).ravel()


def main() -> int:
    """Print what happened for each victim; return 1 if there was a fault."""
    from nlosoptics.study import Study, run_study

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=12, help="number of kills")
    parser.add_argument("--first", type=int, default=0, help="first number")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    faults = 0
    with tempfile.TemporaryDirectory() as name, ExitStack() as held:
        folder = Path(name)
        (folder / "study.toml").write_text(STUDY)
        shutil.copy(ROOT / "tests" / "study" / "own_figures.py", folder)
        study = Study.load(folder / "study.toml")
        wanted = run_study(study, folder / "undisturbed", workers=0).dataset.drop_vars("seconds")
        cluster = None
        for number in range(options.first, options.first + options.moments):
            if cluster is None or cluster.scheduler.poll() is not None:
                held.close()
                cluster = Cluster(folder)
                held.callback(cluster.close)
            kind, fault = moment(number, folder, cluster, wanted)
            counts[kind] += 1
            if fault:
                print(f"  {number} ({kind}): {' '.join(fault.split())[:600]}", flush=True)
                faults += 1
    told = ", ".join(f"{n} {kind}" for kind, n in counts.most_common())
    print(f"cluster: {counts.total()} moments: {told}; {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
