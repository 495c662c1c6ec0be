"""Make the README's first picture anew: ``python docs/readme_figure.py``."""

from pathlib import Path

import nlosoptics as nlos
from nlosoptics import views

ROOT = Path(__file__).parents[1]

if __name__ == "__main__":
    scene = nlos.Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml")
    result = nlos.simulate(scene, seed=0, reconstruct=True)
    truth = result.image.ideal / result.image.ideal.max()
    drawn = views.reconstruction(result.reconstruction, truth=truth)
    views.save(drawn, ROOT / "docs" / "figures" / "letter_flat.png")
