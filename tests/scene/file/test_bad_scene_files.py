"""Every mistake in a scene file is one line that names file, key, value, limit and remedy."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
import trimesh

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.scene import Scene


@pytest.fixture
def folder(examples: Path, tmp_path: Path) -> Path:
    """A writable copy of the example scenes and what they name."""
    for part in ("scenes", "objects", "walls"):
        shutil.copytree(examples / part, tmp_path / part)
    return tmp_path / "scenes"


def message(folder: Path, *changes: tuple[str, str], scene: str = "letter_flat") -> str:
    """What loading an example says after its text is changed; the change must apply."""
    path = folder / f"{scene}.toml"
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        Scene.load(path)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"{path}: ")
    return line.removeprefix(f"{path}: ")


def expect(line: str, *parts: str) -> None:
    for part in parts:
        assert part in line, line


# key as it stands, what replaces it, and what the message must hold
WRONG = {
    "unit of a time for a length": (
        'wavelength = "632.8 nm"',
        'wavelength = "40 ms"',
        ("laser.wavelength", '"40 ms"', "is a time", "must be a length", '"632.8 nm"'),
    ),
    "length for a power": (
        'power = "5 mW"',
        'power = "5 mm"',
        ("laser.power", '"5 mm"', "is a length", "must be a power", '"5 mW"'),
    ),
    "length for an angle": (
        'incidence = "15 deg"',
        'incidence = "15 m"',
        ("laser.incidence", '"15 m"', "is a length", "must be an angle", '"15 deg"'),
    ),
    "bare number": (
        'beam_diameter = "3 mm"',
        "beam_diameter = 0.003",
        ("laser.beam_diameter", "0.003", "has no unit", "must be a length", '"3 mm"'),
    ),
    "number as text without unit": (
        'beam_diameter = "3 mm"',
        'beam_diameter = "3"',
        ("laser.beam_diameter", '"3"', "has no unit", '"3 mm"'),
    ),
    "unknown unit": (
        'distance = "1.2 m"',
        'distance = "1.2 furlong"',
        ("laser.distance", '"1.2 furlong"', "unknown unit 'furlong'", '"1.2 m"'),
    ),
    "not a quantity": (
        'distance = "1.2 m"',
        'distance = "far"',
        ("laser.distance", '"far"', "is not a length", '"1.2 m"'),
    ),
    "NaN with a unit": (
        'distance = "1.2 m"',
        'distance = "nan m"',
        ("laser.distance", '"nan m"', "is not finite", '"1.2 m"'),
    ),
    "infinite vector component": (
        'aim = ["0.64 m", "0 m", "0 m"]',
        'aim = ["inf m", "0 m", "0 m"]',
        ("laser.aim", "inf m", "is not finite"),
    ),
    "NaN number": (
        "albedo = 0.75",
        "albedo = nan",
        ("wall.material[0].albedo", "nan", "is not finite", "finite number"),
    ),
    "two components": (
        'aim = ["0.64 m", "0 m", "0 m"]',
        'aim = ["0.64 m", "0 m"]',
        ("laser.aim", "has 2 components", "must have 3", '["0 m", "0 m", "0 m"]'),
    ),
    "component without unit": (
        'aim = ["0.64 m", "0 m", "0 m"]',
        "aim = [0.64, 0, 0]",
        ("laser.aim", "0.64", "has no unit", '["0 m", "0 m", "0 m"]'),
    ),
    "misspelt key": (
        "wavelength =",
        "wavelenght =",
        ("laser.wavelenght", '"632.8 nm"', "unknown key", "did you mean wavelength?", "1 more"),
    ),
    "misspelt key of a wall": (
        "size = [",
        "sise = [",
        ("wall.sise", "unknown key", "did you mean size?"),
    ),
    "misspelt key of a lobe": (
        "albedo = 0.75",
        "albeto = 0.75",
        ("wall.material[0].albeto", "0.75", "did you mean albedo?"),
    ),
    "key like no other": (
        'power = "5 mW"',
        'power = "5 mW"\nzzz = 1',
        ("laser.zzz", "unknown key", "the keys here are wavelength, power"),
    ),
    "misspelt section": (
        "[hidden]\n",
        "[hiden]\n",
        ("hiden", "unknown key", "did you mean hidden?"),
    ),
    "missing key": (
        'wavelength = "632.8 nm"\n',
        "",
        ("laser.wavelength is missing", 'wavelength = "632.8 nm"'),
    ),
    "missing key of a hidden object": (
        'size = "0.7 m"\n',
        "",
        ("hidden.size is missing", "size = ["),
    ),
    "missing image": (
        'image = "../objects/F.png"\n',
        "",
        ("hidden.image is missing", 'image = "../objects/F.png"'),
    ),
    "missing laser position": (
        'distance = "1.2 m"',
        "",
        ("laser.position is missing", "distance", "incidence"),
    ),
    "unknown shape": (
        'shape = "flat"',
        'shape = "convav"',
        ("wall.shape", '"convav"', "must be one of flat, concave_sphere", "did you mean"),
    ),
    "missing shape": ('shape = "flat"\n', "", ("wall.shape is missing", 'shape = "flat"')),
    "unknown lobe": (
        'lobe = "oren_nayar"',
        'lobe = "orennayar"',
        ("wall.material[0].lobe", '"orennayar"', 'did you mean "oren_nayar"?'),
    ),
    "key of another shape": (
        'shape = "flat"',
        'shape = "flat"\nradius = "5 m"',
        ("wall.radius", "unknown key", "the keys here are shape, size, material"),
    ),
    "image and mesh": (
        'size = "0.7 m"\n',
        'mesh = "x.stl"\n',
        ("hidden.mesh and hidden.image are both given", "limit is one", "remove"),
    ),
    "negative size": (
        'size = "0.7 m"\n',
        'size = "-0.7 m"\n',
        ("hidden.size", "-0.7 m", "must be above 0 m"),
    ),
    "zero size": (
        'size = ["1.4 m", "1 m"]',
        'size = ["1.4 m", "0 m"]',
        ("wall.size[y]", "0 m", "must be above 0 m"),
    ),
    "negative exposure": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\nexposure = "-40 ms"',
        ("camera.exposure", "-0.04 s", "must be above 0 to 1e+18 s"),
    ),
    "wavelength of no light": (
        'wavelength = "632.8 nm"',
        'wavelength = "632.8 m"',
        ("laser.wavelength", "632.8 m", "1e-08 to 0.0001 m", "nanometres"),
    ),
    "grazing incidence": (
        'incidence = "15 deg"',
        'incidence = "90 deg"',
        ("laser.incidence", "1.5708 rad", "from 0 to 1.55334 rad", "0 deg to 89 deg"),
    ),
    "incidence from behind": (
        'incidence = "15 deg"',
        'incidence = "100 deg"',
        ("laser.incidence", "1.74533 rad", "from 0 to 1.55334 rad", "89 deg"),
    ),
    "albedo above one": (
        "albedo = 0.75",
        "albedo = 1.5",
        ("wall.material[0].albedo", "1.5", "must be from 0 to 1"),
    ),
    "albedos above one together": (
        "albedo = 0.75",
        "albedo = 0.99",
        ("wall.material: ", "1.04", "limit 1", "lower one"),
    ),
    "text for a number": (
        "albedo = 0.75",
        'albedo = "0.75"',
        ("wall.material[0].albedo", '"0.75"', "number", "for example 0.7"),
    ),
    "object behind the wall": (
        '"0 m", "1 m"]      # 1 m',
        '"0 m", "-1 m"]      # 1 m',
        ("hidden.position", "-1 m", "behind the wall", "must be above 0"),
    ),
    "object through the wall": (
        '"0 m", "1 m"]      # 1 m',
        '"0 m", "0.1 m"]\npitch = "90 deg"#',
        ("hidden.position", "0.1 m", "-0.25 m", "behind the wall", "move it"),
    ),
    "laser aimed past the wall's plane": (
        'aim = ["0.64 m", "0 m", "0 m"]',
        'aim = ["0.64 m", "0 m", "0.2 m"]',
        ("laser.aim", "0.2 m", "z = 0"),
    ),
    "laser position twice": (
        'distance = "1.2 m"',
        'position = ["1 m", "0 m", "1 m"]\ndistance = "1.2 m"',
        ("laser.distance and laser.position are both given", "give position, or"),
    ),
    "camera looking away": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\naim = ["0 m", "0 m", "2 m"]',
        ("camera.aim", "2.0", "looks away from the wall", "must be below"),
    ),
    "camera behind the wall": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\nposition = ["0 m", "0 m", "-2 m"]',
        ("camera.position", "-2 m", "behind the wall", "must be above 0"),
    ),
    "both focal length and field of view": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\nfocal_length = "50 mm"\nfield_of_view = "40 deg"',
        ("camera.field_of_view and camera.focal_length are both given", "remove"),
    ),
    "no stop": (
        'file = "camera_wu2024.toml"',
        'position = ["0 m", "0 m", "1 m"]\naim = ["0.1 m", "0 m", "0 m"]\nfocal_length = "50 mm"',
        ("camera.stop_diameter is missing", 'stop_diameter = "25 mm"'),
    ),
    "field of view of a fisheye": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\nfield_of_view = "190 deg"',
        ("camera.field_of_view", "3.31613 rad", "above 0 to 3 rad"),
    ),
    "binning that does not divide": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\nbinning = 7',
        ("camera.binning = 7", "does not divide", "(4096, 4096)", "common divisor"),
    ),
    "fraction of a pixel": (
        'file = "camera_wu2024.toml"',
        'file = "camera_wu2024.toml"\npixels = [512.5, 512]',
        ("camera.pixels[0]", "512.5", "integer", "for example [4096, 4096]"),
    ),
    "no camera file": (
        'file = "camera_wu2024.toml"',
        'file = "camera_x.toml"',
        ("camera.file", "camera_x.toml", "there is no file", "[camera] table"),
    ),
    "table for a value": (
        "[wall]\nshape",
        "[wall]\n[wall.size]\nshape",
        ("wall", "shape is missing"),
    ),
    "value for a table": (
        "[hidden.material]               # of white; chosen: foam\n"
        'lobe = "lambert"\nalbedo = 0.8\n',
        "material = 0.8\n",
        ("hidden.material", "0.8", "not a table"),
    ),
}


OCCLUDER = '[[occluder]]\nmesh = "../walls/concave_5m.obj"\n'
OCCLUDERS = {
    "missing mesh": (
        'scale = 2.0\n[[occluder]]\nyaw = "1 deg"\n',
        ("occluder[1].mesh is missing; add for example mesh = ",),
    ),
    "no file": (
        '[[occluder]]\nmesh = "none.stl"\n',
        ("occluder[1].mesh: there is no file", "none.stl", "give the path of a mesh"),
    ),
    "unknown key": (
        "skale = 2.0\n",
        ("occluder[0].skale = 2.0 is an unknown key; did you mean scale?",),
    ),
    "a material": (
        'material = "foam"\n',
        ('occluder[0].material = "foam" is not in the library', 'did you mean "foam board"?'),
    ),
    "a lobe": (
        'material = { lobe = "lambert", albedo = 1.5 }\n',
        ("occluder[0].material.albedo = 1.5 is out of range, must be from 0 to 1",),
    ),
    "no size": ("scale = 0.0\n", ("occluder[0].scale = 0 is out of range, must be above 0",)),
    "no unit": ("yaw = 10\n", ("occluder[0].yaw = 10", "has no unit", '"10 deg"')),
    "two components": (
        'position = ["0 m", "1 m"]\n',
        ("occluder[0].position", "has 2 components", "must have 3"),
    ),
    "behind the wall": (
        'position = ["0 m", "0 m", "-1 m"]\n',
        ("occluder[0].mesh reaches z = -0.9", "must be at least 0; move occluder.position"),
    ),
}

FLAT = 'shape = "flat"\nsize = ["1.4 m", "1 m"]'
RANDOM = (
    'shape = "random"\nheight_rms = "1 um"\ncorrelation_length = "90 mm"\npitch = "40 mm"\n'
    'size = "1.5 m"\n'
)
RANDOM_WALLS = {
    "negative roughness": (
        '"1 um"',
        '"-1 um"',
        ("wall.height_rms = -1e-06 m is out of range, must be at least 0",),
    ),
    "no pitch of a grid": (
        'pitch = "40 mm"\n',
        "",
        ("wall.pitch is missing; add for example", '"1 mm"'),
    ),
    "angle for a pitch": (
        'pitch = "40 mm"',
        'pitch = "40 deg"',
        ("wall.pitch", "is an angle", 'example "1 mm"'),
    ),
    "no width": ('size = "1.5 m"', 'size = "0 m"', ("wall.size[x] = 0 m", "must be above 0 m")),
    "seed below 0": (
        'size = "1.5 m"',
        'size = "1 m"\nseed = -1',
        ("wall.seed = -1", "from 0 to 18446744073709551615"),
    ),
    "seed of half a number": (
        'size = "1.5 m"',
        'size = "1 m"\nseed = 0.5',
        ("wall.seed = 0.5", "example 0"),
    ),
    "unknown autocorrelation": (
        'size = "1.5 m"',
        'size = "1 m"\nautocorrelation = "gauss"',
        ('wall.autocorrelation = "gauss"', "'gaussian' or 'exponential'"),
    ),
}
#: Changes of the example's text, and what the message must hold.
CASES = (
    {name: (((old, new),), parts) for name, (old, new, parts) in WRONG.items()}
    | {
        f"occluder: {name}": ((("[camera]", OCCLUDER + text + "[camera]"),), parts)
        for name, (text, parts) in OCCLUDERS.items()
    }
    | {
        f"random wall: {name}": (((FLAT, RANDOM.replace(old, new)),), parts)
        for name, (old, new, parts) in RANDOM_WALLS.items()
    }
    | {
        "several problems are counted": (
            (('power = "5 mW"', "power = 5"), ("albedo = 0.75", 'albedo = "x"')),
            ("laser.power = 5", "(and 1 more)"),
        ),
        "broken TOML names its line": (
            (('power = "5 mW"', 'power "5 mW"'),),
            ("not TOML", "line 9", "correct that line"),
        ),
        "image that is not there": (
            (("F.png", "Q.png"),),
            ("hidden.image", "there is no file", "Q.png", "give the path of an image"),
        ),
        "one occluder is still one of several": (
            (("[camera]", OCCLUDER.replace("[[occluder]]", "[occluder]") + "[camera]"),),
            ("occluder = {...} is one table; write [[occluder]] for each of them",),
        ),
        "object behind a hollow wall": (
            (
                ('shape = "flat"', 'shape = "concave_sphere"\nradius = "1 m"'),
                ('"0.54433 m", "0 m", "1 m"', '"0.54433 m", "0 m", "0.1 m"'),
            ),
            ("hidden.position", "z = 0.1 m, behind the wall", "there is 0.161", "; move it"),
        ),
    }
)


@pytest.mark.parametrize(("changes", "parts"), CASES.values(), ids=CASES.keys())
def test_wrong_text(
    folder: Path, changes: tuple[tuple[str, str], ...], parts: tuple[str, ...]
) -> None:
    expect(message(folder, *changes), *parts)


def test_missing_table(folder: Path) -> None:
    path = folder / "bare.toml"
    path.write_text("")
    with pytest.raises(SceneError, match=r"bare\.toml: the table \[laser\] is missing; add it"):
        Scene.load(path)


def test_missing_file(folder: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.toml: the scene file is missing; give the path"):
        Scene.load(folder / "none.toml")
    with pytest.raises(SceneError, match=r"the scene file is a folder; give the path"):
        Scene.load(folder)


def test_not_text(folder: Path) -> None:
    path = folder / "binary.toml"
    path.write_bytes(b"[laser]\npower = '\xff\xfe'\n")
    with pytest.raises(SceneError, match=r"binary\.toml: byte 17 is not UTF-8 text; give a TOML"):
        Scene.load(path)


def test_mistake_in_a_camera_file_names_that_file(folder: Path) -> None:
    path = folder / "camera_wu2024.toml"
    path.write_text(path.read_text().replace("binning", "bining"))
    with pytest.raises(SceneError) as caught:
        Scene.load(folder / "letter_flat.toml")
    assert str(caught.value).startswith(f"{path}: camera.bining = 8 is an unknown key")
    assert "did you mean binning?" in str(caught.value)


def test_camera_file_that_names_itself(folder: Path) -> None:
    path = folder / "camera_wu2024.toml"
    path.write_text('[camera]\nfile = "camera_wu2024.toml"\n')
    with pytest.raises(SceneError, match=r"camera\.file = 'camera_wu2024\.toml' leads back"):
        Scene.load(folder / "letter_flat.toml")


def test_image_that_is_no_image(folder: Path) -> None:
    (folder.parent / "objects" / "F.png").write_text("a letter")
    line = message(folder, ("F.png", "F.png"))
    expect(line, "hidden.image", "F.png is not an image", "give PNG")


def test_image_cut_short(folder: Path) -> None:
    picture = folder.parent / "objects" / "F.png"
    picture.write_bytes(picture.read_bytes()[:300])
    line = message(folder, ("F.png", "F.png"))
    expect(line, "hidden.image", "F.png is not an image", "give PNG")


def test_object_mesh_behind_the_wall(folder: Path) -> None:
    trimesh.creation.box((1, 1, 4)).export(folder / "box.stl")
    line = message(
        folder, ('image = "../objects/F.png"', 'mesh = "box.stl"'), ('size = "0.7 m"', "")
    )
    expect(line, "hidden.mesh", "z = -1 m", "behind the wall", "hidden.scale smaller")


MESHES = {
    "missing": (None, ("there is no file", "give the path of a mesh")),
    "empty": (b"", ("holds no triangles", "give a surface mesh")),
    "not a mesh": (b"\x00\x01 nothing", ("holds no triangles", "give a surface mesh")),
    "points only": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", ("holds no triangles", "give a surface mesh")),
    "a line": (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", ("has no area", "give a surface mesh")),
    "NaN": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", ("NaN or infinite", "repair the mesh")),
    "vertex out of range": (b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", ("is not a mesh", "give STL, OBJ")),
    "beside the origin": (
        b"v 1 1 0\nv 2 1 0\nv 1 2 0\nf 1 2 3\n",
        ("spans x 1 to 2 m", "must surround the origin"),
    ),
}


@pytest.mark.parametrize(("content", "parts"), MESHES.values(), ids=MESHES.keys())
def test_bad_wall_mesh(folder: Path, content: bytes | None, parts: tuple[str, ...]) -> None:
    path = folder.parent / "walls" / "concave_5m.obj"
    path.unlink() if content is None else path.write_bytes(content)
    expect(message(folder, ("[wall]", "[wall]"), scene="letter_mesh"), "wall.mesh", *parts)


def test_summand_of_a_wall(folder: Path) -> None:
    wave = '[[wall.terms]]\nshape = "wavy"\namplitude = "1 mm"\nperiod = '
    line = message(
        folder,
        ('shape = "flat"', 'shape = "sum"'),
        ("[[wall.material]]", wave + '"-1 m"\n[[wall.x]]'),
    )
    expect(
        line, "wall.x", "unknown key", "the keys here are shape, size, material, roughness, terms"
    )
    line = message(folder, ("[[wall.x]]", "[[wall.material]]"), scene="letter_flat")
    expect(line, "wall.terms[0].period", "-1 m", "must be above 0 m")


#: What replaces `model = "facets"`, the cell or the seed of letter_rough, and the message.
ROUGH = {
    "negative slope": (
        'cell = "1 mm"',
        'cell = "1 mm"\nslope_rms = "-2 mrad"',
        ("wall.roughness.slope_rms = -0.002 rad is out of range, must be from 0 to 1 rad",),
    ),
    "slope without a unit": (
        'cell = "1 mm"',
        'cell = "1 mm"\nslope_rms = nan',
        ("wall.roughness.slope_rms = NaN has no unit", '"2 mrad"'),
    ),
    "slope that is no number": (
        'cell = "1 mm"',
        'cell = "1 mm"\nslope_rms = "nan rad"',
        ("wall.roughness.slope_rms", "nan rad"),
    ),
    "slope above 1": (
        'cell = "1 mm"',
        'cell = "1 mm"\nslope_rms = "1.1 rad"',
        ("wall.roughness.slope_rms = 1.1 rad", "from 0 to 1 rad"),
    ),
    "another slope": (
        'cell = "1 mm"',
        'cell = "1 mm"\nslope_rms = "3 mrad"',
        ("mirror-like lobe of slope_rms = 0.002 rad", "has 0.003 rad", "or 0"),
    ),
    "no cell": ('cell = "1 mm"', "", ("wall.roughness.cell is missing", 'cell = "1 mm"')),
    "cell of zero": (
        'cell = "1 mm"',
        'cell = "0 mm"',
        ("wall.roughness.cell = 0 m is out of range, must be above 0 m",),
    ),
    "fraction as seed": (
        "seed = 1",
        "seed = 1.5",
        ("wall.roughness.seed = 1.5", "integer", "example 0"),
    ),
    "negative seed": ("seed = 1", "seed = -1", ("wall.roughness.seed = -1 is out of range",)),
    "unknown realisation": (
        "seed = 1",
        'realisation = "all"',
        ("wall.roughness.realisation", "'pattern' or 'mean'"),
    ),
    "unknown model": (
        'model = "facets"',
        'model = "facet"',
        ("wall.roughness.model", '"facet" is unknown', 'did you mean "facets"?'),
    ),
    "no model": ('model = "facets"', "", ("wall.roughness.model is missing", 'model = "facets"')),
    "unknown key": (
        "seed = 1",
        "cells = 1",
        ("wall.roughness.cells = 1 is an unknown key; did you mean cell?",),
    ),
    "two of Gaussian": (
        'model = "facets"\ncell = "1 mm"',
        'model = "gaussian"\ncorrelation_length = "1 mm"\nheight_rms = "1 um"\n'
        'slope_rms = "1 mrad"',
        ("wall.roughness.height_rms and slope_rms are both given",),
    ),
    "steep Gaussian": (
        'model = "facets"\ncell = "1 mm"',
        'model = "gaussian"\ncorrelation_length = "1 mm"\nheight_rms = "1 mm"',
        ("wall.roughness.height_rms = 0.001 m", "slope rms 1.41421, limit 1"),
    ),
    "lobe without slope": (
        'slope_rms = "2 mrad"',
        'slope_rms = "0 rad"',
        ("wall.roughness.slope_rms is missing", "no mirror-like lobe", '"2 mrad"'),
    ),
    "GGX": (
        'slope_rms = "2 mrad"',
        'slope_rms = "2 mrad"\ndistribution = "ggx"',
        ("GGX lobe of slope_rms = 0.002 rad", 'distribution = "beckmann"'),
    ),
    "no heights": (
        'model = "facets"\ncell = "1 mm"\nseed = 1',
        'model = "height_map"\nheights = "none.npy"\npitch = "1 mm"',
        ("wall.roughness.heights: there is no file", "none.npy"),
    ),
    "no table": (
        '[wall.roughness]\nmodel = "facets"\ncell = "1 mm"\nseed = 1',
        "[wall.x]",
        ("wall.x",),
    ),
}


@pytest.mark.parametrize("name", ROUGH)
def test_wrong_roughness(name: str, folder: Path) -> None:
    path = folder / "letter_rough.toml"
    lines = (line.partition("#")[0].rstrip() for line in path.read_text().splitlines())
    path.write_text("\n".join(line for line in lines if line))
    old, new, parts = ROUGH[name]
    expect(message(folder, (old, new), scene="letter_rough"), *parts)


def test_roughness_of_a_summand(folder: Path) -> None:
    rough = (
        '[[wall.terms]]\nshape = "flat"\n[wall.terms.roughness]\nmodel = "facets"\ncell = "1 mm"'
    )
    line = message(
        folder,
        ('shape = "flat"', 'shape = "sum"'),
        ("[hidden]", rough + "\n[hidden]"),
    )
    expect(line, "wall.terms[0].roughness belongs to a summand", "move it to wall.roughness")


def test_random_wall_on_a_coarse_grid_names_the_file_too(folder: Path) -> None:
    path = folder / "letter_flat.toml"
    coarse = RANDOM.replace('"40 mm"', '"50 mm"')
    path.write_text(path.read_text().replace('shape = "flat"\nsize = ["1.4 m", "1 m"]', coarse))
    with pytest.raises(SamplingError) as caught:
        Scene.load(path)
    expect(str(caught.value), f"{path}: wall.correlation_length = 0.09 m", "at most 0.045 m")


def test_saving_nowhere(examples: Path, tmp_path: Path) -> None:
    scene = Scene.load(examples / "scenes" / "letter_flat.toml")
    with pytest.raises(SceneError, match=r"there is no folder .*none; make it first"):
        scene.save(tmp_path / "none" / "scene.toml")
    (tmp_path / "taken").mkdir()
    with pytest.raises(SceneError, match=r"taken is a folder; name a file"):
        scene.save(tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a = " + "{b = " * 3000, "nested too deeply"),
        (f"[{'.'.join('a' * 100_000)}]", "limit 4,000,000 and 20,000 in a line"),
        ("# x\n" * 1_100_000, "limit 4,000,000"),
    ],
)
def test_texts_that_exhaust_a_parser_are_refused_at_once(text, words, tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(text)
    began = time.process_time()
    with pytest.raises(SceneError, match=words):
        Scene.load(file)
    assert time.process_time() - began < 2.0  # hours without the limits


@pytest.mark.parametrize("name", ["a\\u0000b.png", "x" * 300 + ".png", "x" * 20_000])
@pytest.mark.parametrize("key", ["hidden.image", "camera.file"])
def test_texts_that_no_system_takes_as_a_path_are_told(name, key, examples):
    change = {key: name.replace("\\u0000", "\0")}
    with pytest.raises(SceneError, match="cannot be the path of a file") as caught:
        Scene.load(examples / "scenes" / "letter_flat.toml", change)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("suffix", "text", "words"),
    [
        (".obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "vertices without three coordinates"),
        (".obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "is not a mesh"),
        (".ply", "3 0 1 7", "between vertices 0 and 7, limit 0 to 2"),
        (".ply", "3 0 1 -1", "between vertices -1 and 1, limit 0 to 2"),
    ],
)
def test_meshes_with_impossible_triangles_are_told(suffix, text, words, examples, tmp_path):
    if suffix == ".ply":
        head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        head += "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
        text = f"{head}end_header\n0 0 0\n1 0 0\n0 1 0\n{text}\n"
    mesh = tmp_path / f"wall{suffix}"
    mesh.write_text(text)
    with pytest.raises(SceneError, match=words) as caught:
        Scene.load(examples / "scenes" / "letter_mesh.toml", {"wall.mesh": str(mesh)})
    assert "\n" not in str(caught.value)
