"""Text tables of Zernike coefficients, for exchange with other tools."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Final, Literal

from ..._checks import in_range, one_of, path_of, real
from ..._whole_files import write_whole
from ...errors import SceneError
from ..wave.zernikes import ORDERINGS, Ordering, zernike_order

Unit = Literal["m", "um", "nm", "waves"]
Sign = Literal["excess", "advance"]

UNITS: Final = ("m", "um", "nm", "waves")
SIGNS: Final = ("excess", "advance")
#: Decimal places between metres and a unit; shifting the decimal point avoids binary rounding.
DIGITS: Final = {"m": 0, "um": 6, "nm": 9}
#: Fields that comments of a table may give.
FIELDS: Final = ("ordering", "unit", "sign", "wavelength")

COMMENT: Final = re.compile(r"[#!%]\s*(?:(\w+)\s*[:=]\s*(\S+)\s*$)?")
NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
#: First line of a Zernike listing exported by Zemax.
LISTING: Final = re.compile(r"\s*listing of zernike", re.IGNORECASE)
#: Index and coefficient, as ``4,1.5``, ``4 1.5`` or a listing's ``Z 4  1.5 : formula``.
LINE: Final = re.compile(rf"[zZ]?\s*(\d+)(?:\s*[,;:=]\s*|\s+)({NUMBER})\s*(?::.*)?")


@dataclass(frozen=True, kw_only=True)
class ZernikeTable:
    """Zernike coefficients read from a file, for `Wavefront.from_zernike`.

    Parameters
    ----------
    coefficients : mapping of int to float
        Zernike index to coefficient, m, positive for a longer path. With Noll and OSA indices a
        coefficient is the rms of its term over the full disc; with Fringe indices it is the value
        at the rim.
    ordering : {"noll", "osa", "fringe"}
        Index scheme of the coefficients, see `zernike_order`.
    wavelength : float or None
        Wavelength, m; None if the table does not give it.

    See Also
    --------
    read_zernikes : Read a table of coefficients.
    write_zernikes : Write a table of coefficients.
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
    """Write Zernike coefficients to a text file, with index scheme, unit and sign as comments.

    Parameters
    ----------
    path : str or Path
        File to write. An existing file is replaced only after the new one has been written
        completely.
    coefficients : mapping of int to float
        Zernike index to coefficient, m, positive for a longer path, as returned by `fit_zernike`.
    ordering : {"noll", "osa", "fringe"}
        Index scheme of the coefficients, which the file states; see `zernike_order`.
    unit : {"m", "um", "nm", "waves"}
        Unit of the numbers in the file.
    sign : {"excess", "advance"}
        Meaning of a positive number in the file: a longer path ("excess", as in this library) or a
        shorter one ("advance", as in POPPY, and presumably in Zemax, which was not tested).
    wavelength : float, optional
        Wavelength, m, which the file then states; required for the unit "waves".

    Raises
    ------
    SceneError
        If an index does not exist in the ordering, a coefficient is not finite, the wavelength is
        missing, or the file cannot be written.

    See Also
    --------
    read_zernikes : Read a table of coefficients.
    fit_zernike : Zernike coefficients of a wave.

    Notes
    -----
    `read_zernikes` recovers coefficients in m, um and nm bit for bit, those in waves to rounding
    error.

    Examples
    --------
    Write 50 nm of defocus and -20 nm of coma, and read them again:

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import psf
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "wave.csv"
    ...     psf.write_zernikes(path, {4: 50e-9, 8: -20e-9}, unit="nm")
    ...     print(path.read_text().splitlines()[-2:], psf.read_zernikes(path).coefficients)
    ['4,50', '8,-20'] {4: 5e-08, 8: -2e-08}
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
    write_whole({path_of("path", path): ("\n".join(lines) + "\n").encode()})


def read_zernikes(
    path: str | Path,
    *,
    ordering: Ordering | None = None,
    unit: Unit | None = None,
    sign: Sign | None = None,
    wavelength: float | None = None,
) -> ZernikeTable:
    """Read Zernike coefficients from a text file.

    Parameters
    ----------
    path : str or Path
        Text file. Each line holds an index and a coefficient, separated by a comma, semicolon,
        colon or blanks. A heading that begins with ``index`` is allowed. Comments begin with #, !
        or % and may give ``ordering: noll``, ``unit: nm``, ``sign: advance`` and ``wavelength:
        6.328e-07``. In an export of Zemax, whose first line is ``Listing of Zernike ...``, only
        lines such as ``Z 4 0.12 : formula`` are read. Give all four parameters below with it: for
        Zemax's Standard terms ``ordering="noll"``, ``unit="waves"``, the wavelength, and
        presumably ``sign="advance"``, which was not tested.
    ordering : {"noll", "osa", "fringe"}, optional
        Index scheme of the coefficients. Each of ``ordering``, ``unit`` and ``sign`` must be given
        here or in a comment of the file. If it is given in both, the two must agree.
    unit : {"m", "um", "nm", "waves"}, optional
        Unit of the numbers in the file.
    sign : {"excess", "advance"}, optional
        Meaning of a positive number in the file: a longer path ("excess") or a shorter one
        ("advance").
    wavelength : float, optional
        Wavelength, m; required for numbers in waves if the file does not give it.

    Returns
    -------
    ZernikeTable
        Coefficients in m, positive for a longer path, with index scheme and wavelength.

    Raises
    ------
    SceneError
        If a line cannot be read, a number is not finite, an index is repeated or does not exist in
        the ordering, or the meaning of the numbers is missing or contradictory.

    See Also
    --------
    write_zernikes : Write a table of coefficients.
    zernike : Zernike polynomial.
    """
    path = path_of("path", path)
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
    """Return the meaning of a coefficient, for the file's first comment."""
    return "value at the rim" if ordering == "fringe" else "rms over the full disc"


