"""Verdict whether an object can be recovered and, if not, which change would allow it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._checks import counted
from .modulation import Noise, Picture

Array = NDArray[np.float64]

#: Predicted correlation above which an object counts as recoverable.
GOOD = 0.9
#: Fraction of saturated pixels above which an image is unusable.
FULL = 0.01
MOST_EXPOSURE = 1e6  # largest exposure factor that a verdict suggests
NOISELESS = Noise(photons=0.0, readout=0.0, speckle=0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """Inputs of a verdict."""

    picture: Picture  # Spectra of the image formed by the mirror-like lobes
    # (rows, columns): Modulus of that image's transfer function if the lobes had no slopes
    sharp: Array
    mirror: float  # Total reflectance of the mirror-like lobes
    slope: float  # Largest rms slope of these lobes, rad
    reach: float  # Blur on the object per lobe slope, m rms per rad: 2 d1 at normal incidence
    stroke: float  # Stroke width of the object, m; 0 for a dark object
    full: float  # Expected fraction of saturated pixels
    diffuse_modes: int  # Modes above the noise through wide lobes
    relay_score: float  # Predicted correlation of a fit to the light of wide lobes
    shadowed: bool  # Whether the scene has occluders

    @property
    def score(self) -> float:
        """Predicted correlation of a fit to the image; 0 without one."""
        return self.picture.score() if self.mirror > 0.0 else 0.0


def verdict(case: Case) -> tuple[bool, str]:
    """Return whether the object can be recovered, and the verdict as text."""
    reasons = list(_reasons(case))
    if not reasons:
        return True, "recoverable"
    # without shadows, light of wide mirror-like lobes is the image that the score already judges
    other = case.mirror == 0.0 or case.shadowed
    if other and case.full <= FULL and case.relay_score >= GOOD:
        return True, f"recoverable without an image: {_diffuse_words(case)}"
    return False, f"not recoverable: {'; '.join(reasons)}"


def _reasons(case: Case) -> list[str]:
    if case.mirror > 0.0 and not case.picture.power.any():
        if case.picture.fill > 0.0:
            return ["all pixels see the same light and show no detail; read more, smaller pixels"]
        return ["no light from the object reaches the camera via the wall's mirror-like lobe"]
    if case.mirror == 0.0:
        return [_diffuse(case)]
    if case.full > FULL:
        return [
            f"{100 * case.full:.2g} % of the pixels are full; expose shorter, or hide the laser "
            "spot from the camera with a field stop"
        ]
    if case.picture.score() >= GOOD:
        return []
    sharp = case.picture.with_lobe(0.0, instead=case.sharp)
    if sharp.score() >= GOOD:
        return [_too_rough(case)]
    if case.picture.with_noise(NOISELESS).score() >= GOOD:
        return [_too_noisy(case.picture)]
    found = [_too_noisy(sharp)]
    if case.slope > 0.0:
        found.append(_stroke_words(case))
    return found


def _diffuse(case: Case) -> str:
    needed = case.stroke / case.reach
    told = f" of slope below {needed:.2g} rad" if needed > 0.0 else ""
    remedy = f"a lobe{told} would carry more"
    if not case.shadowed:
        remedy = f"a lobe{told}, or an occluder near the object, would carry more"
    return f"the wall has no mirror-like lobe, and {_diffuse_words(case)}; {remedy}"


def _diffuse_words(case: Case) -> str:
    past = " past the occluders" if case.shadowed else ""
    rise = "rises" if case.diffuse_modes == 1 else "rise"
    return (
        f"by diffuse light{past} {counted(case.diffuse_modes, 'mode')} {rise} above the noise, "
        f"which give a correlation of {case.relay_score:.2f}"
    )


def _stroke_words(case: Case) -> str:
    return (
        f"the lobe's slope of {case.slope:.2g} rad blurs by {1e3 * case.slope * case.reach:.3g} "
        f"mm rms, strokes are {1e3 * case.stroke:.2g} mm wide"
    )


def _too_rough(case: Case) -> str:
    """Reason if the lobe's blur is the obstacle, with the slope of a round lobe that would do."""
    low, high = 0.0, case.slope
    for _ in range(20):
        middle = (low + high) / 2
        blurred = case.picture.with_lobe(middle * case.reach, instead=case.sharp)
        low, high = (middle, high) if blurred.score() >= GOOD else (low, middle)
    text = (
        f"{_stroke_words(case)}; a lobe of {_rounded_down(low):.2g} rad or less would do, or the "
        "object nearer the wall"
    )
    longer = _exposure_factor(case.picture)
    return text if longer is None else f"{text}, or {_longer(longer)}"


def _too_noisy(picture: Picture) -> str:
    longer = _exposure_factor(picture)
    noise = picture.noise
    if longer is not None:
        return f"the noise is too strong; {_longer(longer)} would do"
    if noise.speckle > 0.0:
        quiet = Noise(photons=noise.photons, readout=noise.readout, speckle=0.0)
        told = picture.with_noise(quiet)
        if told.score() >= GOOD or _exposure_factor(told) is not None:
            return "speckle is too strong at any exposure; average patterns, or use a wider pixel"
    if picture.with_noise(NOISELESS).score() >= GOOD:
        return (
            f"the picture is too faint even at {_longer(MOST_EXPOSURE)}; use a stronger "
            "mirror-like lobe, or a larger lens"
        )
    return "optics and pixels pass too little detail; use a sharper focus or finer pixels"


def _longer(factor: float) -> str:
    return f"{-_rounded_down(-factor):.2g} times the exposure or laser power"


def _rounded_down(value: float) -> float:
    """Round to two digits toward -inf, so that a remedy at its limit suffices."""
    if value == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return math.floor(value / unit) * unit


def _exposure_factor(picture: Picture) -> float | None:
    """Exposure factor at which the score becomes good; None if it exceeds `MOST_EXPOSURE`."""

    def good(factor: float) -> bool:
        return picture.with_noise(picture.noise.exposed(factor)).score() >= GOOD

    if not good(MOST_EXPOSURE):
        return None
    low, high = 0.0, math.log(MOST_EXPOSURE)
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (low, middle) if good(math.exp(middle)) else (middle, high)
    return math.exp(high)
