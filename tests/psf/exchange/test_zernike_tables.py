"""Tables of Zernike coefficients: what is written is what is read, in any unit and sign."""

from __future__ import annotations

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError

WAVELENGTH = 632.8e-9
NOLL = {"ordering": "noll", "unit": "m", "sign": "excess"}
#: Numbers whose decimals do not end early, of many sizes and both signs.
COEFFICIENTS = {
    j: float(c)
    for j, c in zip(
        range(1, 37),
        np.random.default_rng(5).normal(0, 1, 36) * 10.0 ** np.linspace(-12, -3, 36),
        strict=True,
    )
}


@pytest.mark.parametrize(
    ("unit", "ordering", "sign"),
    [
        ("m", "noll", "excess"),
        ("um", "osa", "advance"),
        ("nm", "fringe", "excess"),
        ("waves", "noll", "advance"),
    ],
)
def test_what_is_written_is_read(tmp_path, unit, ordering, sign):
    path = tmp_path / "table.csv"
    kwargs = {"ordering": ordering, "unit": unit, "sign": sign}
    psf.write_zernikes(path, COEFFICIENTS, wavelength=WAVELENGTH, **kwargs)
    table = psf.read_zernikes(path)
    assert (table.ordering, table.wavelength) == (ordering, WAVELENGTH)
    assert list(table.coefficients) == list(COEFFICIENTS)
    # half of the last of 15 digits
    assert table.coefficients == approx(COEFFICIENTS, rel=5e-15, abs=0)
    assert psf.read_zernikes(path, wavelength=WAVELENGTH, **kwargs) == table
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


def test_numbers_are_those_of_the_unit(tmp_path):
    """A path shorter by 20 nm, and one longer by an eighth of a wave."""
    path = tmp_path / "table.txt"
    psf.write_zernikes(path, {4: -20e-9, 8: 1.5e-9}, unit="nm", sign="advance")
    assert path.read_text().splitlines()[-3:] == ["index,coefficient", "4,20", "8,-1.5"]
    psf.write_zernikes(path, {8: 0.125 * WAVELENGTH}, unit="waves", wavelength=WAVELENGTH)
    assert path.read_text().splitlines()[-1] == "8,0.125"


@pytest.mark.parametrize(
    ("ordering", "meaning"),
    [("noll", "rms over the full disc"), ("fringe", "value at the rim")],
)
def test_the_whole_file(tmp_path, ordering, meaning):
    path = tmp_path / "table.csv"
    head = [f"# Zernike coefficients, {meaning}", f"# ordering: {ordering}"]
    table = ["index,coefficient", "3,0.5", "4,-2"]
    psf.write_zernikes(path, {3: 0.5, 4: -2}, ordering=ordering)
    assert path.read_text() == "\n".join([*head, "# unit: m", "# sign: excess", *table, ""])
    psf.write_zernikes(path, {3: 0.5, 4: -2}, ordering=ordering, wavelength=5e-7)
    last = ["# sign: excess", "# wavelength: 5e-07", *table, ""]
    assert path.read_text() == "\n".join([*head, "# unit: m", *last])


