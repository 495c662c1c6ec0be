"""What the names in a record mean, in words."""

from __future__ import annotations

from typing import Final

#: What each command makes.
COMMANDS: Final = {
    "run": "simulation",
    "reconstruct": "reconstruction of a camera's pictures",
    "phasor": "picture of a time-resolved capture",
}

#: A reconstruction's status in a sentence.
OUTCOME: Final = {
    "converged": "The reconstruction converged.",
    "unconverged": "The reconstruction did not converge.",
    "trivial": "The reconstruction is trivial: it is the image itself.",
    "too_few_photons": "There are too few photons to reconstruct an object.",
}

#: What a reconstruction's status says of its object; see `inverse.Reconstruction`.
STATUS: Final = {
    "converged": "The fit settled: more iterations would not have changed the object by more than "
    "its tolerance.",
    "unconverged": "The fit ended before it settled. The picture may still change with more "
    "iterations, and is not to be relied on.",
    "trivial": "The wall was fitted too, and the answer is the image itself under no blur. It says "
    "nothing about the object.",
    "too_few_photons": "The background alone explains the image to within three standard errors: "
    "there is no object to recover, and the picture is empty.",
}

#: What a command's own status says where it is not "done".
UNFINISHED: Final = {
    "running": "The command is at work on this folder, or was ended before it could say so: what "
    "is shown is the last state that it kept.",
    "interrupted": "The command was interrupted: what is shown is the best it had. --resume goes "
    "on from there.",
}

#: Numbers of `psf.Regime`: their names, units and meanings.
REGIME: Final = {
    "peak_to_valley": ("Aberration, peak to valley", "waves", "piston and tilt taken out"),
    "rms": ("Aberration, rms", "waves", "weighted by amplitude"),
    "slope": ("Steepest slope", "rad", "of the aberration over the pupil"),
    "reach": ("Reach of rays", "λN", "where the farthest ray lands along x or y"),
    "slope_per_sample": ("Slope per sample", "waves", "of the pupil's grid; 0.5 is the limit"),
    "pixel": ("Pixel", "λN", "side of an image pixel"),
    "fresnel_number": ("Fresnel number", "", "a²/(λd), of the exit pupil"),
    "folded": ("Caustic", "", "whether rays fold over one another in the image plane"),
    "rayleigh_parameter": ("Rayleigh parameter", "rad", "of the wall's roughness; 0 is smooth"),
    "coherent_fraction": ("Coherent share", "", "of the light, in the smooth wall's core"),
}

#: Parts of the expected reading; see `imaging.SpeckleImage`.
LIGHT: Final = {
    "signal": "the object's picture, on the detector",
    "diffuse": "the wall's diffuse light",
    "spot": "the laser spot on the wall",
    "glare": "glare of the lens",
    "dark": "dark current",
}
#: What the object's picture loses on its way; likewise.
LOST: Final = {
    "beyond_window": "outside the point spread's window",
    "beyond_detector": "blurred past the detector's edges",
}