def _checked(wavelength: float, name: str = "wavelength") -> float:
    """Return a wavelength, m, after checking its range."""
    remedy = "give metres (vacuum wavelength)"
    return in_range(name, wavelength, 1e-8, 1e-3, unit="m", remedy=remedy)


def _shown(value: float, unit: Unit, wavelength: float | None) -> str:
    """Return a coefficient, m, in ``unit``, as the shortest decimal that reads back equal."""
    if unit == "waves":
        if wavelength is None:
            raise SceneError("unit = 'waves' without a wavelength; give wavelength in m")
        return repr(value / wavelength)
    number = Decimal(repr(value)).scaleb(DIGITS[unit])
    plain = number == 0 or 1e-6 <= abs(number) < 1e16
    return format(number, "f") if plain else str(number)


def _metres(path: Path, number: str, unit: str, wavelength: float | None) -> float:
    """Convert a number of a table from ``unit`` to m."""
    if unit == "waves":
        if wavelength is None:
            raise SceneError(f"{path} is in waves but gives no wavelength; give wavelength in m")
        return float(number) * wavelength
    return float(Decimal(number).scaleb(-DIGITS[unit]))


def _parsed(path: Path, text: str) -> tuple[dict[int, tuple[int, str]], dict[str, str]]:
    """Return a mapping from index to line number and value's text, and the comments' fields."""
    numbers: dict[int, tuple[int, str]] = {}
    said: dict[str, str] = {}
    is_listing = LISTING.match(text) is not None
    for count, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if comment := COMMENT.match(line):
            name = (comment[1] or "").lower()
            if name in FIELDS and said.setdefault(name, comment[2]) != comment[2]:
                raise SceneError(
                    f"{path}, line {count}: {name} = {comment[2]}, {said[name]} before; keep one"
                )
            continue
        if not line or (not numbers and line.lower().startswith("index")):
            continue
        found = LINE.fullmatch(line)
        if is_listing and (found is None or line[0] != "Z"):
            continue
        if found is None:
            raise SceneError(
                f"{path}, line {count}: {line[:40]!r} is not an index and a number; write 4,1.5e-8"
            )
        index = int(found[1])
        if index in numbers:
            raise SceneError(
                f"{path}, line {count}: index {index} is also in line {numbers[index][0]}; keep one"
            )
        numbers[index] = (count, found[2])
    if not numbers:
        raise SceneError(f"{path} has no coefficients; write lines such as 4,1.5e-8")
    return numbers, said


def _settled(
    path: Path, name: str, given: str | None, said: Mapping[str, str], choices: tuple[str, ...]
) -> str:
    """Return a field given by the caller or the file; raise `SceneError` if they contradict."""
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
            f"{path} does not state its {name}; give {name}, one of {', '.join(choices)}"
        )
    return value


def _wavelength(path: Path, given: float | None, said: Mapping[str, str]) -> float | None:
    """Return the wavelength given by the caller or the file, m, or None."""
    if given is not None:
        given = _checked(given)
    if "wavelength" not in said:
        return given
    try:
        number = float(said["wavelength"])
    except ValueError:
        raise SceneError(
            f"{path}: wavelength = {said['wavelength']} is not a number; write metres such as "
            "6.328e-07"
        ) from None
    written = _checked(number, f"{path}: wavelength")
    if given is None:
        return written
    if abs(given - written) > 1e-9 * written:
        raise SceneError(
            f"{path}: wavelength is {written:g} m in the file, {given:g} m was given; choose one"
        )
    return given
