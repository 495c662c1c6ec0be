"""Tables of a scene file as pydantic models, made from the constructors of the parts.

The annotations of a constructor are the keys of its table: a float with a dimension is written with
its unit. The constructors check the limits and hold the defaults.
"""

from __future__ import annotations

import functools
import inspect
import operator
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PlainSerializer,
    PlainValidator,
    Tag,
    TypeAdapter,
    ValidationInfo,
    WithJsonSchema,
    create_model,
)

from ..._checks import Vector, counted
from ...errors import SceneError
from ..parts._quantities import Kind
from ..parts.burst import Burst
from ..parts.camera import Camera
from ..parts.hidden import MeshObject, PlanarObject
from ..parts.laser import Laser
from ..parts.library import LOBE_CLASSES, lobe_tables, material_library
from ..parts.materials import Material
from ..parts.occluders import Occluder
from ..parts.spectrum import Spectrum
from ..parts.transient_scan import TransientScan
from ..walls.analytic import ConcaveWall, ConvexWall, FlatWall, SumWall, WavyWall
from ..walls.height_maps import HeightMapWall
from ..walls.mesh_walls import MeshWall
from ..walls.relief import FacetWall, GaussianWall
from ..walls.roughness import WallRoughness
from .units import parse, written

#: Keys whose values are names of files.
FILES = ("image", "mesh", "heights")


