"""Wrong inputs of a stranger over all commands: one line each, with the cure."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nlosoptics.cli import main

#: Command, and words that its one line must have, with the cure behind the bar.
WRONG = """
frobnicate | No such command; nlosoptics --help shows how
analyze room | Did you mean 'analyse'?
new | FILE; nlosoptics new --help shows how
new hut | does not end in .toml; give a name that does
new room.toml | exists and is kept; another folder
new hut.toml --kind corer | 'corer'; 'corner', 'design', 'photo'
new nowhere/hut.toml | no folder; create it first
new folder | folder does not end in .toml; give a name that does
new /proc/hut.toml | takes no file; use another
plan | SCENE; nlosoptics plan --help shows how
plan cornr | 'cornr' names no example, and no file; did you mean corner?
plan nowhere.toml | missing; give the path of a TOML file
plan grey.png | not UTF-8; give a TOML file
plan text.toml | not TOML; correct that line
plan design --set wall.radius=2 | no unit; write for example "1.2 m"
plan design --set wall.radus=2m | unknown key; did you mean radius?
plan design --set wall.radius | no value; write for example wall.radius=2m
plan design --set wall.material=whitebord | not in the library; did you mean "whiteboard"
plan design --set laser.wavelength=532m | out of range; was it given in nanometres?
plan design --set camera.binning=3 | does not divide; use a common divisor
plan design --set camera.position=1,2 | not a list; write for example
plan design --set foo.bar=3 | foo; unknown key; the keys here are laser, wall
plan room.toml | the table [wall] is missing; add it
plan design --tol nan | tol = nan; give a finite number
plan design --size 100 | 100 does not divide; sizes that do: 16, 32, 64
plan design --tol 2 | tol = 2; from 1e-12 to 0.1
plan design --tol tight | --tol; valid number; nlosoptics plan --help shows how
run design --siz 64 | No such option: --siz; --size
run design --seed -1 | --seed; greater than or equal to 0
run design --seed 18446744073709551616 | --seed; 18446744073709551615
run design --size 64 --max-seconds 0.01 | limit max_seconds = 0.01; leave the reconstruction out
run design --memory 0.001 | limit 0.001 GiB; camera.binning
run design --out room.toml | is a file; name a folder
run design --out . | did not write; name another folder
run design --out folder/a/b | no folder; create it first
run corner_room --size 64 | occluder[1].material reflects light; remove the material
view design --out room.jpg | does not end in .png; give a name that does
view design --colour red --out room.png | 'red' is not one of; 'bounces'
trace design --wavelengths-nm red | 'red' is not a list of numbers; give for example
trace design --size 64 --t-start 1 | delta_t and n_bins missing; give t_start, delta_t and n_bins
trace design --n-rays 0 | n_rays = 0; from 1 to
analyse shadows | no mirror-like lobe; add a table [[wall.material]]
analyse design --point 0,0,-1 | z = -1 m, behind the wall; must be above 0
analyse design --set camera.f_number=0 | camera.f_number = 0; above 0
analyse design --point 1,2 | 2 components; give three
feasibility design --out x.jpg | does not end in .png; give a name that does
reconstruct grey.png | --scene; nlosoptics reconstruct --help shows how
reconstruct nowhere.png --scene design | no file nowhere.png; give the path
reconstruct empty.png --scene design | no readable image; give PNG or TIFF
reconstruct grey.png --scene design | 128 in every pixel; check the file
reconstruct noise.png --scene design --method tvv | 'tvv' is unknown; tv, wiener
reconstruct noise.png --scene design --defocus 0,a | '0,a' is not a list; for example '0, 0.5'
reconstruct noise.png --scene design --method burst | speckle; add [wall.roughness], or use tv
reconstruct noise.png --scene design --method tv --defocus 1 | defocus; leave it out
reconstruct noise.png --scene design --corners '1,2 3,4' | 4 numbers; give four positions
reconstruct noise.png --scene design --channel rgb | three images; give a colour or 'grey'
reconstruct noise.png --scene design --resume | no noise/checkpoint.npz; run without --resume
deblur grey.png | one of --psf, --disc and --gaussian
deblur grey.png --disc -3 | --disc = -3; from 0.1 to 100 pixels
deblur noise.png --disc 3 --channel purple | 'purple' is unknown; red, green, blue
deblur noise.png --disc 3 --gaussian 2 | several options; one of --psf, --disc and --gaussian
deblur noise.png --disc 3 --gamma 2.2 | gamma = '2.2'; one of linear, srgb
deblur noise.png --disc 9 --crop 0,0,9,9 | 19 x 19 pixels, the image 9 x 9; use a larger image
deblur noise.png --psf black.png | has the sum 0, must be positive; give its light
deblur noise.png --disc 3 --flat grey.png | 32 x 32; take both with the same frame
deblur noise.png --disc 3 --crop 1,2 | crop; width
transient design | no [transient]; add the table
transient transient --quantity foo | 'foo' is unknown; irradiance, radiance
transient transient --jitter-ps 3 | --photons; give it for
image nowhere.hdf5 | missing; give the path
image grey.png | neither HDF5; give a capture in such a format
image cube.npy --near 1parsec | '1parsec'; give such as 4.8mm or 16ps
image cube.npy | does not state; give --side; --bin
image cube.npy --side 1m --bin 0 --pairing confocal | --bin = 0 m; above 0
image cube.npy --side 1m --bin 16ps --axes x,y,q | 'x,y,q'; give such as
image cube.npy --side 1m --bin 16ps --pairing confocal --gate-start 9m | no bin; widen the gate
image folder | is a folder; give the path
image cube.npy --method fk --camera direct_light | --camera; not for --method fk; leave it out
image cube.npy --method lct --wl-sigma 3cm | --wl-sigma; not for --method lct; leave it out
image cube.npy --method phasr | 'phasr' is unknown; phasor, fk, lct
report folder | no result.json; name the output folder
report nowhere | missing; name the output folder
materials whitebord | not in the library; did you mean "whiteboard"
warmup cornr | 'cornr' names no example, and no file; did you mean corner?
study seeds.toml | optimise.seed = 3; did you mean seed? Write it at the top
study nothing.toml | the design is empty; add [axes]
study axis.toml | camera.f_numbr = 2; did you mean f_number?
study figure.toml | 'strell' is unknown; strehl
study nowhere.toml | cannot be read; give the path of a TOML file
study red_a_letter | did you mean read_a_letter?
study status folder | no results of a study; run the study first
study plot folder strehl | no results of a study; run the study first
study export folder table.txt | does not end in .csv; give a name that does
"""


for part in ("matplotlib", "torch", "xarray", "zarr"):  # without which they say what to install
    pytest.importorskip(part)
CASES = [
    case for case in WRONG.strip().splitlines() if "/proc" not in case or Path("/proc").is_dir()
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Work in a folder with files of several kinds."""
    work, before = tmp_path_factory.mktemp("wrong"), Path.cwd()
    os.chdir(work)
    Path("folder").mkdir()
    Path("empty.png").touch()
    Path("room.toml").write_text("# mine")
    Path("text.toml").write_text("[wall\n")
    scene = f'scene = "{before / "examples/scenes/design.toml"}"\nfigures = ["strehl"]\n'
    Path("seeds.toml").write_text(
        scene + '[optimise]\nmethod = "nsga-ii"\nseed = 3\nevaluations = 150\n'
        'objectives = [{ figure = "strehl", goal = "maximise" }]\n'
        'variables = { "camera.f_number" = { from = 2, to = 8 } }\n'
    )
    Path("nothing.toml").write_text(scene)
    Path("axis.toml").write_text(scene + "axes = { 'camera.f_numbr' = [2, 4] }")
    Path("figure.toml").write_text(
        scene.replace("strehl", "strell") + "axes = { 'wall.radius' = ['1 m'] }"
    )
    Image.new("L", (32, 32), 128).save("grey.png")
    Image.new("L", (9, 9), 0).save("black.png")
    noise = np.random.default_rng(0).integers(0, 255, (512, 512), np.uint8)
    Image.fromarray(noise).save("noise.png")
    np.save("cube.npy", np.ones((4, 4, 8)))
    yield work
    os.chdir(before)


@pytest.mark.parametrize("case", CASES)
def test_wrong_input_is_one_line_with_the_cure(case: str, folder: Path, capsys) -> None:
    command, _, expected = case.partition(" | ")
    before = sorted(folder.rglob("*"))
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(command))
    said = capsys.readouterr()
    assert (ended.value.code, said.out) == (2, "")
    assert said.err.startswith("nlosoptics: ")
    assert said.err.count("\n") == 1
    assert [words for words in expected.split("; ") if words not in said.err] == []
    assert sorted(folder.rglob("*")) == before
