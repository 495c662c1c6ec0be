"""Tables of a scene file as pydantic models: their keys and the form of each value.

The dataclasses built from the tables check the limits and hold the defaults.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    Discriminator,
    Field,
    PlainValidator,
    Tag,
    TypeAdapter,
)

from ...errors import SceneError
from ..parts.library import lobe_tables, material_library
from .quantities import (
    AngleText,
    LengthText,
    PowerText,
    RateText,
    SizeText,
    Table,
    TimeText,
    VectorText,
    key,
)

#: A valid value of each key, shown by errors and editors.
EXAMPLES: dict[str, Any] = {
    "wavelength": "632.8 nm",
    "power": "5 mW",
    "beam_diameter": "3 mm",
    "position": ["0.5 m", "0 m", "1 m"],
    "aim": ["0 m", "0 m", "0 m"],
    "distance": "1.2 m",
    "incidence": "15 deg",
    "azimuth": "0 deg",
    "independent_patterns": 1,
    "shape": "flat",
    "size": ["0.4 m", "0.4 m"],
    "radius": "5 m",
    "axis": "y",
    "amplitude": "0.1 mm",
    "period": "250 mm",
    "phase": "90 deg",
    "direction": "0 deg",
    "terms": [{"shape": "wavy", "amplitude": "0.1 mm", "period": "250 mm"}],
    "mesh": "../walls/concave_5m.obj",
    "heights": "../walls/measured.npy",
    "wall.pitch": "1 mm",
    "height_rms": "1 um",
    "correlation_length": "10 mm",
    "autocorrelation": "gaussian",
    "seed": 0,
    "scale": 1.0,
    "roughness": {"model": "facets", "cell": "1 mm", "slope_rms": "2 mrad"},
    "roughness.model": "facets",
    "roughness.slope_rms": "2 mrad",
    "roughness.height_rms": "1 um",
    "roughness.correlation_length": "1 mm",
    "roughness.pitch": "0.5 mm",
    "roughness.heights": "../walls/measured.npy",
    "cell": "1 mm",
    "realisation": "pattern",
    "material": "whiteboard",
    "lobe": "lambert",
    "albedo": 0.7,
    "wavelengths": ["450 nm", "650 nm"],
    "values": [0.2, 0.6],
    "slope_rms": "0.3 rad",
    "model": "full",
    "normalised": True,
    "alpha": 0.4,
    "variant": "bounded",
    "reflectance": 0.05,
    "distribution": "ggx",
    "index": [1.5, 0.0],
    "image": "../objects/F.png",
    "yaw": "10 deg",
    "pitch": "10 deg",
    "roll": "10 deg",
    "file": "camera_wu2024.toml",
    "focal_length": "50 mm",
    "field_of_view": "40 deg",
    "sensor_width": "36.864 mm",
    "stop_diameter": "25 mm",
    "f_number": 2.0,
    "pixel_pitch": "9 um",
    "pixels": [4096, 4096],
    "binning": 8,
    "exposure": "40 ms",
    "quantum_efficiency": 0.7,
    "transmission": 0.9,
    "full_well": 70e3,
    "read_noise": 3.6,
    "dark_current": "0.1 / s",
    "bit_depth": 16,
    "focus_distance": "2 m",
    "glare_fraction": 0.0,
    "field_stop": "40 deg",
    "side": "2 m",
    "count": 32,
    "scan": "single",
    "delta_t": "1 cm",
    "n_bins": 200,
    "t_start": "1.8 m",
    "max_bounces": 3,
    "wl_mean": "25 cm",
    "near": "0.8 m",
    "far": "1.2 m",
    "step": "2 cm",
}


def example(section: str, key: str) -> Any:
    """Return a valid value of ``key`` in the table ``section``; None for an unknown key."""
    return EXAMPLES.get(f"{section}.{key}", EXAMPLES.get(key))


# Values of the keys that decide the kind of a table, with the tags of their classes. Tags contain a
# colon, so that they cannot be confused with keys in a pydantic error location.
LOBES = {name: f"lobe:{name}" for name in ("lambert", "oren_nayar", "specular", "ward")}
SHAPES = {
    "flat": "wall:flat",
    "concave_sphere": "wall:sphere",
    "convex_sphere": "wall:sphere",
    "concave_cylinder": "wall:cylinder",
    "convex_cylinder": "wall:cylinder",
    "wavy": "wall:wavy",
    "sum": "wall:sum",
    "mesh": "wall:mesh",
    "height_map": "wall:height_map",
    "random": "wall:random",
}


ROUGHNESSES = {name: f"roughness:{name}" for name in ("facets", "gaussian", "height_map")}


class SpectrumTable(Table):
    """Albedo or reflectance that depends on the wavelength."""

    wavelengths: list[LengthText]
    values: list[float]


#: An albedo is one number, or a table of them.
AlbedoTable = Annotated[
    Annotated[float, Tag("albedo:one")] | Annotated[SpectrumTable, Tag("albedo:spectrum")],
    Discriminator(
        lambda v: "albedo:spectrum" if isinstance(v, dict | SpectrumTable) else "albedo:one"
    ),
]


class LambertTable(Table):
    """Ideal diffuse reflection."""

    lobe: Literal["lambert"]
    albedo: AlbedoTable


class OrenNayarTable(Table):
    """Diffuse reflection of a rough surface (Oren and Nayar)."""

    lobe: Literal["oren_nayar"]
    albedo: AlbedoTable
    slope_rms: AngleText
    model: Literal["fit", "full"] | None = None
    normalised: bool | None = None


class SpecularTable(Table):
    """Glossy or mirror-like reflection by microfacets."""

    lobe: Literal["specular"]
    reflectance: AlbedoTable
    slope_rms: AngleText
    distribution: Literal["beckmann", "ggx"] | None = None
    index: list[float] | None = Field(
        None,
        min_length=2,
        max_length=2,
        description="Refractive index [n, k], for the polarisation of reflected light.",
    )


class WardTable(Table):
    """Glossy reflection after Ward, centred on the mirror direction."""

    lobe: Literal["ward"]
    albedo: AlbedoTable
    alpha: float
    variant: Literal["1992", "duer", "bounded"] | None = None


def _choose(key: str, tables: dict[str, str]) -> Discriminator:
    """Return a discriminator of tables by the value of ``key``; ``tables`` maps values to tags."""

    def tag(table: Any) -> str | None:
        """Return the tag of a table's class; None if the key is missing or unknown."""
        value = table.get(key) if isinstance(table, dict) else getattr(table, key, None)
        return tables.get(value) if isinstance(value, str) else None

    return Discriminator(tag)


