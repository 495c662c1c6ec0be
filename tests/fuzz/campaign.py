"""Damaged files against every reader of files from outside.

python -m tests.fuzz.campaign [--inputs 10000] [--first 0] [--readers NAME ...]

A reader must return finite arrays or refuse with one line of an `NlosError`, within 5 s of
processor time and a memory budget, and may not return a byte of the canary, a file next to the
inputs. The table counts what happened; each fault is printed with the number that repeats it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .mutations import mutated
from .readers import READERS

MOST_SECONDS = 5.0  # of processor time for one input
MEMORY = 2 << 30  # bytes that one input may use
#: Bytes that no valid sample contains.
CANARY = np.float64(1.2345678901234567e-77).tobytes()


class Outcome(NamedTuple):
    """What one input led to: "read", "refused" or a fault with its description."""

    number: int
    file: str
    kind: str
    text: str = ""


class HangError(BaseException):
    """The processor time of one input is used up."""


class Bench:
    """Samples of one reader in a folder, damaged one at a time."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.folder = name, folder
        self._reader = READERS[name]
        self.folder.mkdir(parents=True, exist_ok=True)
        self._files = self._reader.make(self.folder)
        self._contents = [file.read_bytes() for file in self._files]
        (self.folder / "canary.bin").write_bytes(CANARY * 512)
        for file in self._files:  # undamaged samples are read
            self._check(self._reader.read(self.folder, file))

    def damaged(self, number: int) -> tuple[Path, bytes]:
        """Return which file an input damages, and its content."""
        # the name's bytes give each reader a stream of its own
        draw = np.random.default_rng([number, *self.name.encode()])
        index = int(draw.integers(len(self._files)))
        content = mutated(self._contents[index], self._contents, draw, text=self._reader.text)
        return self._files[index], content

    def run(self, number: int) -> Outcome:
        """Read one damaged input."""
        from nlosoptics.errors import NlosError

        file, content = self.damaged(number)
        original = self._contents[self._files.index(file)]
        file.write_bytes(content)
        signal.signal(signal.SIGPROF, _hang)
        signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("default", category=ResourceWarning)
                self._check(self._reader.read(self.folder, file))
            outcome = Outcome(number, file.name, "read")
        except NlosError as error:
            text = str(error)
            fine = text and "\n" not in text.strip() and len(text) < 1000
            outcome = Outcome(number, file.name, "refused" if fine else "not one line", text)
        except HangError:
            outcome = Outcome(number, file.name, "hang")
        except MemoryError as error:
            outcome = Outcome(number, file.name, "memory", repr(error))
        except Exception as error:
            told = f"{type(error).__name__}: {error}".splitlines()[0]
            outcome = Outcome(number, file.name, type(error).__name__, told)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            file.write_bytes(original)
        return outcome

    def _check(self, arrays: Any) -> None:
        for array in arrays:
            if not np.isfinite(array).all():
                raise AssertionError("an array that was read has NaN or infinity")
            if CANARY in np.ascontiguousarray(array, dtype=np.float64).tobytes():
                raise AssertionError("bytes of another file were read")


def _hang(*_: object) -> None:
    raise HangError


def _work(name: str, folder: str, numbers: list[int], at: Any, results: Any) -> None:
    """Run inputs in a process of their own; ``at`` is the input in hand."""
    bench = Bench(name, Path(folder))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    for number in numbers:
        at.value = number
        results.put(bench.run(number))
    at.value = -1


def campaign(name: str, numbers: list[int], folder: Path) -> Iterator[Outcome]:
    """Yield the outcomes of inputs; a process that ends or hangs is one fault and replaced."""
    context = multiprocessing.get_context("spawn")
    while numbers:
        at, results = context.Value("q", -2), context.Queue()
        place = folder / f"{name}_{numbers[0]}"
        process = context.Process(target=_work, args=(name, str(place), numbers, at, results))
        process.start()
        last, stuck = time.monotonic(), False
        while True:
            while not results.empty() or (process.is_alive() and _waits(results)):
                outcome = results.get()
                last, numbers = time.monotonic(), numbers[1:]
                yield outcome
            if not process.is_alive():
                break
            if time.monotonic() - last > 60.0 + 10.0 * MOST_SECONDS:
                stuck = True
                process.kill()
                break
        process.join()
        shutil.rmtree(place, ignore_errors=True)
        if not numbers:
            return
        if at.value == -2:
            sys.exit(f"the samples of {name} cannot be read")
        if stuck:
            yield Outcome(numbers[0], "", "hang", "in compiled code")
        else:
            yield Outcome(numbers[0], "", "process ended", f"exit code {process.exitcode}")
        numbers = numbers[1:]


def _waits(results: Any) -> bool:
    """Wait a moment for a result; return whether there is one."""
    time.sleep(0.05)
    return not results.empty()


def main() -> int:
    """Print a table of outcomes for each reader; return 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--inputs", type=int, default=10_000, help="number for each reader")
    parser.add_argument("--first", type=int, default=0, help="first number")
    parser.add_argument("--readers", nargs="*", choices=READERS, default=list(READERS))
    options = parser.parse_args()
    faults = 0
    for name in options.readers:
        counts: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as folder:
            numbers = list(range(options.first, options.first + options.inputs))
            for outcome in campaign(name, numbers, Path(folder)):
                counts[outcome.kind] += 1
                if outcome.kind not in ("read", "refused"):
                    print(f"  {name} {outcome.number} {outcome.file}: {outcome.text}")
                    faults += 1
        told = ", ".join(f"{n} {kind}" for kind, n in counts.most_common())
        print(f"{name}: {counts.total()} inputs: {told}", flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
