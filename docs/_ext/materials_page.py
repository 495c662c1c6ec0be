"""The table of wall materials, from the library that scene files use."""

from pathlib import Path

from tables import table, write

from nlosoptics.scene import material_library
from nlosoptics.scene.parts.library import MaterialValue


def pages(target: Path) -> None:
    """Write the table and the list of sources into a folder."""
    write(target / "materials.md", materials())


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
            "<br>".join(cell(value) for value in material.values),
        )
        for material in material_library().values()
    ]
    listed = "".join(f"{number}. {source}\n" for source, number in sources.items())
    return f"{table(('name', 'surface', 'values, spread, basis'), body)}\n{listed}"
