"""Text tables of Zernike coefficients, for exchange with other tools."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..._checks import in_range, mapping, one_of, path_of, real
from ..._whole_files import write_whole
from ...errors import SceneError
from ..wave.zernikes import ORDERINGS, Ordering, zernike_order

Unit = Literal["m", "um", "nm", "waves"]
Sign = Literal["excess", "advance"]

#: Metres per unit; waves need the wavelength.
UNITS: Mapping[str, float | None] = {"m": 1.0, "um": 1e-6, "nm": 1e-9, "waves": None}
CHOICES = {"ordering": ORDERINGS, "unit": tuple(UNITS), "sign": ("excess", "advance")}

COMMENT = re.compile(r"[#!%]\s*(?:(\w+)\s*[:=]\s*(\S+)\s*$)?")
#: Index and coefficient, as ``4,1.5``, ``4 1.5`` or Zemax's ``Z 4  1.5 : formula``.
LINE = re.compile(
    r"[zZ]?\s*(\d+)(?:\s*[,;:=]\s*|\s+)([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?::.*)?"
)


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
        The file holds 15 digits of each.
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

    Examples
    --------
    Write 50 nm of defocus and -20 nm of coma, and read them again:

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import psf
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "wave.csv"
    ...     psf.write_zernikes(path, {4: 50e-9, 8: -20e-9}, unit="m")
    ...     print(path.read_text().splitlines()[-2:], psf.read_zernikes(path).coefficients)
    ['4,5e-08', '8,-2e-08'] {4: 5e-08, 8: -2e-08}
    """
    fields = {"ordering": ordering, "unit": unit, "sign": sign}
    for name, value in fields.items():
        one_of(name, value, CHOICES[name])
    meaning = "value at the rim" if ordering == "fringe" else "rms over the full disc"
    lines = [f"# Zernike coefficients, {meaning}"]
    lines += [f"# {name}: {value}" for name, value in fields.items()]
    if wavelength is not None:
        lines.append(f"# wavelength: {_in_metres('wavelength', wavelength)!r}")
    scale = _metres(unit, wavelength) * (-1 if sign == "advance" else 1)
    lines.append("index,coefficient")
    for index, height in mapping("coefficients", coefficients, "{index: metres}").items():
        zernike_order(index, ordering)
        lines.append(f"{int(index)},{real(f'coefficients[{index}]', height) / scale:.15g}")
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
    ordering, unit, sign : str, optional
        As in `write_zernikes`. Each must be given here or in a comment of the file. If it is given
        in both, the two must agree.
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
    """
    path = path_of("path", path)
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file; give the path of a table")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8") from None
    numbers, comments = _parsed(path, text)
    fields: dict[str, Any] = {"ordering": ordering, "unit": unit, "sign": sign}
    for name, value in fields.items():
        fields[name] = _settled(path, name, value, comments.get(name))
    length = _wavelength(path, wavelength, comments.get("wavelength"))
    scale = _metres(fields["unit"], length)
    coefficients = {}
    for index, (line, number) in numbers.items():
        try:
            zernike_order(index, fields["ordering"])
        except SceneError as error:
            raise SceneError(f"{path}, line {line}: {error}") from None
        height = real(f"{path}, line {line}: coefficient", float(number) * scale)
        coefficients[index] = 0.0 - height if fields["sign"] == "advance" else height
    return ZernikeTable(coefficients=coefficients, ordering=fields["ordering"], wavelength=length)


def _in_metres(name: str, wavelength: float) -> float:
    """Return a wavelength, m, after checking its range."""
    remedy = "give metres (vacuum wavelength)"
    return in_range(name, wavelength, 1e-8, 1e-3, unit="m", remedy=remedy)


def _metres(unit: str, wavelength: float | None) -> float:
    """Return a unit of coefficients in m."""
    scale = wavelength if unit == "waves" else UNITS[unit]
    if scale is None:
        raise SceneError("unit = 'waves' without a wavelength; give wavelength in m")
    return scale


def _parsed(path: Path, text: str) -> tuple[dict[int, tuple[int, str]], dict[str, str]]:
    """Return a mapping from index to line number and value's text, and the comments' fields."""
    numbers: dict[int, tuple[int, str]] = {}
    comments: dict[str, str] = {}
    is_listing = text.lstrip().lower().startswith("listing of zernike")
    for count, raw in enumerate(text.splitlines(), start=1):
        line, place = raw.strip(), f"{path}, line {count}"
        if comment := COMMENT.match(line):
            name = (comment[1] or "").lower()
            if comments.setdefault(name, comment[2]) != comment[2] and name in (
                *CHOICES,
                "wavelength",
            ):
                raise SceneError(
                    f"{place}: {name} = {comment[2]}, {comments[name]} before; keep one of them"
                )
            continue
        if not line or (not numbers and line.lower().startswith("index")):
            continue
        match = LINE.fullmatch(line)
        if is_listing and (match is None or line[0] != "Z"):
            continue
        if match is None:
            raise SceneError(
                f"{place}: {line[:40]!r} is no coefficient; write index and number, such as 4,1e-8"
            )
        index = int(match[1])
        if index in numbers:
            raise SceneError(
                f"{place}: index {index} is also in line {numbers[index][0]}; keep one of the lines"
            )
        numbers[index] = (count, match[2])
    if not numbers:
        raise SceneError(f"{path} has no coefficients; write lines such as 4,1.5e-8")
    return numbers, comments


def _settled(path: Path, name: str, value: str | None, written: str | None) -> str:
    """Return a field from the caller or the file; raise `SceneError` if they contradict."""
    if value is not None:
        one_of(name, value, CHOICES[name])
    if written is not None:
        one_of(f"{path}: {name}", written, CHOICES[name])
    if value is not None and written not in (None, value):
        raise SceneError(f"{path}: {name} is {written} in the file, {value} was given; choose one")
    settled = written if value is None else value
    if settled is None:
        raise SceneError(
            f"{path} does not state its {name}; give {name}, one of {', '.join(CHOICES[name])}"
        )
    return settled


def _wavelength(path: Path, value: float | None, written: str | None) -> float | None:
    """Return the wavelength of the caller or the file, m, or None."""
    if value is not None:
        value = _in_metres("wavelength", value)
    if written is None:
        return value
    try:
        number = float(written)
    except ValueError:
        raise SceneError(
            f"{path}: wavelength = {written} is not a number; give it in metres"
        ) from None
    number = _in_metres(f"{path}: wavelength", number)
    if value is not None and abs(value - number) > 1e-9 * number:
        raise SceneError(
            f"{path}: wavelength is {number:g} m in the file, {value:g} m was given; choose one"
        )
    return number if value is None else value
