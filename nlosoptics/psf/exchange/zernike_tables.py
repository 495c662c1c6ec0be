"""Text tables of Zernike coefficients, for other tools and from them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Final, Literal

from ..._checks import in_range, one_of, real
from ..._whole_files import write_whole
from ...errors import SceneError
from ..wave.zernikes import ORDERINGS, Ordering, zernike_order

Unit = Literal["m", "um", "nm", "waves"]
Sign = Literal["excess", "advance"]

UNITS: Final = ("m", "um", "nm", "waves")
SIGNS: Final = ("excess", "advance")
#: Decimal digits that a unit moves the point by, so that no binary rounding comes in.
DIGITS: Final = {"m": 0, "um": 6, "nm": 9}
FIELDS: Final = ("ordering", "unit", "sign", "wavelength")

COMMENT: Final = re.compile(r"[#!%]\s*(?:(\w+)\s*[:=]\s*(\S+)\s*$)?")
NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LISTING: Final = re.compile(r"\s*listing of zernike", re.IGNORECASE)
#: Index and coefficient, as ``4,1.5``, ``4 1.5`` or a listing's ``Z 4  1.5 : formula``.
LINE: Final = re.compile(rf"[zZ]?\s*(\d+)(?:\s*[,;:=]\s*|\s+)({NUMBER})\s*(?::.*)?")


@dataclass(frozen=True, kw_only=True)
class ZernikeTable:
    """Coefficients as `Wavefront.from_zernike` takes them, and what they refer to.

    Parameters
    ----------
    coefficients : mapping of int to float
        Index to coefficient, m, positive for a longer path; rms for Noll and OSA, at the rim for
        Fringe.
    ordering : {"noll", "osa", "fringe"}
    wavelength : float or None
        m, where the table says it.
    """

    coefficients: Mapping[int, float]
    ordering: Ordering
    wavelength: float | None = None


def write_zernikes(
    path: str | Path,
    coefficients: Mapping[int, float],
    *,
    ordering: Ordering = "noll",
    unit: Unit = "m",
    sign: Sign = "excess",
    wavelength: float | None = None,
) -> None:
    """Write Zernike coefficients as comma-separated text that says what they mean.

    Parameters
    ----------
    path : str or Path
        An existing file is replaced; the new one appears whole or not at all.
    coefficients : mapping of int to float
        Index to coefficient, m, positive for a longer path, as of `fit_zernike`.
    ordering : {"noll", "osa", "fringe"}
        What the indices are; the file gets the same.
    unit : {"m", "um", "nm", "waves"}
        Of the numbers in the file.
    sign : {"excess", "advance"}
        ``advance`` writes minus the coefficients, for tools that count a shorter path as positive,
        as POPPY does; of Zemax it is said too, which no test here can hold.
    wavelength : float, optional
        m; needed for waves.

    Raises
    ------
    SceneError
        If an index is not of the ordering, or the file cannot be written.

    Notes
    -----
    Metres, micrometres and nanometres come back from `read_zernikes` bit by bit; waves to one
    rounding.
    """
    one_of("ordering", ordering, ORDERINGS)
    one_of("unit", unit, UNITS)
    one_of("sign", sign, SIGNS)
    lines = [
        f"# Zernike coefficients, {_meaning(ordering)}",
        f"# ordering: {ordering}",
        f"# unit: {unit}",
        f"# sign: {sign}",
    ]
    if wavelength is not None:
        lines.append(f"# wavelength: {_checked(wavelength)!r}")
    lines.append("index,coefficient")
    for index, value in coefficients.items():
        zernike_order(index, ordering)
        height = real(f"coefficients[{index}]", value)
        number = _shown(-height if sign == "advance" else height, unit, wavelength)
        lines.append(f"{int(index)},{number}")
    write_whole({Path(path): ("\n".join(lines) + "\n").encode()})


def read_zernikes(
    path: str | Path,
    *,
    ordering: Ordering | None = None,
    unit: Unit | None = None,
    sign: Sign | None = None,
    wavelength: float | None = None,
) -> ZernikeTable:
    """Read Zernike coefficients from text.

    Parameters
    ----------
    path : str or Path
        Lines of an index and a coefficient, parted by a comma, semicolon, colon or blanks, under a
        heading that begins with ``index`` or none. Comments begin with # ! or %, and may say
        ``ordering: noll``, ``unit: nm``, ``sign: advance`` and ``wavelength: 6.328e-07``. Of
        Zemax's ``Listing of Zernike ...`` the lines ``Z 4 0.12 : formula`` count and no others;
        its Standard terms are Noll's, in waves.
    ordering, unit, sign : str, optional
        As of `write_zernikes`; each must be given here or by the file, and may not differ.
    wavelength : float, optional
        m; needed for waves.

    Returns
    -------
    ZernikeTable
        In m, positive for a longer path.

    Raises
    ------
    SceneError
        If a line is not understood or its number not finite, an index comes twice or is not of the
        ordering, or the meaning of the numbers is not said or said twice.
    """
    path = Path(path)
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file; give the path of a table")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8") from None
    numbers, said = _parsed(path, text)
    given = {"ordering": ordering, "unit": unit, "sign": sign}
    chosen = {
        name: _settled(path, name, value, said, choices)
        for (name, value), choices in zip(given.items(), (ORDERINGS, UNITS, SIGNS), strict=True)
    }
    length = _wavelength(path, wavelength, said)
    coefficients = {}
    for index, (line, number) in numbers.items():
        try:
            zernike_order(index, chosen["ordering"])  # type: ignore[arg-type]
        except SceneError as error:
            raise SceneError(f"{path}, line {line}: {error}") from None
        height = real(
            f"{path}, line {line}: coefficient", _metres(path, number, chosen["unit"], length)
        )
        coefficients[index] = 0.0 - height if chosen["sign"] == "advance" else height
    return ZernikeTable(
        coefficients=coefficients,
        ordering=chosen["ordering"],  # type: ignore[arg-type]
        wavelength=length,
    )


def _meaning(ordering: Ordering) -> str:
    return "value at the rim" if ordering == "fringe" else "rms over the full disc"


def _checked(wavelength: float) -> float:
    return in_range("wavelength", wavelength, 1e-8, 1e-3, unit="m", remedy="give metres in vacuum")


def _shown(value: float, unit: Unit, wavelength: float | None) -> str:
    """Shortest decimal that is read back to the same number."""
    if unit == "waves":
        if wavelength is None:
            raise SceneError("unit = 'waves' without a wavelength; give wavelength in m")
        return repr(value / wavelength)
    number = Decimal(repr(value)).scaleb(DIGITS[unit])
    plain = number == 0 or 1e-6 <= abs(number) < 1e16
    return format(number, "f") if plain else str(number)


def _metres(path: Path, number: str, unit: str, wavelength: float | None) -> float:
    if unit == "waves":
        if wavelength is None:
            raise SceneError(f"{path} is in waves of no said length; give wavelength in m")
        return float(number) * wavelength
    return float(Decimal(number).scaleb(-DIGITS[unit]))


def _parsed(path: Path, text: str) -> tuple[dict[int, tuple[int, str]], dict[str, str]]:
    """Index to line and number, and what the comments say."""
    numbers: dict[int, tuple[int, str]] = {}
    said: dict[str, str] = {}
    is_listing = LISTING.match(text) is not None
    for count, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if comment := COMMENT.match(line):
            name = (comment[1] or "").lower()
            if name in FIELDS and said.setdefault(name, comment[2]) != comment[2]:
                raise SceneError(
                    f"{path}, line {count}: {name} = {comment[2]} after {said[name]}; say it once"
                )
            continue
        if not line or (not numbers and line.lower().startswith("index")):
            continue
        found = LINE.fullmatch(line)
        if is_listing and (found is None or line[0] != "Z"):
            continue
        if found is None:
            raise SceneError(
                f"{path}, line {count}: {line[:40]!r} is no index and coefficient; write 4,1.5e-8"
            )
        index = int(found[1])
        if index in numbers:
            raise SceneError(
                f"{path}, line {count}: index {index} stands in line {numbers[index][0]} too; keep "
                "one"
            )
        numbers[index] = (count, found[2])
    if not numbers:
        raise SceneError(f"{path} holds no coefficient; write lines such as 4,1.5e-8")
    return numbers, said


def _settled(
    path: Path, name: str, given: str | None, said: Mapping[str, str], choices: tuple[str, ...]
) -> str:
    """What the caller and the file agree on."""
    if given is not None:
        one_of(name, given, choices)
    written = said.get(name)
    if written is not None:
        one_of(f"{path}: {name}", written, choices)
    if given is not None and written is not None and given != written:
        raise SceneError(f"{path}: {name} is {written} in the file, {given} was given; choose one")
    value = given if given is not None else written
    if value is None:
        raise SceneError(
            f"{path} does not say its {name}; give {name}, one of {', '.join(choices)}"
        )
    return value


def _wavelength(path: Path, given: float | None, said: Mapping[str, str]) -> float | None:
    written = None
    if "wavelength" in said:
        try:
            written = _checked(float(said["wavelength"]))
        except ValueError:
            raise SceneError(
                f"{path}: wavelength = {said['wavelength']} is none; write m, such as 6.328e-07"
            ) from None
    if given is None:
        return written
    if written is not None and abs(given - written) > 1e-9 * written:
        raise SceneError(
            f"{path}: wavelength is {written:g} m in the file, {given:g} m was given; choose one"
        )
    return _checked(given)