def test_no_advance_is_no_negative_zero(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("4,0\n5,-0.0\n")
    for sign in ("advance", "excess"):
        table = psf.read_zernikes(path, ordering="noll", unit="nm", sign=sign)
        signs = [np.copysign(1, c) for c in table.coefficients.values()]
        assert signs == ([1, 1] if sign == "advance" else [1, -1])


@pytest.mark.parametrize(
    ("given", "kept"), [(None, 5e-7), (5e-7 * (1 + 8e-10), 5e-7 * (1 + 8e-10)), (5e-7, 5e-7)]
)
def test_wavelengths_agree_to_a_billionth(tmp_path, given, kept):
    path = tmp_path / "table.csv"
    psf.write_zernikes(path, {4: 1e-7}, wavelength=5e-7)
    assert psf.read_zernikes(path, wavelength=given).wavelength == kept
    for part in (-1.2e-9, 1.2e-9):
        with pytest.raises(SceneError, match="5e-07 m in the file, 5e-07 m was given"):
            psf.read_zernikes(path, wavelength=5e-7 * (1 + part))


def test_tables_of_others_are_read(tmp_path):
    path = tmp_path / "listing.txt"
    path.write_text(
        "\ufeff! Zernike Standard terms, a listing\n\n"
        "% unit = waves\n"
        "Z   4     -0.250000   :    3^(1/2) (2p^2 - 1)\n"
        "Z  11\t1.25E-02 :    5^(1/2) (6p^4 - 6p^2 + 1)\n"
        "12; +.5\n",
        encoding="utf-8",
    )
    table = psf.read_zernikes(path, ordering="noll", sign="advance", wavelength=1e-6)
    assert table.coefficients == {4: 0.25e-6, 11: -0.0125e-6, 12: -0.5e-6}


def test_listing_counts_its_terms_alone(tmp_path):
    """A head of title, date and figures, as OpticStudio writes it."""
    path = tmp_path / "listing.txt"
    path.write_text(
        "Listing of Zernike Standard Coefficient Data\n\n"
        "Date : 1/2/2026\n12 of 13\n"
        "Wavelength                   :\t0.7500 \u00b5m\n"
        "Peak to Valley (to chief)    :\t    0.5 waves\n\n"
        "Z   1\t    0.89223784\t:\t  1\n"
        "Z   4\t   -0.25000000\t:\t   3^(1/2) (2p^2 - 1)\n",
        encoding="utf-8",
    )
    table = psf.read_zernikes(path, ordering="noll", unit="waves", sign="excess", wavelength=1e-6)
    assert table.coefficients == approx({1: 0.89223784e-6, 4: -0.25e-6}, rel=1e-15)


def test_sign_turns_the_wave(tmp_path):
    """Written as an advance and read as an excess, coma throws its light to the other side."""
    path = tmp_path / "table.csv"
    system = {"wavelength": WAVELENGTH, "pupil_radius": 5e-3, "image_distance": 0.5}
    wave = psf.Wavefront.from_zernike({2: 3e-7, 8: 1e-7}, **system)
    fit = psf.fit_zernike(wave, 10)
    psf.write_zernikes(path, fit, unit="nm", sign="advance")
    again = psf.Wavefront.from_zernike(psf.read_zernikes(path).coefficients, **system)
    assert again.aberration == approx(wave.aberration, abs=1e-20)
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    path.write_text("\n".join(lines))
    table = psf.read_zernikes(path, ordering="noll", unit="nm", sign="excess")
    turned = psf.Wavefront.from_zernike(table.coefficients, **system)
    assert psf.centroid(turned) == approx([-c for c in psf.centroid(wave)], abs=1e-15)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("4,1\n", {"unit": "m", "sign": "excess"}, "does not state its ordering"),
        ("4,1\n", {"ordering": "noll", "sign": "excess"}, "does not state its unit"),
        ("4,1\n", {"ordering": "noll", "unit": "m"}, "does not state its sign"),
        ("# unit: nm\n4,1\n", {"ordering": "noll", "unit": "m"}, "unit is nm in the file, m was"),
        ("# unit: nm\n# unit: m\n4,1\n", {}, "line 2: unit = m, nm before"),
        ("# unit: parsec\n4,1\n", {"ordering": "noll"}, "unit = 'parsec' is unknown"),
        ("4,1\n4,2\n", {}, "line 2: index 4 is also in line 1"),
        ("4,1,5\n", {}, "line 1: '4,1,5' is no coefficient"),
        ("4,nan\n", {}, "line 1: '4,nan' is no coefficient"),
        ("# ordering: noll\n", {}, "has no coefficients"),
        ("0,1\n", NOLL, "line 1: noll index = 0"),
        ("4,1\n", {**NOLL, "unit": "waves"}, "without a wavelength"),
        ("# wavelength: green\n4,1\n", NOLL, "wavelength = green is not a number; give"),
        ("# wavelength: 0.6\n4,1\n", NOLL, "wavelength = 0.6 m is out of range"),
        (
            "# wavelength: 5e-7\n4,1\n",
            {**NOLL, "wavelength": 6e-7},
            "wavelength is 5e-07 m in the file",
        ),
    ],
)
def test_what_is_refused(tmp_path, text, options, message):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(SceneError, match=message):
        psf.read_zernikes(path, **options)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "t.csv").write_bytes("# Öffnung\n".encode("latin-1"))
    with pytest.raises(SceneError, match="byte 2 is not UTF-8"):
        psf.read_zernikes(tmp_path / "t.csv")


def test_what_is_not_written(tmp_path):
    with pytest.raises(SceneError, match="without a wavelength"):
        psf.write_zernikes(tmp_path / "a.csv", {4: 1e-7}, unit="waves")
    with pytest.raises(SceneError, match="noll index = 0"):
        psf.write_zernikes(tmp_path / "a.csv", {0: 1e-7})
    with pytest.raises(SceneError, match="not finite"):
        psf.write_zernikes(tmp_path / "a.csv", {4: np.inf})
    with pytest.raises(SceneError, match="no such file"):
        psf.read_zernikes(tmp_path / "a.csv")
    assert list(tmp_path.iterdir()) == []


def test_no_infinity_is_read(tmp_path):
    (tmp_path / "huge.csv").write_text("5,1e999\n")
    with pytest.raises(SceneError, match="line 1: coefficient = inf is not finite"):
        psf.read_zernikes(tmp_path / "huge.csv", ordering="noll", unit="m", sign="excess")