LobeTable = Annotated[
    Annotated[LambertTable, Tag("lobe:lambert")]
    | Annotated[OrenNayarTable, Tag("lobe:oren_nayar")]
    | Annotated[SpecularTable, Tag("lobe:specular")]
    | Annotated[WardTable, Tag("lobe:ward")],
    _choose("lobe", LOBES),
]


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
MaterialTable = Annotated[
    Annotated[LobeTable, Tag("material:one")]
    | Annotated[list[LobeTable], Tag("material:sum"), Field(min_length=1)]
    | Annotated[
        list[Any],
        PlainValidator(_from_library),
        _LibraryNames(),
        Tag("material:named"),
    ],
    Discriminator(_material_tag),
]


class LaserTable(Table):
    """Laser. Its place is given by position, or by distance and incidence as seen from aim."""

    wavelength: LengthText
    power: PowerText
    beam_diameter: LengthText
    aim: VectorText | None = None
    position: VectorText | None = None
    distance: LengthText | None = key(
        "Distance from aim to the start of the beam. With incidence it replaces position."
    )
    incidence: AngleText | None = key(
        "Angle between beam and normal of the plane z = 0. With distance it replaces position."
    )
    azimuth: AngleText | None = key(
        "Direction from aim to the laser in the plane z = 0, from +x toward +y; by default 0."
    )
    independent_patterns: int | None = None


class _RoughnessTable(Table):
    """Keys common to all kinds of roughness."""

    seed: int | None = None
    realisation: Literal["pattern", "mean"] | None = None


