"""Descriptions of the names used in a record."""

from __future__ import annotations

from typing import Final

#: Result of each command.
COMMANDS: Final = {
    "run": "simulation",
    "reconstruct": "reconstruction from camera images",
    "phasor": "image from a time-resolved capture",
}

#: Status of a reconstruction as a sentence.
OUTCOME: Final = {
    "converged": "The reconstruction converged.",
    "unconverged": "The reconstruction did not converge.",
    "trivial": "The reconstruction is trivial: it is the image itself.",
    "too_few_photons": "There are too few photons to reconstruct an object reliably.",
    "does_not_fit": "The image does not fit this scene.",
}

#: Meaning of a reconstruction's status for its object; see `inverse.Reconstruction`.
STATUS: Final = {
    "converged": "More iterations would hardly change the object, and with a known point spread no "
    "test found a fault of the model.",
    "unconverged": "The fit ended before it converged. The object may still change with more "
    "iterations and is not reliable.",
    "trivial": "The wall was fitted too, and the answer is the image itself without any blur. It "
    "says nothing about the object.",
    "too_few_photons": "The noise hides the object: the picture is a rough estimate, or empty if "
    "no object was detected. Expose longer, or average several images.",
    "does_not_fit": "Image and model contradict each other, so the object is not to be trusted. "
    "Check the scene file (wall, distances, focus), the background and the camera's response.",
}

#: Meaning of a command's status other than "done".
UNFINISHED: Final = {
    "running": "The command is still running or was killed. This page shows the last saved state.",
    "interrupted": "The command was interrupted. This page shows the best result so far; --resume "
    "continues from there.",
}

#: Entries of `psf.Regime`: name, unit and meaning.
REGIME: Final = {
    "peak_to_valley": ("Aberration, peak to valley", "waves", "piston and tilt removed"),
    "rms": ("Aberration, rms", "waves", "weighted by amplitude"),
    "slope": ("Steepest slope", "rad", "of the aberration over the pupil"),
    "reach": ("Reach of rays", "λN", "largest ray displacement along x or y in the image"),
    "slope_per_sample": ("Slope per sample", "waves", "of the pupil's grid; the limit is 0.5"),
    "pixel": ("Pixel", "λN", "side of an image pixel"),
    "fresnel_number": ("Fresnel number", "", "a²/(λd) of the exit pupil"),
    "folded": ("Caustic", "", "whether the image plane cuts a caustic of the rays"),
    "rayleigh_parameter": ("Rayleigh parameter", "rad", "of the wall's roughness; 0 if smooth"),
    "coherent_fraction": ("Coherent share", "", "fraction of light in the smooth wall's core"),
}

#: Parts of the expected image; see `imaging.SpeckleImage`.
LIGHT: Final = {
    "signal": "image of the object",
    "diffuse": "diffuse light of the wall",
    "spot": "laser spot on the wall",
    "glare": "lens glare",
    "dark": "dark current",
}
#: Losses of the object's image; see `imaging.SpeckleImage`.
LOST: Final = {
    "beyond_window": "outside the point spread's window",
    "beyond_detector": "blurred past the detector's edges",
}
