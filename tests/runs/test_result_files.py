"""A result's folder: the same bits come back, from the library's and the command line's alike."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import psf, scene
from nlosoptics.errors import SceneError
from nlosoptics.runs import result_files

RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def found(examples: Path) -> nlos.Result:
    """A run of few pixels, with what one run seldom has at once put in."""
    room = nlos.Scene.load(examples / "scenes" / "letter_flat.toml").resized(16)
    result = nlos.simulate(room, seed=2**64 - 1)
    wave = psf.Wavefront.from_zernike(
        {4: 1e-7, 7: 1 / 3e7},
        wavelength=6e-7,
        pupil_radius=5e-3,
        image_distance=-0.05,
        aperture=psf.Aperture.round(5e-3, 0.3, vanes=2, vane_width=1e-4),
    )
    smooth = {f.name: getattr(result.point_spread, f.name) for f in fields(result.point_spread)}
    field = psf.PointSpreadField(
        modes=np.asfortranarray(RNG.random((2, 5, 4))),
        weights=RNG.random((2, 3, 3)),
        across=RNG.random(3),
        up=RNG.random(3),
        pitch=1e-5,
        truncation_error=5e-324,
        error_estimate=np.nan,
    )
    return replace(
        result,
        wavefront=wave,
        point_spread=psf.RoughPointSpread(
            **smooth, coherent=RNG.random((4, 4)), rayleigh_parameter=1e-300
        ),
        field=field,
        errors={"point spread": np.inf, "field of point spreads": 0.1 + 0.2},
    )


def assert_same(one: Any, other: Any, place: str = "result") -> None:
    """Same types and bits; scenes by what they compute, their files lie elsewhere."""
    assert type(one) is type(other), place
    if isinstance(one, nlos.Scene):
        assert replace(one, hidden=other.hidden) == other
        assert one.hidden.reflectance.tobytes() == other.hidden.reflectance.tobytes()
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
        assert not other.flags.writeable, place
    elif is_dataclass(one):
        for entry in fields(one):
            pair = (getattr(noun, entry.name) for noun in (one, other))
            assert_same(*pair, f"{place}.{entry.name}")
    elif isinstance(one, dict | MappingProxyType):
        assert_same(list(one.items()), list(other.items()), place)
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), place
        for i, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{place}[{i}]")
    elif isinstance(one, float):
        assert np.float64(one).tobytes() == np.float64(other).tobytes(), place
    else:
        assert one == other, place


def test_a_result_comes_back_bit_for_bit(found: nlos.Result, tmp_path: Path) -> None:
    """Also from a copy of the folder elsewhere, and saved from there again."""
    found.save(tmp_path / "first")
    (tmp_path / "first").rename(tmp_path / "moved")
    again = nlos.load_result(tmp_path / "moved")
    assert_same(found, again)
    again.save(tmp_path / "second")
    assert_same(found, nlos.load_result(tmp_path / "second"))


def test_a_reconstruction_comes_back(found: nlos.Result, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from nlosoptics.inverse import Reconstruction

    answer = Reconstruction(
        object=RNG.random((16, 16)),
        physical_parameters={"gain": 1 / 3, "coefficients": RNG.random(3), "frames": 2},
        status="converged",
        score=1.01,
        history={"residual": RNG.random(7)},
        seconds=0.5,
    )
    full = replace(found, reconstruction=answer)
    full.save(tmp_path / "full")
    assert_same(full, nlos.load_result(tmp_path / "full"))
    tensor = replace(answer, object=torch.zeros(16, 16))
    with pytest.raises(SceneError, match=r"reconstruction.object is of type Tensor, .* store"):
        replace(found, reconstruction=tensor).save(tmp_path / "tensor")
    assert not (tmp_path / "tensor").exists()


def test_a_run_of_the_command_line_is_a_result(examples: Path, tmp_path: Path) -> None:
    pytest.importorskip("typer")
    pytest.importorskip("matplotlib")
    from typer.testing import CliRunner

    from nlosoptics.cli.program import app

    path = examples / "scenes" / "letter_flat.toml"
    words = ["run", str(path), "--size", "16", "--seed", "5", "--no-reconstruct"]
    answer = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "run")])
    assert answer.exit_code == 0, answer.output
    loaded = nlos.load_result(tmp_path / "run")
    # the memory that is free differs between two runs, and so would their budgets
    memory = loaded.plan.budget.memory
    here = nlos.simulate(nlos.Scene.load(path).resized(16), seed=5, memory=memory)
    assert set(loaded.timings) == set(here.timings)
    assert_same(replace(here, timings=loaded.timings), loaded)


def damaged(change: Any) -> Any:
    """Change of the tree in ``result.json``."""

    def apply(folder: Path) -> None:
        record = json.loads((folder / "result.json").read_text())
        change(record)
        (folder / "result.json").write_text(json.dumps(record))

    return apply


def cut(name: str, share: float) -> Any:
    """A file that was cut off."""

    def apply(folder: Path) -> None:
        held = (folder / name).read_bytes()
        (folder / name).write_bytes(held[: int(share * len(held))])

    return apply


def flipped(folder: Path) -> None:
    """One bit within the bytes of an array."""
    with np.load(folder / "image.npz") as file:
        signal = file["electrons"].tobytes()
    held = bytearray((folder / "image.npz").read_bytes())
    held[held.index(signal) + 100] ^= 1
    (folder / "image.npz").write_bytes(held)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (shutil.rmtree, "kept is missing; name a folder"),
        (cut("result.json", 0.5), "result.json is damaged .*; run the simulation again"),
        (cut("image.npz", 0.5), "image.npz is damaged .*; run the simulation again"),
        (flipped, "image.npz is damaged .*CRC.*; run the simulation again"),
        (
            lambda folder: (folder / "hidden_image.png").write_bytes(
                (folder / "hidden_image.png").read_bytes() + b" "
            ),
            "a file that it refers to was changed .*; run the simulation again",
        ),
        (damaged(lambda record: record.update(format=1)), "is in format 1, must be 2; read it"),
        (damaged(lambda record: record["result"].pop("seed")), "entry seed is missing or unknown"),
        (
            damaged(lambda record: record["result"].update(plan={"noun": ["Popen", {}]})),
            "cannot be read .*Popen",
        ),
        (
            damaged(lambda record: record["result"].update(plan={"array": ["../x", "y"]})),
            r"kept/x.npz is missing",
        ),
        (
            damaged(lambda record: record["result"]["wavefront"]["noun"][1].pop("u")),
            r"cannot be read .*'u'",
        ),
    ],
)
def test_damage_is_told_in_one_line(
    found: nlos.Result, tmp_path: Path, change: Any, told: str
) -> None:
    folder = tmp_path / "kept"
    found.save(folder)
    change(folder)
    with pytest.raises(SceneError, match=told) as error:
        nlos.load_result(folder)
    assert "\n" not in str(error.value)
    assert "kept" in str(error.value)


def test_a_save_that_fails_leaves_the_old_result(
    found: nlos.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found.save(tmp_path / "kept")

    def full(*args: Any, **kwargs: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(result_files.np, "savez", full)
    with pytest.raises(SceneError, match="kept: cannot be written .No space.*make room"):
        replace(found, seed=1).save(tmp_path / "kept")
    monkeypatch.undo()
    assert nlos.load_result(tmp_path / "kept").seed == found.seed
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_a_scene_of_functions_is_not_saved(found: nlos.Result, tmp_path: Path) -> None:
    wall = scene.CallableWall(
        lambda x, y: 0 * x, lambda x, y: (0 * x, 0 * y), max_height=1.0, max_curvature=1.0
    )
    with pytest.raises(SceneError, match=r"CallableWall cannot be written in a scene file"):
        replace(found, scene=replace(found.scene, wall=wall)).save(tmp_path / "kept")
    assert list(tmp_path.iterdir()) == []