class Table(BaseModel):
    """Base class of tables: unknown keys are errors, and strings are not read as numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    #: Constructor of the part, and arguments that the kind of the table determines.
    source: ClassVar[Callable[..., Any]]
    fixed: ClassVar[Mapping[str, Any]]


def _quantity(kind: Kind, count: int | None = None) -> Any:
    """Return the annotation of a quantity, or of a list of ``count`` quantities."""

    def one(text: object, info: ValidationInfo) -> float:
        si = (info.context or {}).get("si") and isinstance(text, int | float)
        return parse(written(text, kind) if si else text, kind)  # type: ignore[arg-type]

    def read(text: object, info: ValidationInfo) -> Any:
        if count is None:
            return one(text, info)
        if not isinstance(text, list):
            raise ValueError(f"is not a list; write for example {[kind.example] * count}")
        if len(text) != count:
            raise ValueError(f"has {counted(len(text), 'component')}, must have {count}")
        return tuple(one(component, info) for component in text)

    def write(value: Any) -> Any:
        several = isinstance(value, tuple | list)
        return [written(one, kind) for one in value] if several else written(value, kind)

    schema: dict[str, Any] = {
        "type": "string",
        "pattern": r"^\s*[+-]?(\d[\d_]*\.?\d*|\.\d+)([eE][+-]?\d+)?\s*[^\d\s].*$",
        "description": f"{kind.title} with its unit",
        "examples": [kind.example],
    }
    if count is not None:
        schema = {"type": "array", "items": schema, "minItems": count, "maxItems": count}
    return Annotated[Any, PlainValidator(read), PlainSerializer(write), WithJsonSchema(schema)]


def _listed(value: object) -> str:
    """Return the tag of a width, or of a width and a height."""
    return "size:pair" if isinstance(value, list | tuple) else "size:one"


def _pair_of(form: Any) -> Any:
    return Annotated[list[form], Field(min_length=2, max_length=2)]


def _form(key: str, hint: Any) -> Any:
    """Return how a file writes the value of a parameter with an annotation."""
    options = [option for option in get_args(hint) if option is not type(None)]
    if key in FILES:
        return str
    if key == "size":
        pair, one = _quantity(Kind.LENGTH, 2), _quantity(Kind.LENGTH)
        both = Annotated[pair, Tag("size:pair")] | Annotated[one, Tag("size:one")]  # type: ignore[valid-type]
        return Annotated[both, Discriminator(_listed)]
    if key == "index":  # n + ik
        return _pair_of(float)
    if hint is Material:
        return MaterialTable
    if Spectrum in options:
        return AlbedoTable
    if hint == Vector:
        return _quantity(Kind.LENGTH, 3)
    if get_origin(hint) is Annotated:
        (note,) = hint.__metadata__
        return _quantity(note) if isinstance(note, Kind) else Literal[tuple(note)]
    if get_origin(hint) is tuple:
        inner = _form(key, options[0])
        return list[inner] if options[1] is ... else _pair_of(inner)  # type: ignore[valid-type]
    if type(None) in get_args(hint):
        return _form(key, options[0])
    return hint


def notes_of(source: Any) -> dict[str, str]:
    """Return the description of each parameter of a numpydoc docstring, in one line.

    References such as [1]_ and the marks of code are left out.
    """
    notes: dict[str, str] = {}
    names: list[str] = []
    _, _, section = (inspect.getdoc(source) or "").partition("Parameters\n----------\n")
    for line in section.splitlines():
        if line.startswith("---"):
            break
        if line and not line.startswith(" "):
            names = line.partition(" : ")[0].strip().lstrip("*").split(", ")
        elif line:
            for name in names:
                notes[name] = f"{notes.get(name, '')} {line.strip()}".strip()
    return {name: re.sub(r" \[\d+\]_|``?", "", note) for name, note in notes.items()}


def _table(
    source: Callable[..., Any],
    own: Mapping[str, tuple[Any, str]] | None = None,
    *,
    kind: tuple[str, str] | None = None,
    without: tuple[str, ...] = (),
    optional: tuple[str, ...] = (),
    name: str = "",
    **fixed: Any,
) -> type[Table]:
    """Return the table of the parameters of a class or function."""
    hints = get_type_hints(source, include_extras=True)
    settings: Any = getattr(source, "__dataclass_params__", None)
    if settings is not None and not settings.init:  # its own constructor
        hints |= get_type_hints(source.__init__, include_extras=True)
    notes = notes_of(source)
    fields: dict[str, Any] = {}
    if kind is not None:
        fields[kind[0]] = (Literal[kind[1]], ...)
    for key, parameter in inspect.signature(source).parameters.items():
        if key in (*without, *fixed) or parameter.kind is parameter.VAR_POSITIONAL:
            continue
        form, note = _form(key, hints[key]), notes.get(key)
        if parameter.default is parameter.empty and key not in optional:
            fields[key] = (form, Field(description=note))
        else:
            fields[key] = (form | None, Field(None, description=note))
    for key, (form, note) in (own or {}).items():
        fields[key] = (form | None, Field(None, description=note))
    title = (inspect.getdoc(source) or "").partition("\n")[0]
    options: Any = {"__base__": Table, "__doc__": title, **fields}
    model: type[Table] = create_model(name or source.__name__, **options)
    model.source, model.fixed = source, fixed
    return model


def _choice(section: str, key: str, tables: Mapping[str, type[Table]]) -> Any:
    """Return the annotation of a table whose class follows from the value of ``key``."""
    tags = {value: f"{section}:{value}" for value in tables}
    OWNERS.update({tags[value]: table for value, table in tables.items()})

    def tag(table: Any) -> str | None:
        value = table.get(key) if isinstance(table, dict) else getattr(table, key, None)
        return tags.get(value) if isinstance(value, str) else None

    members = tuple(Annotated[table, Tag(tags[value])] for value, table in tables.items())
    return Annotated[functools.reduce(operator.or_, members), Discriminator(tag)]


#: Table of each kind of a part, by the tags in the locations of pydantic's errors. A tag contains
#: a colon, so that it cannot be confused with a key.
OWNERS: dict[str, type[Table]] = {}
SpectrumTable = _table(Spectrum, without=("wavelength",))
OWNERS["albedo:spectrum"] = SpectrumTable
AlbedoTable = Annotated[
    Annotated[float, Tag("albedo:one")] | Annotated[SpectrumTable, Tag("albedo:spectrum")],  # type: ignore[valid-type]
    Discriminator(lambda v: f"albedo:{'spectrum' if isinstance(v, dict | Table) else 'one'}"),
]
LOBES = {
    lobe: _table(source, kind=("lobe", lobe), without=("spectrum",))
    for lobe, source in LOBE_CLASSES.items()
}
LobeTable: Any = _choice("lobe", "lobe", LOBES)


def _from_library(name: str) -> list[Any]:
    """Return the lobe tables of a named material."""
    try:
        return TypeAdapter(list[LobeTable]).validate_python(lobe_tables(name))
    except SceneError as error:
        # the message begins with the name, which the caller shows with its key
        raise ValueError(str(error).removeprefix(f"{name!r} ")) from None


class _LibraryNames:
    """JSON schema of the library's names, read when a schema is printed."""

    def __get_pydantic_json_schema__(self, *_: Any) -> dict[str, Any]:
        return {"type": "string", "enum": list(material_library())}


def _material_tag(value: object) -> str:
    kind = "sum" if isinstance(value, list) else "named" if isinstance(value, str) else "one"
    return f"material:{kind}"


#: A single table is one lobe, an array of tables a sum of lobes, and a text a name of the library.
MaterialTable: Any = Annotated[
    Annotated[LobeTable, Tag("material:one")]
    | Annotated[list[LobeTable], Tag("material:sum"), Field(min_length=1)]
    | Annotated[list[Any], PlainValidator(_from_library), _LibraryNames(), Tag("material:named")],
    Discriminator(_material_tag),
]
_REALISATION = {"realisation": (Literal["pattern", "mean"], notes_of(WallRoughness)["realisation"])}
_SLOPE = {
    "slope_rms": (
        _quantity(Kind.ANGLE),
        "Rms slope along each axis, sqrt(2) height_rms / correlation_length; replaces height_rms. "
        "By default that of the wall's mirror-like lobe.",
    )
}
ROUGHNESSES = {
    "facets": _table(
        FacetWall,
        _REALISATION,
        kind=("model", "facets"),
        without=("size",),
        optional=("slope_rms",),
    ),
    "gaussian": _table(
        GaussianWall,
        _REALISATION | _SLOPE,
        kind=("model", "gaussian"),
        without=("size",),
        optional=("height_rms",),
    ),
    "height_map": _table(
        HeightMapWall,
        _REALISATION,
        kind=("model", "height_map"),
        without=("size",),
        name="RoughHeightMap",
    ),
}
_SURFACE = {
    "material": (
        MaterialTable,
        "Bidirectional reflectance of the wall: one lobe (a table), a sum of lobes (an array of "
        "tables), or the name of a material of the library. By default matt paint of albedo 0.7 "
        "with a smooth mirror-like lobe of reflectance 0.05.",
    ),
    "roughness": (
        _choice("roughness", "model", ROUGHNESSES),
        "Random or measured heights that are added to the wall. They determine the slope of its "
        "mirror-like lobes. By default no heights are added.",
    ),
}


