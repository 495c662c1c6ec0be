"""The table of wall materials, from the library that scene files use."""

from pathlib import Path

from tables import table, write

from nlosoptics.scene import material_library
from nlosoptics.scene.parts.library import MaterialValue
from nlosoptics.scene.parts.materials import Material


def pages(target: Path) -> None:
    """Write the table and the list of sources into a folder."""
    write(target / "materials.md", materials())


def blur(material: Material) -> str:
    """Return the rms width to which the sharpest mirror-like lobe spreads a point 1 m away."""
    slopes = [lobe.slope_rms for lobe in material.mirror_lobes]
    return f"{2000 * min(slopes):.3g} mm" if slopes else "no image"


def materials() -> str:
    """Return a row for each material and a numbered list of the sources."""
    sources: dict[str, int] = {}

    def cell(value: MaterialValue) -> str:
        number = sources.setdefault(value.source, len(sources) + 1)
        unit = f" {value.unit}" if value.unit else ""
        spread = f"{value.low:.3g} to {value.high:.3g}"
        return f"{value.key} {value.value:.3g}{unit} ({spread}), {value.basis} [{number}]"

    body = [
        (
            f"`{material.name}`",
            f"{material.what}. {material.note}".strip(),
            blur(material.material),
            "<br>".join(cell(value) for value in material.values),
        )
        for material in material_library().values()
    ]
    listed = "".join(f"{number}. {source}\n" for source, number in sources.items())
    return f"{table(('name', 'surface', 'blur at 1 m', 'values, spread, basis'), body)}\n{listed}"
