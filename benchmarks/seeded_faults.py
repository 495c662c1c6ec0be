"""Seed typical faults, one at a time, and ask ``nlosoptics verify``: it must find each.

Each fault is an edit of one line in a copy of the package: a wrong sign, a missing cosine, half a
pixel. ``python benchmarks/seeded_faults.py`` prints which checks failed for each fault, and ends
with exit code 1 if a fault passed all checks, or if a check fails without any. The first run, which
has no fault, compiles the package for all others; each of them takes about 20 s.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: What is wrong, the file, the right text and the wrong one.
FAULTS = (
    (
        "sign of a concave wall",
        "kernels/heights.py",
        "h = c * (x * x + y * y)",
        "h = -c * (x * x + y * y)",
    ),
    (
        "slope of a sphere",
        "kernels/heights.py",
        "hx, hy = c * x / root, c * y / root",
        "hx, hy = c * x, c * y",
    ),
    (
        "Zernike norm",
        "psf/wave/zernikes.py",
        "(n + 1) * (1 if m == 0 else 2)",
        "(n + 1) * (1 if m == 0 else 1)",
    ),
    (
        "sign of the image distance",
        "psf/transform/nufft.py",
        "per_metre = 1 / (",
        "per_metre = -1 / (",
    ),
    (
        "half a sample",
        "psf/transform/nufft.py",
        "(n // 2) * window.pitch",
        "(n / 2 - 0.5) * window.pitch",
    ),
    (
        "direction of tilt",
        "psf/wave/detilted.py",
        "return self.tilt[0] * d, self.tilt[1] * d",
        "return -self.tilt[0] * d, self.tilt[1] * d",
    ),
    (
        "FFT turned round",
        "psf/transform/antialiased_fft.py",
        "forward = residual.wavefront.image_distance > 0",
        "forward = residual.wavefront.image_distance < 0",
    ),
    (
        "obscuration-free Airy field",
        "psf/transform/airy.py",
        "scale, obscuration = math.pi / residual.airy_unit",
        "scale, obscuration = 3.0 / residual.airy_unit",
    ),
    (
        "frequency of the MTF",
        "psf/metrics/pupil_overlap.py",
        "widest = np.arccos(shift / (2 * a))",
        "widest = np.arccos(shift / a / 2.1)",
    ),
    (
        "cosine on the wall",
        "imaging/_penumbra_kernels.py",
        "* mu / (square * square)",
        "/ square**1.5",
    ),
    ("pi of a matt wall", "kernels/brdf.py", "f = strength / math.pi if", "f = strength / 3.0 if"),
    (
        "cosine on the hidden object",
        "imaging/radiometry.py",
        "radiant_intensity(scene, spot, -toward) * cosine / square",
        "radiant_intensity(scene, spot, -toward) / square",
    ),
    (
        "aperture of the lens",
        "imaging/radiometry.py",
        "/ (4.0 * f_number**2)",
        "/ (4.0 * f_number)",
    ),
    (
        "half a pixel",
        "imaging/geometry.py",
        "(np.arange(n + 1, dtype=np.float64) - n / 2)",
        "(np.arange(n + 1, dtype=np.float64) - n // 2 - 0.5)",
    ),
    (
        "variance of photons",
        "imaging/detector.py",
        ".poisson(np.minimum(mean, BRIGHT)).astype(np.float64)",
        ".poisson(2 * np.minimum(mean, BRIGHT)) / 2",
    ),
    (
        "adjoint of the blur",
        "imaging/forward_model.py",
        "self._filter(picture, np.conj(self.transfer))",
        "self._filter(picture, self.transfer)",
    ),
    (
        "seed of the rays",
        "raytrace/light/trace.py",
        "seed = checked_seed(seed)",
        "seed = checked_seed(0)",
    ),
    (
        "three-bounce square of the path",
        "transient/rendering/_three_bounce_kernels.py",
        "z * z * (h1 * h2) * f / (both * both)",
        "z * (h1 * h2) * f / (both * both)",
    ),
    (
        "depth axis of f-k migration",
        "transient/imaging/fk_migration.py",
        "lateral_sq = ky[rows, None] ** 2 + kx**2",
        "lateral_sq = ky[rows, None] ** 2 - kx**2",
    ),
    (
        "kernel of the solver",
        "inverse/known/total_variation.py",
        "self.data_penalty * self._transfer.conj()",
        "self.data_penalty * self._transfer",
    ),
    (
        "conjugate pupil in torch",
        "inverse/wave/pupil_optics.py",
        "self._amplitude * phase.sin())",
        "-self._amplitude * phase.sin())",
    ),
    (
        "half a bin",
        "transient/imaging/virtual_pulse.py",
        "(band.bins.start + 0.5) * capture.delta_t",
        "band.bins.start * capture.delta_t",
    ),
)


def failed_checks(package: Path) -> list[str]:
    """Return the names of the checks that fail in a copy of the package, in a fresh process."""
    code = (
        "from nlosoptics.verification import verify\n"
        "print(*[check.name for check in verify() if not check.passed], sep='\\n')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=package.parent,
        env=os.environ | {"PYTHONPATH": str(package.parent)},
        capture_output=True,
        text=True,
        check=True,
    )
    return [name for name in done.stdout.splitlines() if name]


def main() -> int:
    """Print a line for each fault; return the number of those that were not found."""
    if failing := failed_checks(ROOT / "nlosoptics"):
        raise SystemExit(f"without a fault these checks fail: {'; '.join(failing)}")
    missed = 0
    for name, file, right, wrong in FAULTS:
        with tempfile.TemporaryDirectory() as folder:
            package = Path(folder) / "nlosoptics"
            shutil.copytree(ROOT / "nlosoptics", package)
            text = (package / file).read_text()
            if text.count(right) != 1:
                raise LookupError(f"{file} has {text.count(right)} times {right!r}, needed 1")
            (package / file).write_text(text.replace(right, wrong))
            if "kernels" in file:  # compiled code of other files may contain this one
                for cache in package.rglob("*.nb[ci]"):
                    cache.unlink()
            found = failed_checks(package)
        missed += not found
        print(f"{'found ' if found else 'MISSED'}  {name}: {'; '.join(found)}", flush=True)
    print(f"{len(FAULTS) - missed} of {len(FAULTS)} faults found")
    return missed


if __name__ == "__main__":
    sys.exit(bool(main()))