class FacetsTable(_RoughnessTable):
    """Plane random facets. The default of slope_rms is the slope of the wall's mirror-like lobe."""

    model: Literal["facets"]
    cell: LengthText
    slope_rms: AngleText | None = None


class GaussianTable(_RoughnessTable):
    """Smooth random heights. The default of slope_rms is that of the wall's mirror-like lobe."""

    model: Literal["gaussian"]
    correlation_length: LengthText
    height_rms: LengthText | None = None
    slope_rms: AngleText | None = key(
        "Rms slope along each axis, sqrt(2) height_rms / correlation_length; replaces height_rms."
    )


class RoughMapTable(Table):
    """Measured heights in m on a grid, from an .npy file."""

    model: Literal["height_map"]
    heights: str
    pitch: LengthText
    realisation: Literal["pattern", "mean"] | None = None


RoughnessTable = Annotated[
    Annotated[FacetsTable, Tag("roughness:facets")]
    | Annotated[GaussianTable, Tag("roughness:gaussian")]
    | Annotated[RoughMapTable, Tag("roughness:height_map")],
    _choose("model", ROUGHNESSES),
]


class _WallTable(Table):
    """Keys common to most walls."""

    shape: str
    size: SizeText | None = None
    material: MaterialTable | None = None
    roughness: RoughnessTable | None = None


class FlatTable(_WallTable):
    """Flat wall."""

    shape: Literal["flat"]


class SphereTable(_WallTable):
    """Spherical wall."""

    shape: Literal["concave_sphere", "convex_sphere"]
    radius: LengthText


class CylinderTable(_WallTable):
    """Cylindrical wall."""

    shape: Literal["concave_cylinder", "convex_cylinder"]
    radius: LengthText
    axis: Literal["x", "y"] | None = None


class WavyTable(_WallTable):
    """Wall whose height is a sine wave along one direction."""

    shape: Literal["wavy"]
    amplitude: LengthText
    period: LengthText
    phase: AngleText | None = None
    direction: AngleText | None = None


class SumTable(_WallTable):
    """Wall whose height is the sum of the heights of several walls."""

    shape: Literal["sum"]
    terms: list[WallTable] = Field(min_length=1)


class MeshWallTable(Table):
    """Wall from a mesh file, which also determines its size."""

    shape: Literal["mesh"]
    mesh: str
    scale: float | None = None
    smooth: bool | None = None
    material: MaterialTable | None = None
    roughness: RoughnessTable | None = None


class HeightMapTable(_WallTable):
    """Wall that interpolates heights in m on a grid, from an .npy file."""

    shape: Literal["height_map"]
    heights: str
    pitch: LengthText


class RandomTable(Table):
    """Wall with random heights."""

    shape: Literal["random"]
    height_rms: LengthText
    correlation_length: LengthText
    size: SizeText
    pitch: LengthText
    autocorrelation: Literal["gaussian", "exponential"] | None = None
    seed: int | None = None
    material: MaterialTable | None = None
    roughness: RoughnessTable | None = None


WallTable = Annotated[
    Annotated[FlatTable, Tag("wall:flat")]
    | Annotated[SphereTable, Tag("wall:sphere")]
    | Annotated[CylinderTable, Tag("wall:cylinder")]
    | Annotated[WavyTable, Tag("wall:wavy")]
    | Annotated[SumTable, Tag("wall:sum")]
    | Annotated[MeshWallTable, Tag("wall:mesh")]
    | Annotated[HeightMapTable, Tag("wall:height_map")]
    | Annotated[RandomTable, Tag("wall:random")],
    _choose("shape", SHAPES),
]


class _HiddenTable(Table):
    """Keys common to hidden objects."""

    position: VectorText
    yaw: AngleText | None = None
    pitch: AngleText | None = None
    roll: AngleText | None = None
    material: MaterialTable | None = None


class PictureTable(_HiddenTable):
    """Hidden image on a plane."""

    image: str
    size: SizeText


class MeshObjectTable(_HiddenTable):
    """Hidden triangle mesh."""

    mesh: str
    scale: float | None = None


