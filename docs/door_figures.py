"""Draw the pictures of docs/doors: ``python docs/door_figures.py``, half a minute.

They show what the commands and the Python of these pages make; run it again when those change.
"""

from pathlib import Path

from matplotlib.figure import Figure

import nlosoptics as nlos
from nlosoptics import limits, transient, views

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "examples" / "scenes"
FIGURES = ROOT / "docs" / "figures"


def room() -> None:
    """Draw the room of the instrument door, from above and from the side."""
    drawn = views.scene_sketch(nlos.Scene.load(SCENES / "letter_concave.toml"))
    views.save(drawn, FIGURES / "door_instrument.png")


def letter() -> None:
    """Draw the exposure and the reconstruction of the camera door."""
    scene = nlos.Scene.load(SCENES / "letter_concave.toml").resized(64)
    result = nlos.simulate(scene, seed=1, reconstruct=True)
    drawn = Figure(figsize=(9.5, 3.6), layout="constrained")
    left, right = drawn.subplots(1, 2)
    scale = limits.object_scale(scene)
    views.image(result.image, object_scale=scale, axes=left)
    pitch = scale * result.image.pitch
    views.reconstruction(result.reconstruction, pitch=pitch, axes=(right,))
    left.set_title("camera image")
    right.set_title("reconstruction, mirror undone")
    views.save(drawn, FIGURES / "door_camera.png")


def capture() -> None:
    """Draw the streak and the letter of the transient door."""
    scene = nlos.Scene.load(SCENES / "transient_letter.toml")
    held = transient.render_scene(scene, tol=0.02)
    volume = transient.Volume.facing(held.sensor_points, (0.8, 1.2, 0.02))
    drawn = Figure(figsize=(11, 3.4), layout="constrained")
    axes = drawn.subplots(1, 3)
    views.transient(held, at=(2.1,), axes=axes[:2])
    views.volume(transient.phasor_image(held, volume, wl_mean=0.125), axes=axes[2])
    views.save(drawn, FIGURES / "door_transient.png")


if __name__ == "__main__":
    room()
    letter()
    capture()
