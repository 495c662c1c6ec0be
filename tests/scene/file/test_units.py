"""Quantities with units: exact, and clear about what is wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from nlosoptics.scene.file import units
from nlosoptics.scene.file.units import parse, written
from nlosoptics.scene.parts._quantities import Kind


@pytest.mark.parametrize(
    ("unit", "kind", "exponent"),
    [
        ("nm", Kind.LENGTH, -9),
        ("um", Kind.LENGTH, -6),
        ("µm", Kind.LENGTH, -6),
        ("mm", Kind.LENGTH, -3),
        ("cm", Kind.LENGTH, -2),
        ("km", Kind.LENGTH, 3),
        ("ps", Kind.TIME, -12),
        ("ms", Kind.TIME, -3),
        ("mW", Kind.POWER, -3),
        ("kHz", Kind.RATE, 3),
        ("mrad", Kind.ANGLE, -3),
    ],
)
def test_prefixes_shift_the_decimal_point(unit: str, kind, exponent: int) -> None:
    """The float nearest to the decimal number, which a product of floats often misses."""
    for count in range(1, 2000, 7):
        number = f"{count / 10:.1f}"
        assert parse(f"{number} {unit}", kind) == float(f"{number}e{exponent}")


@pytest.mark.parametrize("unit", sorted(units._USUAL))
def test_usual_units_are_those_of_pint(unit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit; the table only saves the import of pint."""
    kind = units._USUAL[unit][0]
    numbers = ["1", "632.8", "-0.1", "7e-3", "1_000.3", "123456789.987654321"]
    usual = [parse(f"{number} {unit}", kind) for number in numbers]
    monkeypatch.setattr(units, "_USUAL", {})
    assert [parse(f"{number} {unit}", kind) for number in numbers] == usual


def test_usual_units_do_not_load_pint() -> None:
    code = (
        "import sys\nfrom nlosoptics import Scene\n"
        "Scene.load('examples/scenes/letter_flat.toml')\nassert 'pint' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[3], check=True)


def test_forms() -> None:
    assert parse("2 m / m * m", Kind.LENGTH) == 2.0
    assert parse("3 kg m^2 / s^3", Kind.POWER) == 3.0
    assert parse("  1.2m ", Kind.LENGTH) == 1.2
    assert parse("1_000 meter", Kind.LENGTH) == 1000.0
    assert parse(".5 metres", Kind.LENGTH) == 0.5
    assert parse("+5.e-1 m", Kind.LENGTH) == 0.5
    assert parse("1 in", Kind.LENGTH) == 0.0254
    assert (
        parse("0.1 / s", Kind.RATE)
        == parse("0.1 1/s", Kind.RATE)
        == parse("0.1 Hz", Kind.RATE)
        == 0.1
    )


@pytest.mark.parametrize("value", [0.0, 1 / 3, -2e-300, 5e-324, 1.7976931348623157e308, 6.328e-07])
@pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name)
def test_what_is_written_reads_back(value: float, kind) -> None:
    assert parse(written(value, kind), kind) == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("40 ms", "is a time, must be a length"),
        ("3 W", "is a power, must be a length"),
        (3, "has no unit, must be a length"),
        ("3", "has no unit, must be a length"),
        ("-inf m", "is not finite"),
        ("three m", "is not a length"),
        (True, "is not a length"),
        (["1 m"], "is not a length"),
        ("3 m)", r"has the unknown unit 'm\)'"),
        ("3 m; import os", "has the unknown unit"),
    ],
)
def test_wrong_quantities(text, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse(text, Kind.LENGTH)
