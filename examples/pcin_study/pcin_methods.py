"""The study's methods, by name: each takes a case's data and returns a `Reconstruction`."""

from __future__ import annotations

import math
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pcin_data as data
import torch
from pcin_network import Network, training_pairs
from scipy import ndimage

from nlosoptics import inverse
from nlosoptics.errors import NlosError

CNN_FOLDER = "PCIN_STUDY_CNN"  # environment: where trained networks are kept
CNN_WAVES = 0.75  # largest rms of a training wall's wave
TRAINING_WALLS = 10  # walls of facets in its training, scale "rough"
BRIGHTEST = 1100.0  # electrons of the brightest pixel of a training image, scale "rough"
SEED = 1

NAMES = (
    "image",
    "inverse_filter",
    "tv",
    "phase_retrieval",
    "hio",
    "cnn",
    "wu2024",
    "wu2024_warm",
    "evidence",
    "evidence_2frames",
)
WARM_FROM = "cartoon"  # the object whose result a warm start has
# of the paper: "more than 4000", "approximately 1800"
COLD, WARM = 4000, 1800
ENVELOPE = 8.0  # pixels, rms: a speckle image is divided by its mean over so many
CELLS = 17  # nodes of the fitted exit angles across the pupil, scale "rough": one for each facet


def place_of(key: dict[str, Any]) -> data.Place:
    """What the point spread depends on; smooth walls are the same for all seeds."""
    seed = key["seed"] if key["scale"] == "rough" else 0
    return key["scale"], key["object"], key["wall"], key["size"], seed


