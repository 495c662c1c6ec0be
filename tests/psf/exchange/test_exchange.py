"""Pupils exported to POPPY and prysm and imported again, against images by these tools."""

from __future__ import annotations

import math
import re
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import MissingExtraError, SamplingError, SceneError

WAVELENGTH, DISTANCE, RADIUS = 632.8e-9, 0.5, 5e-3
ARCSEC = math.radians(1 / 3600)


@pytest.fixture
def poppy(peer):
    return peer("poppy")


@pytest.fixture
def fits(peer):
    return peer("astropy.io.fits")


@pytest.fixture
def propagation(peer):
    return peer("prysm.propagation")


def aberrated(samples, waves, **changes):
    """A grid wave of Noll coefficients in waves."""
    return psf.Wavefront.from_zernike(
        {j: w * WAVELENGTH for j, w in waves.items()},
        **{
            "wavelength": WAVELENGTH,
            "pupil_radius": RADIUS,
            "image_distance": DISTANCE,
            "nodes": "grid",
            "samples": samples,
            **changes,
        },
    )


def letter(samples):
    """An F, upright with y up, off the centre: no flip, turn or transposition leaves it alone."""
    grid = aberrated(samples, {})
    f = np.zeros_like(grid.u)
    n = samples
    f[n // 8 : 7 * n // 8, n // 4 : n // 3] = 1.0
    f[3 * n // 4 : 7 * n // 8, n // 4 : 3 * n // 4] = 1.0
    f[n // 2 : 5 * n // 8, n // 4 : n // 2] = 0.5
    return psf.Wavefront.from_map(
        # no symmetry here either
        WAVELENGTH * (40 * grid.u + 90 * grid.v + 3e3 * grid.u**2),
        f,
        wavelength=WAVELENGTH,
        pupil_pitch=grid.pupil_pitch,
        image_distance=DISTANCE,
    )


def paths(folder):
    return {"opd": folder / "opd.fits", "amplitude": folder / "amplitude.fits"}


def image_by_poppy(poppy, files, pitch, side):
    """POPPY's own image of the files, by its matrix transform, over its peak."""
    optics = poppy.OpticalSystem(oversample=1)
    optics.add_pupil(
        poppy.FITSOpticalElement(transmission=str(files["amplitude"]), opd=str(files["opd"]))
    )
    optics.add_detector(pixelscale=pitch / DISTANCE / ARCSEC, fov_pixels=side)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        image = optics.calc_psf(wavelength=WAVELENGTH)[0].data
    return np.asarray(image / image.max(), dtype=np.float64)


def image_by_prysm(propagation, pupil, pitch, side):
    """Prysm's own image of a pupil, by its matrix transform, over its peak."""
    wave = propagation.Wavefront.from_amp_and_phase(*pupil)
    image = wave.focus_fixed_sampling(1e3 * DISTANCE, 1e6 * pitch, side).intensity.data
    return image / image.max()


def image_here(wave, pitch, side):
    image = psf.point_spread(
        wave, method="mdft", pitch=pitch, shape=side, normalisation="ideal-peak", tol=1.0
    ).intensity
    return image / image.max()


def whole_cells(wave):
    """The same field with every sample standing for a whole cell, as other tools have it."""
    return psf.Wavefront.from_map(
        wave.aberration,
        wave.amplitude * wave.weights / wave.pupil_pitch**2,
        wavelength=wave.wavelength,
        pupil_pitch=wave.pupil_pitch,
        image_distance=wave.image_distance,
        pupil_radius=wave.pupil_radius,
    )


@pytest.mark.parametrize("axis", ["u", "v"])
@pytest.mark.parametrize("samples", [64, 65])
def test_tilt_moves_the_spot_as_here(poppy, propagation, tmp_path, axis, samples):
    """W = a u lands at x = +a d, and W = a v at y = +a d, rows upward, by each of the tools."""
    pitch = WAVELENGTH * DISTANCE / (2 * RADIUS) / 2
    flat = whole_cells(aberrated(samples, {}))
    slope = 5 * pitch / DISTANCE
    wave = replace(flat, aberration=slope * (flat.u if axis == "u" else flat.v))
    psf.write_poppy(wave, **paths(tmp_path))
    images = {
        "here": image_here(wave, pitch, 31),
        "poppy": image_by_poppy(poppy, paths(tmp_path), pitch, 31),
        "prysm": image_by_prysm(propagation, psf.to_prysm(wave), pitch, 31),
    }
    expected = (15, 20) if axis == "u" else (20, 15)
    for image in images.values():
        assert np.unravel_index(image.argmax(), image.shape) == expected


@pytest.mark.parametrize("samples", [64, 65])
@pytest.mark.parametrize("kind", ["coma and astigmatism", "letter"])
def test_images_are_those_of_the_tools(poppy, propagation, tmp_path, kind, samples):
    """The same field by three matrix transforms; nothing is interpolated on the way."""
    wave = (
        letter(samples)
        if kind == "letter"
        else whole_cells(aberrated(samples, {3: 0.2, 5: 0.08, 6: -0.05, 7: 0.06, 8: 0.11}))
    )
    pitch, side = WAVELENGTH * DISTANCE / (2 * RADIUS) / 3, 41
    here = image_here(wave, pitch, side)
    psf.write_poppy(wave, **paths(tmp_path))
    # all three are sums in float64 of some 1e3 terms, with phases of up to 1e2 rad
    assert image_by_prysm(propagation, psf.to_prysm(wave), pitch, side) == approx(here, abs=1e-13)
    assert image_by_poppy(poppy, paths(tmp_path), pitch, side) == approx(here, abs=1e-13)
    # nothing in these images is symmetric
    for other in (here[::-1], here[:, ::-1], here[::-1, ::-1], here.T):
        assert np.abs(other - here).max() > 0.05


def test_image_behind_the_pupil_is_turned(poppy, tmp_path):
    """With d below 0 an angle leads to the other side: W = a u to x = a d still."""
    wave = replace(letter(65), image_distance=-DISTANCE)
    pitch = WAVELENGTH * DISTANCE / (2 * RADIUS) / 3
    psf.write_poppy(wave, **paths(tmp_path))
    theirs = image_by_poppy(poppy, paths(tmp_path), pitch, 41)
    # sums in float64, as above
    assert image_here(wave, pitch, 41)[::-1, ::-1] == approx(theirs, abs=1e-13)


def test_letter_is_written_as_it_stands(fits, tmp_path):
    """Rows are v from the lowest, columns u: an even array gets one dark row and column on top."""
    wave = letter(64)
    psf.write_poppy(wave, **paths(tmp_path))
    with fits.open(tmp_path / "amplitude.fits") as units:
        found, header = np.array(units[0].data), units[0].header
    assert found.shape == (65, 65)
    assert np.array_equal(found[:64, :64], wave.amplitude)
    assert not found[64].any()
    assert not found[:, 64].any()
    assert header["PUPLSCAL"] == approx(wave.pupil_pitch, rel=1e-15)
    with fits.open(tmp_path / "opd.fits") as units:
        assert np.array_equal(-units[0].data[:64, :64], wave.aberration)
        assert units[0].header["BUNIT"] == "meter"
    pupil = psf.to_prysm(wave)
    assert np.array_equal(pupil.amplitude, wave.amplitude)
    assert pupil.phase == approx(1e9 * wave.aberration, rel=1e-15)
    assert (pupil.wavelength, pupil.dx) == approx((0.6328, 1e3 * wave.pupil_pitch), rel=1e-15)


@pytest.mark.parametrize("samples", [64, 65])
def test_poppy_files_come_back(fits, tmp_path, samples):
    removed = psf.Removed(piston=1.23e-4, tilt=(0.1, -0.2), defocus=0.7)
    wave = replace(letter(samples), removed=removed, image_distance=-0.3)
    psf.write_poppy(wave, **paths(tmp_path))
    back = psf.read_poppy(**paths(tmp_path))
    inside = (slice(0, samples),) * 2
    # two roundings of the pitch
    for name in ("u", "v", "weights"):
        assert getattr(back, name)[inside] == approx(getattr(wave, name), rel=1e-15, abs=1e-18)
    for name in ("aberration", "amplitude"):
        assert np.array_equal(getattr(back, name)[inside], getattr(wave, name))
    for name in ("wavelength", "image_distance", "pupil_radius", "obscuration"):
        assert getattr(back, name) == approx(getattr(wave, name), rel=1e-15)
    assert back.removed.tilt == approx(removed.tilt, rel=1e-15)
    assert (back.removed.piston, back.removed.defocus) == approx((1.23e-4, 0.7), rel=1e-15)
    assert back.layout == "grid"
    # what is given counts before what the file says
    assert psf.read_poppy(**paths(tmp_path), wavelength=1e-6).wavelength == 1e-6
    assert sorted(p.name for p in tmp_path.iterdir()) == ["amplitude.fits", "opd.fits"]


def test_prysm_pupil_comes_back():
    wave = letter(64)
    back = psf.from_prysm(
        psf.to_prysm(wave), image_distance=DISTANCE, pupil_radius=wave.pupil_radius
    )
    # nm and mm there and back, two roundings
    for name in ("u", "v", "aberration", "amplitude", "weights"):
        assert getattr(back, name) == approx(getattr(wave, name), rel=1e-15, abs=1e-18)
    assert back.wavelength == approx(WAVELENGTH, rel=1e-15)


def test_cut_cells_carry_their_share():
    """The field's sum is that of the wave, cell by cell."""
    wave = aberrated(48, {8: 0.1}, obscuration=0.3)
    pupil = psf.to_prysm(wave)
    assert pupil.amplitude * wave.pupil_pitch**2 == approx(wave.weights, rel=1e-13)
    back = psf.from_prysm(pupil, image_distance=DISTANCE, pupil_radius=RADIUS)
    assert psf.strehl(back) == approx(psf.strehl(wave), rel=1e-12)


def test_poppys_own_even_pupil(poppy, fits, tmp_path):
    """Its centre lies between pixels: refused, moved with the same image, or kept as nodes."""
    n, pitch = 64, 2 * RADIUS / 64
    axis = (np.arange(n) - (n - 1) / 2) * pitch
    v, u = np.meshgrid(axis, axis, indexing="ij")
    light = (np.hypot(u, v) < RADIUS) * 1.0
    path = WAVELENGTH * (0.3 * (u / RADIUS) ** 3 - 0.4 * u * v / RADIUS**2 + 0.2 * v / RADIUS)
    for name, values, unit in (("amplitude", light, None), ("opd", -1e9 * path, "nanometers")):
        hdu = fits.PrimaryHDU(values)
        hdu.header["PUPLSCAL"] = pitch
        if unit:
            hdu.header["BUNIT"] = unit
        hdu.writeto(tmp_path / f"{name}.fits")
    given = {"wavelength": WAVELENGTH, "image_distance": DISTANCE, "pupil_radius": RADIUS}
    with pytest.raises(SamplingError, match="a side of 64 pixels is even"):
        psf.read_poppy(**paths(tmp_path), **given)
    nodes = psf.read_poppy(**paths(tmp_path), **given, half_pixel="scattered")
    lit = light > 0
    assert nodes.u == approx(u[lit], rel=1e-12, abs=1e-15)
    assert nodes.v == approx(v[lit], rel=1e-12, abs=1e-15)
    assert nodes.aberration == approx(path[lit], rel=1e-12, abs=1e-22)
    moved = psf.read_poppy(**paths(tmp_path), **given, half_pixel="shift")
    image_pitch = WAVELENGTH * DISTANCE / (2 * RADIUS) / 3
    theirs = image_by_poppy(poppy, paths(tmp_path), image_pitch, 41)
    # sums in float64, as above
    assert image_here(moved, image_pitch, 41) == approx(theirs, abs=1e-13)
    kept = psf.point_spread(
        nodes, method="nufft", pitch=image_pitch, shape=41, normalisation="ideal-peak", tol=1.0
    ).intensity
    # the non-uniform transform's own error
    assert kept / kept.max() == approx(theirs, abs=1e-11)


def test_units_of_opd(fits, tmp_path):
    values = np.arange(25.0).reshape(5, 5)
    given = {"wavelength": WAVELENGTH, "image_distance": DISTANCE}
    scales = dict.fromkeys(("m", "Meters", "metre"), 1.0)
    scales |= dict.fromkeys(("um", "micron", "micrometers"), 1e-6)
    scales |= {"nm": 1e-9, "nanometers": 1e-9, "radians": WAVELENGTH / (2 * math.pi)}
    for unit, scale in scales.items():
        hdu = fits.PrimaryHDU(values.astype(np.float32))
        hdu.header["PIXELSCL"] = 1e-3
        hdu.header["BUNIT"] = unit
        hdu.writeto(tmp_path / "opd.fits", overwrite=True)
        wave = psf.read_poppy(opd=tmp_path / "opd.fits", **given)
        assert wave.aberration == approx(-scale * values, rel=1e-15)
        assert np.array_equal(wave.amplitude, np.ones((5, 5)))
    hdu.header["BUNIT"] = "furlong"
    hdu.writeto(tmp_path / "opd.fits", overwrite=True)
    with pytest.raises(SceneError, match="'furlong' is not a unit"):
        psf.read_poppy(opd=tmp_path / "opd.fits", **given)


@pytest.mark.parametrize("n", [5, 6])
def test_files_of_others_give_what_they_say(fits, tmp_path, n):
    """One file alone; the pupil's radius is that of the files or of the disc that fits."""
    values = np.arange(n * n).reshape(n, n) / 7 + 1
    given = {"wavelength": WAVELENGTH, "image_distance": DISTANCE, "half_pixel": "shift"}

    def written(name, **header):
        hdu = fits.PrimaryHDU(values)
        hdu.header.update({"PIXELSCL": 3e-4} | header)
        hdu.writeto(tmp_path / name, overwrite=True)
        return tmp_path / name

    wave = psf.read_poppy(amplitude=written("a.fits"), **given)
    assert np.array_equal(wave.amplitude, values)
    assert not wave.aberration.any()
    assert wave.u[1] == approx(3e-4 * (np.arange(n) - n // 2), rel=1e-15, abs=1e-20)
    assert wave.v[:, 1] == approx(3e-4 * (np.arange(n) - n // 2), rel=1e-15, abs=1e-20)
    assert wave.weights == approx(np.full((n, n), 9e-8), rel=1e-14)
    # the disc that fits about the centre of square n//2
    assert wave.pupil_radius == approx(7.5e-4, rel=1e-12)
    assert (wave.layout, wave.obscuration, wave.removed) == ("grid", 0.0, psf.Removed())
    assert psf.read_poppy(amplitude=tmp_path / "a.fits", **given, pupil_radius=2e-3).f_number == 125
    head = {"PUPLSCAL": 2e-4, "PUPLRAD": 7e-4, "OBSCURAT": 0.2, "WAVELEN": 1e-6, "IMAGDIST": -2.0}
    head |= {"RMPISTON": 0.3, "RMTILTU": 0.4, "RMTILTV": -0.5, "RMDEFOC": 0.6}
    first = written("b.fits", **head, BUNIT="nm")
    near = written("c.fits", **{key: value * (1 + 9e-10) for key, value in head.items()})
    for files in ({"opd": first}, {"amplitude": first, "opd": first}):
        wave = psf.read_poppy(**files, half_pixel="shift")
        assert (wave.pupil_radius, wave.obscuration, wave.wavelength) == (7e-4, 0.2, 1e-6)
        assert (wave.pupil_pitch, wave.image_distance) == (approx(2e-4, rel=1e-14), -2.0)
        assert wave.removed == psf.Removed(piston=0.3, tilt=(0.4, -0.5), defocus=0.6)
        assert wave.aberration == approx(-1e-9 * values, rel=1e-15)
    assert psf.read_poppy(opd=first, amplitude=near, half_pixel="shift").obscuration == approx(0.2)
    for key, value in head.items():
        other = written("d.fits", **{key: value * (1 + 1.2e-9)})
        with pytest.raises(SceneError, match=f"{key} = {value:g} in the amplitude file and"):
            psf.read_poppy(opd=first, amplitude=other, half_pixel="shift")
    for key in ("PUPLSCAL", "PUPLRAD"):
        with pytest.raises(SceneError, match=f"{key}|pupil_radius"):
            psf.read_poppy(amplitude=written("e.fits", **{key: -1.0}), **given)


@pytest.mark.parametrize("samples", [4, 5])
def test_headers_say_what_the_files_hold(fits, tmp_path, samples):
    wave = replace(aberrated(samples, {4: 0.1}), removed=psf.Removed(piston=math.pi))
    psf.write_poppy(wave, **paths(tmp_path))
    for name in ("opd", "amplitude"):
        with fits.open(tmp_path / f"{name}.fits") as units:
            header, values = units[0].header, units[0].data
        assert values.shape == (5, 5)
        assert header["RMPISTON"] == math.pi
        assert header.cards["RMPISTON"].image.rstrip() == (
            "RMPISTON= 3.1415926535897931E+00 / m, removed piston"
        )
        comments = list(header["COMMENT"])
        assert comments[-1] == "row 0 at the lowest v, the axis on the middle pixel"
        assert len(comments) == (2 if name == "opd" else 1)
        assert ("BUNIT" in header) == (name == "opd")
        if name == "opd":
            assert comments[0].startswith("positive where the wave is ahead")
            assert not np.signbit(values[values == 0]).any()


def test_odd_arrays_have_a_middle_pixel(fits, tmp_path):
    hdu = fits.PrimaryHDU(np.diag([0.0, 1.0, 2.0]))
    hdu.header["PUPLSCAL"] = 1e-3
    hdu.writeto(tmp_path / "a.fits")
    given = {"wavelength": WAVELENGTH, "image_distance": DISTANCE}
    for half_pixel in ("refuse", "shift", "scattered"):
        wave = psf.read_poppy(amplitude=tmp_path / "a.fits", half_pixel=half_pixel, **given)
        assert wave.layout == "grid"
    assert psf.read_poppy(amplitude=tmp_path / "a.fits", **given).u[0] == approx([-1e-3, 0, 1e-3])
    with pytest.raises(SceneError, match="half_pixel = 'move' is unknown"):
        psf.read_poppy(amplitude=tmp_path / "a.fits", half_pixel="move", **given)


def test_what_files_are_refused(fits, tmp_path):
    given = {"wavelength": WAVELENGTH, "image_distance": DISTANCE}

    def written(name, values, **header):
        hdu = fits.PrimaryHDU(values)
        hdu.header.update(header)
        hdu.writeto(tmp_path / name, overwrite=True)
        return tmp_path / name

    square = written("square.fits", np.ones((5, 5)), PUPLSCAL=1e-3, BUNIT="m")
    with pytest.raises(SceneError, match="both missing"):
        psf.read_poppy(**given)
    with pytest.raises(SceneError, match="no such file"):
        psf.read_poppy(opd=tmp_path / "none.fits", **given)
    (tmp_path / "text.fits").write_text("no FITS file")
    with pytest.raises(SceneError, match="is not a FITS file"):
        psf.read_poppy(opd=tmp_path / "text.fits", **given)
    with pytest.raises(SceneError, match="the files have no WAVELEN, the wavelength"):
        psf.read_poppy(opd=square, image_distance=DISTANCE)
    with pytest.raises(SceneError, match="one slice of a cube"):
        psf.read_poppy(opd=written("cube.fits", np.ones((2, 5, 5)), PUPLSCAL=1e-3), **given)
    with pytest.raises(SceneError, match="neither PUPLSCAL nor PIXELSCL"):
        psf.read_poppy(opd=written("bare.fits", np.ones((5, 5)), BUNIT="m"), **given)
    for shape in ((5,), (5, 4)):
        odd = written("odd.fits", np.ones(shape), PUPLSCAL=1e-3, BUNIT="m")
        message = f"begins with an array of shape {shape}; give a square"
        with pytest.raises(SceneError, match=re.escape(message)):
            psf.read_poppy(opd=odd, **given)
    with pytest.raises(SceneError, match="begins with nothing"):
        psf.read_poppy(opd=written("empty.fits", None, PUPLSCAL=1e-3), **given)
    other = written("other.fits", np.ones((5, 5)), PUPLSCAL=2e-3)
    with pytest.raises(SceneError, match="two files of the same pupil"):
        psf.read_poppy(opd=square, amplitude=other, **given)
    dark = np.ones((5, 5))
    dark[0, 0] = 0.0
    holes = np.ones((5, 5))
    holes[0, 0] = np.nan
    mask = written("mask.fits", dark, PUPLSCAL=1e-3)
    wave = psf.read_poppy(
        opd=written("holes.fits", holes, PUPLSCAL=1e-3, BUNIT="m"), amplitude=mask, **given
    )
    assert wave.aberration[0, 0] == 0.0
    with pytest.raises(SceneError, match="aberration = nan"):
        psf.read_poppy(opd=tmp_path / "holes.fits", **given)


def test_what_waves_are_refused(tmp_path):
    polar = psf.Wavefront.from_zernike(
        {}, wavelength=WAVELENGTH, pupil_radius=RADIUS, image_distance=DISTANCE
    )
    with pytest.raises(SamplingError, match="nodes='grid'"):
        psf.to_prysm(polar)
    square = np.ones((3, 3))
    for pupil in ((square,), [square, square, 0.6, 1.0], (square, square, 0.6, 1.0, 2.0)):
        with pytest.raises(SceneError, match="not a prysm pupil"):
            psf.from_prysm(pupil, image_distance=DISTANCE)
    for shapes in (((3,), (3,)), ((3, 4), (3, 4)), ((3, 3), (4, 4))):
        first, second = map(np.ones, shapes)
        with pytest.raises(SceneError, match="two square arrays"):
            psf.from_prysm((first, second, 0.6, 1.0), image_distance=DISTANCE)
    with pytest.raises(SceneError, match="two square arrays"):
        psf.from_prysm((np.ones((3, 3)), np.ones((3, 4)), 0.6, 1.0), image_distance=DISTANCE)
    # half of it would be lost
    with pytest.raises(SceneError, match="amplitude has type complex128; give real"):
        psf.from_prysm((np.full((3, 3), 1 + 1j), np.ones((3, 3)), 0.6, 1), image_distance=DISTANCE)


def test_files_appear_whole_or_not_at_all(fits, tmp_path):
    wave = aberrated(16, {})
    with pytest.raises(SceneError, match="name two different files"):
        psf.write_poppy(wave, opd=tmp_path / "a", amplitude=tmp_path / "a")
    (tmp_path / "folder").mkdir()
    with pytest.raises(SceneError, match="is a folder"):
        psf.write_poppy(wave, opd=tmp_path / "opd.fits", amplitude=tmp_path / "folder")
    with pytest.raises(SceneError, match="there is no folder"):
        psf.write_poppy(wave, opd=tmp_path / "opd.fits", amplitude=tmp_path / "no" / "a.fits")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


def test_missing_astropy_is_said(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "astropy.io", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'nlosoptics\[exchange\]'"):
        psf.write_poppy(aberrated(16, {}), **paths(tmp_path))
