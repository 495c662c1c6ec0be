"""Writing commands that are killed, or whose disk is full, at random moments.

python -m tests.fuzz.kills [--moments 50] [--first 0] [--commands NAME ...] [--ends END ...]

After each end the destination must be the old or the new result as a whole, and the next run must
give what an undisturbed run gives and leave nothing else behind. The table counts what was found;
each fault is printed with the number that repeats it.

Ends are ``kill`` (SIGKILL), ``term`` (SIGTERM), ``full`` (a tmpfs with too little room) and
``locked`` (a tmpfs that is read-only, once). A third of the moments each is a random time, a random
operation on files, and a random time in the 50 ms after the first change of the folder.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

from .commands import COMMANDS
from .stage import ENDS, Stage, can_mount

#: Threads of compiled code survive a fork in this layer only.
SETTINGS = {
    "NUMBA_THREADING_LAYER": "workqueue",
    "NUMBA_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}


def _work(name: str, folder: str, ends: list[str], numbers: range) -> None:
    """Run all ends of one command in this process, and print what happened."""
    faults, stage = 0, Stage(name, Path(folder))
    for end in ends:
        moments = numbers if end != "locked" else numbers[:1]
        outcomes = [stage.moment(number, end) for number in moments]
        counts, bad = Counter(one.kind for one in outcomes), [one for one in outcomes if one.fault]
        for one in bad:
            print(f"  {name} {end} {one.number} ({one.kind}): {' '.join(one.fault.split())[:600]}")
        told = ", ".join(f"{n} {kind}" for kind, n in counts.most_common())
        print(f"{name}, {end}: {counts.total()} moments: {told}; {len(bad)} faults", flush=True)
        faults += len(bad)
    sys.exit(1 if faults else 0)


def main() -> int:
    """Print a table of outcomes for each command and end; return 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=50, help="number for each command and end")
    parser.add_argument("--first", type=int, default=0, help="first number")
    parser.add_argument("--commands", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--ends", nargs="*", choices=ENDS, default=list(ENDS))
    options = parser.parse_args()
    ends = options.ends
    if not can_mount() and {"full", "locked"} & {*ends}:
        print("full, locked: left out, since no tmpfs can be mounted here")
        ends = [end for end in ends if end not in ("full", "locked")]
    os.environ |= SETTINGS
    numbers, faults = range(options.first, options.first + options.moments), 0
    context = multiprocessing.get_context("spawn")  # numba and torch read the settings at import
    for name in options.commands:
        with tempfile.TemporaryDirectory() as folder:
            process = context.Process(target=_work, args=(name, f"{folder}/{name}", ends, numbers))
            process.start()
            process.join()
            faults += process.exitcode != 0
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
