"""Whether a fit without a known wall can be expected to work, from tested cases."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

#: By strength of the wall, waves rms: shares of tested fits that found the object, with one frame
#: and with two. The tests are those of `benchmarks/inverse/evidence.py`: 36 fits with one frame and
#: 36 to 42 with two per strength, noise of 1 % of the brightest pixel.
SHARES = {0.25: (36 / 36, 42 / 42), 0.5: (36 / 36, 36 / 36), 1.0: (20 / 36, 38 / 39)}


@dataclass(frozen=True, kw_only=True)
class BlindForecast:
    """Expected success of fits that know neither the object nor the wall."""

    # Share of tested fits that found the object, in cases like this one; NaN if no such case was
    # tested or no fit is needed
    one_frame: float
    two_frames: float
    text: str  # Statement of the forecast and of its reason


def blind_forecast(
    strength: float, noise: float, blur: float, bounds: Mapping[int, float]
) -> BlindForecast:
    """Forecast the success of a blind fit with one frame, and with two of known defocus.

    Shares are interpolated between the tested strengths of 0.25, 0.5 and 1 wave; weaker walls count
    as 0.25 waves. In these tests pixels resolve the smooth wall's point spread, lobes have no
    slope, and the second frame has a defocus of half a wave rms (one wave for the strongest walls).
    The Cramer-Rao bounds hold for a known object and can only be larger for an unknown one. If
    together they exceed the wave's own strength, the image does not hold the wave.
    """
    unknown = math.nan
    if math.isnan(strength) or not bounds:
        return BlindForecast(
            one_frame=0.0, two_frames=0.0, text="no image, so no wall can be fitted"
        )
    told = f"the wall's wave is {strength:.2g} waves rms"
    weak = 1 / 14  # a weaker wave is diffraction-limited (Marechal)
    if strength < weak:
        text = f"{told}, below {weak:.2g}: a fit that knows the smooth wall needs no other"
        return BlindForecast(one_frame=unknown, two_frames=unknown, text=text)
    least = math.sqrt(sum(value**2 for value in bounds.values()))
    if least > strength:
        text = (
            f"{told}, and a fit to two frames would err by {least:.2g} waves rms at best: the wave "
            "cannot be found"
        )
        return BlindForecast(one_frame=0.0, two_frames=0.0, text=text)
    reason = ""
    strongest = max(SHARES)
    if strength > strongest:
        reason = f"walls above {strongest:g} wave"
    elif noise > 0.02:  # noise and blur in pixels rms are larger than in the tests
        reason = f"noise of {100 * noise:.2g} % of the brightest pixel"
    elif blur > 0.5:
        reason = f"a lobe that blurs by {blur:.2g} pixels rms"
    if reason:
        text = f"{told}; blind fits were not tested for {reason}"
        return BlindForecast(one_frame=unknown, two_frames=unknown, text=text)
    one, two = (
        float(np.interp(strength, list(SHARES), s)) for s in zip(*SHARES.values(), strict=True)
    )
    text = (
        f"{told}; of such walls {100 * two:.0f} % were found from two frames of known defocus and "
        f"{100 * one:.0f} % from one"
    )
    return BlindForecast(one_frame=one, two_frames=two, text=text)