def solved(key: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """One case: the line of its figures, and its pictures by name."""
    taken = data.exposure_of(place_of(key), key["exposure_ms"], key["seed"])
    line = {**key, "simulated_in": round(taken.seconds, 2)}
    pictures = {"image": taken.image, "truth": taken.truth}
    if key["method"] == "image":
        line |= {**_scores(taken.image, taken.truth), "status": "", "seconds": 0.0}
        return {**line, "box": _rounded(box_score(taken.truth))}, pictures
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
    if coefficients is not None and key["scale"] == "smooth":
        off = np.asarray(coefficients) - data.wall_waves(key["wall"], key["size"])
        line["wave_error"] = _rounded(float(np.linalg.norm(off)))
    return line, {**pictures, "object": found.object}


def box_score(truth: data.Array) -> float:
    """Correlation of an object with a plain rectangle of its size: what its outline alone gives."""
    bright = truth > 0.5 * truth.max()
    rows, columns = (
        np.maximum.accumulate(side) & np.maximum.accumulate(side[::-1])[::-1]
        for side in (bright.any(axis=1), bright.any(axis=0))
    )
    return inverse.registered_correlation(np.outer(rows, columns).astype(float), truth)


def _scores(found: Any, truth: Any, *, flip: bool = False) -> dict[str, Any]:
    correlation = inverse.registered_correlation(found, truth, flip=flip)
    # after the best shift, scale and offset
    error = float(truth.var()) * (1.0 - correlation**2)
    psnr = 10.0 * math.log10(float(np.ptp(truth)) ** 2 / error) if error > 0.0 else math.inf
    return {"correlation": _rounded(correlation), "psnr": _rounded(psnr)}


def _rounded(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _known(key: dict[str, Any], taken: data.Exposure) -> Any:
    place = place_of(key)
    solver = inverse.tv_deconvolve if key["method"] == "tv" else inverse.inverse_filter
    veil = data.veil(place)
    image = inverse.Measurement(taken.image, noise_sigma=taken.noise, background_shape=veil)
    # one division of spectra takes one point spread
    model = data.known_model(place, mean=key["method"] == "inverse_filter")
    return solver(image, model), {}


def _phase_retrieval(key: dict[str, Any], taken: data.Exposure) -> Any:
    method = "alternating" if key["method"] == "phase_retrieval" else "hio"
    if key["scale"] != "rough":
        found = inverse.phase_retrieval(
            inverse.Measurement(taken.image, noise_sigma=taken.noise), method=method, seed=SEED
        )
        return found, {}
    # Speckle under an envelope: Katz 2014 divides by the mean of the neighbourhood as well.
    mean = ndimage.gaussian_filter(taken.image, ENVELOPE)
    even = taken.image / np.maximum(mean, 1e-3 * mean.max())
    return inverse.phase_retrieval(even, method=method, seed=SEED), {}


def _cnn(key: dict[str, Any], taken: data.Exposure) -> Any:
    trained, seconds = network(key["scale"], key["size"], key["pairs"])
    found = trained.reconstruct(taken.image, taken.noise, data.known_model(place_of(key)))
    return found, {"training_seconds": round(seconds, 1), "iterations": 0}


@lru_cache(maxsize=2)
def network(scale: str, size: int, pairs: int) -> tuple[Network, float]:
    """Network for flat walls with random waves or facets, 40 ms; kept as a file."""
    found = Network(seed=SEED)
    folder = os.environ.get(CNN_FOLDER)
    path = Path(folder) / f"cnn-{scale}-{size}-{pairs}.pt" if folder else None
    if path is not None and path.is_file():
        found.unet.load_state_dict(torch.load(path, weights_only=True))
        return found, 0.0
    scene = data.flat_scene("smooth", size)
    images, objects = training_pairs(scene, pairs, waves=CNN_WAVES, seed=SEED)
    if scale == "rough":
        images, objects = _by_facets(objects, size)
    seconds = found.train(images, objects, seed=SEED)
    if path is not None:
        torch.save(found.unet.state_dict(), path)
    return found, seconds


def _by_facets(shown: Any, size: int) -> tuple[Any, Any]:
    """The same objects, as small as the study's, seen by walls of facets that the study has not."""
    draws = np.random.default_rng(SEED)
    small = max(1, round(1.0 / data.SCALES["rough"].fill))
    side = size // small
    at = (size - side) // 2
    objects = np.zeros_like(shown)
    means = shown[:, : side * small, : side * small]
    means = means.reshape(-1, side, small, side, small).mean(axis=(2, 4))
    objects[:, at : at + side, at : at + side] = means
    images = np.empty_like(objects)
    for first in range(TRAINING_WALLS):
        wall = ("rough", "letter", "flat", size, 1000 + first)
        model = data.known_model(wall)
        for i in range(first, len(objects), TRAINING_WALLS):
            seen = model.forward(objects[i].astype(np.float64))
            bright = BRIGHTEST / max(float(seen.max()), 1e-12)
            images[i] = draws.poisson(bright * np.maximum(seen, 0.0))
    return images, objects


@lru_cache(maxsize=8)
def _wu2024_run(place: data.Place, milliseconds: int, seed: int, iterations: int) -> Any:
    taken = data.exposure_of(place, milliseconds, seed)
    cells = CELLS if place[0] == "rough" else 0
    return inverse.pcin(
        inverse.Measurement(taken.image, noise_sigma=taken.noise),
        data.fitted_pupil(place[0], place[3], cells=cells),
        recipe="wu2024",
        max_iterations=iterations,
        seed=seed,
    )


def _wu2024(key: dict[str, Any], taken: data.Exposure) -> Any:
    run = _wu2024_run(place_of(key), key["exposure_ms"], key["seed"], key["iterations_asked"])
    return run, {}


def _wu2024_warm(key: dict[str, Any], taken: data.Exposure) -> Any:
    """From the result for another object; iterations to the fit that a cold run ends with."""
    asked = key["iterations_asked"]
    scale, _, *rest = place = place_of(key)
    how = (key["exposure_ms"], key["seed"], asked)
    cold = _wu2024_run(place, *how)
    found = inverse.pcin(
        inverse.Measurement(taken.image, noise_sigma=taken.noise),
        data.fitted_pupil(scale, key["size"], cells=CELLS if scale == "rough" else 0),
        recipe="wu2024",
        start=_wu2024_run((scale, WARM_FROM, *rest), *how),
        max_iterations=max(1, round(asked * WARM / COLD)),
        seed=key["seed"],
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


def _blind(key: dict[str, Any], taken: data.Exposure) -> Any:
    """The evidence of one frame, or of two of which the second has a known change of focus."""
    scale, size = key["scale"], key["size"]
    images = inverse.Measurement(taken.image, noise_sigma=taken.noise)
    options: dict[str, Any] = {}
    if key["method"] == "evidence_2frames":
        second = data.exposure_of(place_of(key), key["exposure_ms"], key["seed"], second=True)
        images = inverse.Measurement(
            np.stack([taken.image, second.image]), noise_sigma=[taken.noise, second.noise]
        )
        extra = data.defocus_waves(scale, size) * taken.scene.laser.wavelength
        options = {"defocus": [0.0, extra]}
    found = inverse.evidence_fit(
        images,
        data.fitted_pupil(scale, size),
        seed=key["seed"],
        max_seconds=key["max_seconds"],
        **options,
    )
    return found, {}


_METHODS = {
    "inverse_filter": _known,
    "tv": _known,
    "phase_retrieval": _phase_retrieval,
    "hio": _phase_retrieval,
    "cnn": _cnn,
    "wu2024": _wu2024,
    "wu2024_warm": _wu2024_warm,
    "evidence": _blind,
    "evidence_2frames": _blind,
}