def _wall(value: str, source: Callable[..., Any], /, **options: Any) -> type[Table]:
    return _table(source, _SURFACE, kind=("shape", value), **options)


SHAPES = {
    "flat": _wall("flat", FlatWall),
    **{
        f"{bend}_{shape}": _wall(
            f"{bend}_{shape}",
            source,
            name=f"{source.__name__}_{shape}",
            without=("axis",) if shape == "sphere" else (),
            shape=shape,
        )
        for bend, source in (("concave", ConcaveWall), ("convex", ConvexWall))
        for shape in ("sphere", "cylinder")
    },
    "wavy": _wall("wavy", WavyWall),
    "sum": _table(
        SumWall,
        _SURFACE | {"terms": (list["WallTable"], notes_of(SumWall)["terms"])},
        kind=("shape", "sum"),
    ),
    "mesh": _wall("mesh", MeshWall),
    "height_map": _wall("height_map", HeightMapWall),
    "random": _wall("random", HeightMapWall.random, name="RandomWall"),
}
WallTable: Any = _choice("wall", "shape", SHAPES)
SHAPES["sum"].model_rebuild(_types_namespace={"WallTable": WallTable})
PictureTable: Any = _table(PlanarObject, optional=("image",))
MeshTable: Any = _table(MeshObject)
OWNERS |= {"hidden:picture": PictureTable, "hidden:mesh": MeshTable}


def _hidden_tag(table: Any) -> str:
    """Return the tag of a hidden object's table, decided by the keys image and mesh."""
    keys = table if isinstance(table, dict) else type(table).model_fields
    if "mesh" in keys:
        return "hidden:both" if "image" in keys else "hidden:mesh"
    return "hidden:picture"


HiddenTable: Any = Annotated[
    Annotated[PictureTable, Tag("hidden:picture")] | Annotated[MeshTable, Tag("hidden:mesh")],
    Discriminator(_hidden_tag),
]
LaserTable: Any = _table(
    Laser,
    {
        "distance": (
            _quantity(Kind.LENGTH),
            "Distance from aim to the start of the beam. With incidence it replaces position.",
        ),
        "incidence": (
            _quantity(Kind.ANGLE),
            "Angle between beam and normal of the plane z = 0. With distance it replaces position.",
        ),
        "azimuth": (
            _quantity(Kind.ANGLE),
            "Direction from aim to the laser in the plane z = 0, from +x toward +y; by default 0.",
        ),
    },
    optional=("position",),
)
CameraTable: Any = _table(
    Camera,
    {
        "file": (str, "Path of a file with a table [camera], whose keys are the defaults."),
        "field_of_view": (
            _quantity(Kind.ANGLE),
            "Full angle that the lens sees across the width sensor_width; replaces focal_length.",
        ),
        "sensor_width": (
            _quantity(Kind.LENGTH),
            "Width on the sensor to which field_of_view refers; by default pixels[0] * "
            "pixel_pitch.",
        ),
        "f_number": (
            float,
            "F-number of the lens, focal_length / stop_diameter. It replaces stop_diameter.",
        ),
    },
    optional=("position", "aim", "focal_length", "stop_diameter"),
)
OccluderTable: Any = _table(Occluder)
TransientTable: Any = _table(TransientScan)
BurstTable: Any = _table(Burst)
#: Tables of a scene file that are parts of the same name and need no other table.
OPTIONAL: Mapping[str, Any] = {
    "transient": TransientTable,
    "burst": BurstTable,
}


class AmbientTable(Table):
    """Light of the room that reaches wall and hidden object without the laser."""

    irradiance: _quantity(Kind.IRRADIANCE) = Field(  # type: ignore[valid-type]
        description="Irradiance of wall and hidden object, 0 to 1e18 W/m^2."
    )


class CameraFile(Table):
    """File that contains only a camera."""

    camera: CameraTable


class SceneFile(Table):
    """Scene file."""

    laser: LaserTable | None = None
    wall: WallTable
    hidden: HiddenTable
    camera: CameraTable
    occluder: list[OccluderTable] | None = None
    transient: TransientTable | None = None
    burst: BurstTable | None = None
    ambient: AmbientTable | None = None


OWNERS |= {
    "laser": LaserTable,
    "camera": CameraTable,
    "occluder": OccluderTable,
    "ambient": AmbientTable,
    **OPTIONAL,
}
