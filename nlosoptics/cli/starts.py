"""Command new."""

from __future__ import annotations

import re
import shlex
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .shell import Debug, app, check_file, errors_told


class Kind(StrEnum):
    """Example from which a new scene file starts."""

    CORNER = "corner"
    DESIGN = "design"
    PHOTO = "photo"
    SHADOWS = "shadows"
    TRANSIENT = "transient"


@app.command("new", short_help="Write a scene file to start from.")
def new_command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Scene file to write, such as room.toml.")
    ],
    kind: Annotated[
        Kind,
        typer.Option(
            help="corner: a chart around a corner; design: a lens and a curved wall to analyse; "
            "photo: photographs of a wall and an unknown object; shadows: a matt wall and a disc "
            "that casts shadows; transient: a time-resolved capture."
        ),
    ] = Kind.CORNER,
    debug: Debug = False,
) -> None:
    """Write a scene file in which every value has a comment, with the pictures that it names.

    The file can be used at once. Change its values to your own. Existing files are kept.

    Example: nlosoptics new room.toml --kind design
    """
    with errors_told(debug):
        from .._whole_files import write_whole
        from ..errors import SceneError
        from ..scene.examples import example_file

        check_file(file, ".toml", option="FILE")
        template = example_file(kind.value)
        text = template.read_text(encoding="utf-8").removeprefix("#:schema ./scene.schema.json\n")
        pictures = {
            file.parent / name: (template.parent / "../objects" / name).read_bytes()
            for name in sorted(set(re.findall(r"\.\./objects/([\w.]+)", text)))
        }
        for path in (file, *pictures):
            if path.exists() and (path == file or path.read_bytes() != pictures[path]):
                raise SceneError(f"{path} exists and is kept; name a file in another folder")
        typed = shlex.quote(str(file))
        folder = typed.removesuffix(file.name) if typed == str(file) else ""
        text = text.replace("SCENE", typed)
        steps = re.findall(r"^# Next: (.*)$", text, re.MULTILINE)
        write_whole({**pictures, file: text.replace("../objects/", "").encode()})
        typer.echo(f"written: {', '.join(map(str, (file, *pictures)))}; next:")
        for step in steps:
            typer.echo(f"  {step.replace('../objects/', folder)}")
