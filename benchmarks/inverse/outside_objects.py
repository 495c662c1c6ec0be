"""Pictures of kinds that the network of wall proposals was not trained with.

    python benchmarks/inverse/outside_objects.py FOLDER
    python benchmarks/inverse/evidence.py --frames 1 --rms 0.5 --walls 305 306 \
        --folder FOLDER --objects cat coast coins head horse phantom portrait print retina writing \
        --json benchmarks/results/evidence_outside.jsonl

Photographs, a map, printed and written text, medical images: sample data of scikit-image and
matplotlib, of which the former must be installed. Each is 256 pixels wide or high in the middle of
a black frame of 512 x 512.
"""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import numpy as np
from matplotlib import cbook
from PIL import Image
from skimage import color, data

SIDE, FRAME = 256, 512


def pictures():
    """Light of each picture, [row, column], by its name."""
    page, text = data.page(), data.text()
    with gzip.open(cbook.get_sample_data("s1045.ima.gz", asfileobj=False)) as file:
        head = np.frombuffer(file.read(), np.uint16).reshape(256, 256)
    with np.load(cbook.get_sample_data("topobathy.npz", asfileobj=False)) as relief:
        coast = relief["topo"][::-1] > 0
    return {
        "portrait": color.rgb2gray(data.astronaut()[:220, 130:320]),
        "cat": color.rgb2gray(data.chelsea()),
        "coins": data.coins()[150:, :260],
        "retina": color.rgb2gray(data.retina()),
        "phantom": data.shepp_logan_phantom(),
        "head": head,
        "horse": ~data.horse(),
        "coast": coast,
        "print": 255.0 - page[60:160, 20:190],
        "writing": text[:, :240],
    }


def framed(picture):
    """Scaled to 0 to 255, dark background removed, in the middle of a black frame."""
    light = np.asarray(picture, dtype=float)
    dark, bright = np.percentile(light, [2.0, 99.5])
    grey = np.clip((light - dark) / (bright - dark), 0.0, 1.0)
    image = Image.fromarray((255 * grey).astype(np.uint8))
    scale = SIDE / max(image.size)
    image = image.resize([max(1, round(side * scale)) for side in image.size])
    frame = Image.new("L", (FRAME, FRAME))
    frame.paste(image, tuple((FRAME - side) // 2 for side in image.size))
    return frame


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures().items():
        framed(picture).save(folder / f"{name}.png")
