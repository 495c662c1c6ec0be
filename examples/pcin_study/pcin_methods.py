"""The study's methods, by name: each takes a case's data and returns a `Reconstruction`."""

from __future__ import annotations

import math
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pcin_data as data

from nlosoptics import inverse
from nlosoptics.errors import NlosError

CNN_FOLDER = "PCIN_STUDY_CNN"  # environment: where trained networks are kept
CNN_WAVES = 0.75  # largest rms of a training wall's wave
SEED = 1

FAST = ("image", "inverse_filter", "phase_retrieval", "hio", "tv")
NAMES = (
    *FAST,
    "cnn",
    "wu2024",
    "wu2024_warm",
    "evidence",
    "evidence_2frames",
    "evidence_2frames_warm",
)
WARM_FROM = "cartoon"  # the object whose result a warm start has
# of the paper: "more than 4000", "approximately 1800"
COLD, WARM = 4000, 1800


def solved(key: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """One case: the line of its figures, and its pictures by name."""
    place = (key["scale"], key["object"], key["wall"], key["size"])
    taken = data.exposure_of(*place, key["exposure_ms"])
    line = {**key, "simulated_in": round(taken.seconds, 2)}
    pictures = {"image": taken.image, "truth": taken.truth}
    if key["method"] == "image":
        return {**line, **_scores(taken.image, taken.truth), "status": "", "seconds": 0.0}, pictures
    try:
        found, more = _METHODS[key["method"]](key, taken)
    except NlosError as refusal:
        return {**line, "status": "refused", "error": str(refusal)}, pictures
    line |= {
        **_scores(found.object, taken.truth, flip=key["method"] in ("phase_retrieval", "hio")),
        "like_image": _rounded(inverse.registered_correlation(found, taken.image)),
        "status": found.status,
        "score": _rounded(found.score),
        "seconds": round(found.seconds, 2),
        "iterations": max((len(values) for values in found.history.values()), default=0),
        **more,
    }
    coefficients = found.physical_parameters.get("coefficients")
    if coefficients is not None and key["scale"] == "wall":
        off = np.asarray(coefficients) - data.wall_waves(key["wall"], key["size"])
        line["wave_error"] = _rounded(float(np.linalg.norm(off)))
    return line, {**pictures, "object": found.object}


def _scores(found: Any, truth: Any, *, flip: bool = False) -> dict[str, Any]:
    scores = inverse.registered_scores(found, truth, flip=flip)
    return {
        "correlation": _rounded(scores.correlation),
        "psnr": _rounded(scores.psnr),
        "ssim": _rounded(scores.ssim),
    }


def _rounded(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _place(key: dict[str, Any]) -> tuple[str, str, str, int]:
    return key["scale"], key["object"], key["wall"], key["size"]


def _inverse_filter(key: dict[str, Any], taken: data.Exposure) -> Any:
    place = _place(key)
    found = inverse.inverse_filter(
        taken.image,
        data.known_model(*place),
        noise_sigma=taken.noise,
        background_shape=data.veil(*place),
    )
    return found, {}


def _tv(key: dict[str, Any], taken: data.Exposure) -> Any:
    place = _place(key)
    found = inverse.tv_deconvolve(
        taken.image,
        data.known_model(*place),
        noise_sigma=taken.noise,
        background_shape=data.veil(*place),
    )
    return found, {}


def _phase_retrieval(key: dict[str, Any], taken: data.Exposure) -> Any:
    method = "alternating" if key["method"] == "phase_retrieval" else "hio"
    found = inverse.phase_retrieval(taken.image, method=method, noise_sigma=taken.noise, seed=SEED)
    return found, {}


def _cnn(key: dict[str, Any], taken: data.Exposure) -> Any:
    network, seconds = trained(key["size"], key["pairs"])
    # the image model only says how well the answer explains the image
    found = network.reconstruct(
        taken.image, data.known_model(*_place(key)), noise_sigma=taken.noise
    )
    return found, {"training_seconds": round(seconds, 1), "iterations": 0}


@lru_cache(maxsize=2)
def trained(size: int, pairs: int) -> tuple[inverse.CnnBaseline, float]:
    """Network for scale "wall", flat walls with random waves, 40 ms; kept as a file."""
    folder = os.environ.get(CNN_FOLDER)
    path = Path(folder) / f"cnn-{size}-{pairs}.safetensors" if folder else None
    if path is not None and path.is_file():
        return inverse.CnnBaseline.load(path), 0.0
    scene = data.study_scene("wall", "letter", "flat", size, 40e-3)
    shown = inverse.training_pairs(scene, pairs, waves=CNN_WAVES, seed=SEED)
    found = inverse.train_cnn(shown, base=8, epochs=20, seed=SEED)
    if path is not None:
        found.network.save(path)
    return found.network, found.seconds


@lru_cache(maxsize=8)
def _wu2024_run(name: str, wall: str, size: int, milliseconds: int, iterations: int) -> Any:
    taken = data.exposure_of("wall", name, wall, size, milliseconds)
    return inverse.pcin(
        taken.image,
        data.fitted_pupil(size),
        recipe="wu2024",
        noise_sigma=taken.noise,
        max_iterations=iterations,
        seed=SEED,
    )


def _wu2024(key: dict[str, Any], taken: data.Exposure) -> Any:
    run = _wu2024_run(
        key["object"], key["wall"], key["size"], key["exposure_ms"], key["iterations_asked"]
    )
    return run, {}


def _wu2024_warm(key: dict[str, Any], taken: data.Exposure) -> Any:
    """From the result for another object; iterations to the fit that a cold run ends with."""
    asked = key["iterations_asked"]
    place = (key["wall"], key["size"], key["exposure_ms"], asked)
    cold = _wu2024_run(key["object"], *place)
    found = inverse.pcin(
        taken.image,
        data.fitted_pupil(key["size"]),
        recipe="wu2024",
        noise_sigma=taken.noise,
        start=_wu2024_run(WARM_FROM, *place),
        max_iterations=max(1, round(asked * WARM / COLD)),
        seed=SEED,
    )
    goal = 1.02 * float(np.min(cold.history["residual"]))
    return found, {
        "cold_iterations_to_fit": _first_below(cold.history["residual"], goal),
        "warm_iterations_to_fit": _first_below(found.history["residual"], goal),
        "cold_correlation": _rounded(inverse.registered_correlation(cold, taken.truth)),
    }


def _first_below(residuals: Any, goal: float) -> int | None:
    reached = np.flatnonzero(np.asarray(residuals) <= goal)
    return int(reached[0]) + 1 if len(reached) else None


def _frames(key: dict[str, Any], name: str) -> tuple[Any, dict[str, Any]]:
    """Two frames of an object, and what is known of them: defocus, m rms, and noise."""
    wall, size = key["wall"], key["size"]
    first = data.exposure_of("wall", name, wall, size, key["exposure_ms"])
    second = data.exposure_of("wall", name, wall, size, key["exposure_ms"], second=True)
    extra = data.defocus_waves(size) * first.scene.laser.wavelength
    known = {"defocus": [0.0, extra], "noise_sigma": [first.noise, second.noise]}
    return np.stack([first.image, second.image]), known


def _blind(key: dict[str, Any], taken: data.Exposure) -> Any:
    recipe, _, frames = key["method"].partition("_")
    images: Any = taken.image
    options: dict[str, Any] = {"noise_sigma": taken.noise}
    if frames:
        images, options = _frames(key, key["object"])
    if "max_seconds" in key:
        options["max_seconds"] = key["max_seconds"]
    found = inverse.pcin(
        images,
        data.fitted_pupil(key["size"]),
        recipe=recipe,
        seed=SEED,
        **options,
    )
    return found, {}


def _evidence_warm(key: dict[str, Any], taken: data.Exposure) -> Any:
    """From the wall that was found with another object."""
    import torch

    images, known = _frames(key, WARM_FROM)
    other = inverse.evidence_fit(images, data.fitted_pupil(key["size"]), seed=SEED, **known)
    pupil = data.fitted_pupil(key["size"])
    with torch.no_grad():
        pupil.coefficients.copy_(torch.tensor(other.physical_parameters["coefficients"]))
    images, known = _frames(key, key["object"])
    found = inverse.evidence_fit(images, pupil, seed=SEED, start_error=0.05, **known)
    return found, {}


_METHODS = {
    "inverse_filter": _inverse_filter,
    "tv": _tv,
    "phase_retrieval": _phase_retrieval,
    "hio": _phase_retrieval,
    "cnn": _cnn,
    "wu2024": _wu2024,
    "wu2024_warm": _wu2024_warm,
    "evidence": _blind,
    "evidence_2frames": _blind,
    "evidence_2frames_warm": _evidence_warm,
}
