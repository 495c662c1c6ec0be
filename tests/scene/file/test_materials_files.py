"""Lobes in scene files: every option is read, written back, and refused when it is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from nlosoptics.errors import SceneError
from nlosoptics.scene import Lambert, Scene, SpecularMicrofacet, SumMaterial, Ward
from nlosoptics.scene.file.scene_file import save_scene

LOBES = {
    'lobe = "ward"\nalbedo = 0.2\nalpha = 0.4': Ward(0.2, 0.4),
    'lobe = "ward"\nalbedo = 0.2\nalpha = 1e-3\nvariant = "duer"': Ward(0.2, 1e-3, variant="duer"),
    'lobe = "ward"\nalbedo = 1.0\nalpha = 1.0\nvariant = "bounded"': Ward(
        1.0, 1.0, variant="bounded"
    ),
    'lobe = "specular"\nreflectance = 0.05\nslope_rms = "20 mrad"\ndistribution = "ggx"': (
        SpecularMicrofacet(0.05, 0.02, distribution="ggx")
    ),
    'lobe = "specular"\nreflectance = 0.05\nslope_rms = "20 mrad"\ndistribution = "beckmann"': (
        SpecularMicrofacet(0.05, 0.02)
    ),
}


def with_hidden_material(examples: Path, folder: Path, lobe: str) -> Path:
    """A copy of an example whose hidden object has one lobe; its picture is made absolute."""
    text = (examples / "scenes" / "letter_flat.toml").read_text()
    head, _, rest = text.partition("[hidden.material]")
    _, bracket, tail = rest.partition("\n[")
    text = f"{head}[hidden.material]\n{lobe}\n{bracket}{tail}"
    path = folder / "scene.toml"
    path.write_text(
        text.replace('"../', f'"{examples.as_posix()}/').replace(
            'file = "camera', f'file = "{(examples / "scenes").as_posix()}/camera'
        )
    )
    return path


@pytest.mark.parametrize("lobe", LOBES)
def test_lobes_are_read(lobe: str, examples: Path, tmp_path: Path) -> None:
    assert Scene.load(with_hidden_material(examples, tmp_path, lobe)).hidden.material == LOBES[lobe]


@pytest.mark.parametrize(
    "material",
    [
        *LOBES.values(),
        SumMaterial(Lambert(0.3), Ward(1 / 3, 0.1 + 0.2), SpecularMicrofacet(0.1, 0.3)),
    ],
    ids=repr,
)
def test_lobes_round_trip_exactly(material, examples: Path, tmp_path: Path) -> None:
    scene = Scene.load(examples / "scenes" / "letter_flat.toml")
    scene = Scene(scene.laser, scene.wall, scene.hidden, scene.camera, wall_material=material)
    save_scene(scene, tmp_path / "again.toml")
    assert Scene.load(tmp_path / "again.toml") == scene


@pytest.mark.parametrize(
    ("lobe", "words"),
    [
        (
            'lobe = "ward"\nalbedo = 0.2',
            ("hidden.material.alpha is missing; add it",),
        ),
        (
            'lobe = "ward"\nalbedo = 0.2\nalpha = 3.0',
            ("hidden.material.alpha = 3 is out of range", "to 1"),
        ),
        (
            'lobe = "ward"\nalbedo = 0.2\nalpha = 0.3\nvariant = "phong"',
            ("hidden.material.variant", '"phong"', "'1992', 'duer' or 'bounded'"),
        ),
        (
            'lobe = "ward"\nalbedo = 0.2\nalpha = 0.3\ndistribution = "ggx"',
            ("hidden.material.distribution", "unknown key", "lobe, albedo, alpha, variant"),
        ),
        (
            'lobe = "specular"\nreflectance = 0.2\nslope_rms = "0.1 rad"\ndistribution = "gxx"',
            ("hidden.material.distribution", '"gxx"', "'beckmann' or 'ggx'"),
        ),
        ('lobe = "wards"', ("hidden.material.lobe", '"wards"', 'did you mean "ward"?')),
    ],
)
def test_wrong_lobes(lobe: str, words, examples: Path, tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        Scene.load(with_hidden_material(examples, tmp_path, lobe))
    line = str(caught.value)
    assert "\n" not in line
    for word in words:
        assert word in line, line
