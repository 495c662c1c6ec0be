"""Print the kernels that a run of a letter seen by a flat wall loads, for `first_run.KERNELS`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from nlosoptics import Scene, simulate
from nlosoptics.kernels import compiling

SCENE = Path(__file__).parents[2] / "examples/scenes/letter_flat.toml"


def loaded() -> list[tuple[str, list[str]]]:
    """Return kernels and the types of their arguments in the order of a run."""
    found: dict[tuple[str, tuple[str, ...]], None] = {}
    load = compiling._Cache.load_overload

    def told(cache, sig, context):
        if not cache._function.__qualname__.endswith("_inner"):
            name = f"{cache._function.__module__}:{cache._function.__qualname__}"
            found[name, tuple(map(repr, sig))] = None
        return load(cache, sig, context)

    compiling._Cache.load_overload = told
    simulate(Scene.load(SCENE), reconstruct=True)
    return [(name, list(types)) for name, types in found]


if __name__ == "__main__":
    lines = ",\n".join(json.dumps(kernel) for kernel in loaded())
    sys.stdout.write(f"[\n{lines}\n]\n")