def _hidden_tag(table: Any) -> str:
    """Return the tag of a hidden object's table, decided by the keys image and mesh."""
    if isinstance(table, MeshObjectTable):
        return "hidden:mesh"
    if isinstance(table, dict) and "mesh" in table:
        return "hidden:both" if "image" in table else "hidden:mesh"
    return "hidden:picture"


class OccluderTable(Table):
    """Triangle mesh that blocks light. It is black unless a material is given."""

    mesh: str
    scale: float | None = None
    position: VectorText | None = None
    yaw: AngleText | None = None
    pitch: AngleText | None = None
    roll: AngleText | None = None
    material: MaterialTable | None = None


HiddenTable = Annotated[
    Annotated[PictureTable, Tag("hidden:picture")] | Annotated[MeshObjectTable, Tag("hidden:mesh")],
    Discriminator(_hidden_tag),
]


class CameraTable(Table):
    """Camera. Its keys override those of the table [camera] in the given file, if any."""

    file: str | None = key("Path of a file with a table [camera], whose keys are the defaults.")
    position: VectorText | None = None
    aim: VectorText | None = None
    focal_length: LengthText | None = None
    field_of_view: AngleText | None = key(
        "Full angle that the lens sees across the width sensor_width; replaces focal_length."
    )
    sensor_width: LengthText | None = key(
        "Width on the sensor to which field_of_view refers; by default pixels[0] * pixel_pitch."
    )
    stop_diameter: LengthText | None = None
    f_number: float | None = key(
        "F-number of the lens, focal_length / stop_diameter. It replaces stop_diameter."
    )
    pixel_pitch: LengthText | None = None
    pixels: list[int] | None = Field(None, min_length=2, max_length=2)
    binning: int | None = None
    exposure: TimeText | None = None
    quantum_efficiency: float | None = None
    transmission: float | None = None
    full_well: float | None = None
    read_noise: float | None = None
    dark_current: RateText | None = None
    bit_depth: int | None = None
    focus_distance: LengthText | None = None
    glare_fraction: float | None = None
    field_stop: AngleText | None = None


class CameraFile(Table):
    """File that contains only a camera."""

    camera: CameraTable


class TransientTable(Table):
    """Time-resolved capture. Times are optical path lengths: time times the speed of light."""

    side: LengthText
    count: int
    delta_t: LengthText
    n_bins: int
    scan: Literal["single", "confocal", "exhaustive"] | None = None
    t_start: LengthText | None = None
    max_bounces: int | None = None
    wl_mean: LengthText | None = None
    near: LengthText | None = None
    far: LengthText | None = None
    step: LengthText | None = None


class SceneFile(Table):
    """Scene file."""

    laser: LaserTable
    wall: WallTable
    hidden: HiddenTable
    camera: CameraTable
    occluder: list[OccluderTable] | None = None
    transient: TransientTable | None = None


SumTable.model_rebuild()

#: Table class for each element of a pydantic error location.
OWNERS: dict[str, type[Table]] = {
    "laser": LaserTable,
    "camera": CameraTable,
    "occluder": OccluderTable,
    "transient": TransientTable,
    "albedo:spectrum": SpectrumTable,
    "lobe:lambert": LambertTable,
    "lobe:oren_nayar": OrenNayarTable,
    "lobe:specular": SpecularTable,
    "lobe:ward": WardTable,
    "wall:flat": FlatTable,
    "wall:sphere": SphereTable,
    "wall:cylinder": CylinderTable,
    "wall:wavy": WavyTable,
    "wall:sum": SumTable,
    "wall:mesh": MeshWallTable,
    "wall:height_map": HeightMapTable,
    "wall:random": RandomTable,
    "roughness:facets": FacetsTable,
    "roughness:gaussian": GaussianTable,
    "roughness:height_map": RoughMapTable,
    "hidden:picture": PictureTable,
    "hidden:mesh": MeshObjectTable,
}
#: Elements of a pydantic error location that are not keys.
TAGS = {*OWNERS, "albedo:one", "material:one", "material:sum", "material:named"} - {
    "laser",
    "camera",
    "occluder",
    "transient",
}
