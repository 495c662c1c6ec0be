"""FITS files of pupils for POPPY and from POPPY; see `prysm_poppy` for signs and grids."""

from __future__ import annotations

import io
import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import one_of, path_of, positive, real, reason
from ..._whole_files import write_whole
from ...errors import MissingExtraError, SamplingError, SceneError
from ..aperture.quadrature_nodes import fitting_pitch
from ..wave.removed import Removed
from ..wave.wavefront import Wavefront
from .prysm_poppy import cell_amplitude, maps

if TYPE_CHECKING:
    from types import ModuleType

Array = NDArray[np.float64]
HalfPixel = Literal["refuse", "shift", "scattered"]

#: Metres per OPD unit, by name without plural s; radians are treated apart, with the wavelength.
UNITS: Final = {
    "m": 1.0,
    "meter": 1.0,
    "metre": 1.0,
    "um": 1e-6,
    "micron": 1e-6,
    "micrometer": 1e-6,
    "nm": 1e-9,
    "nanometer": 1e-9,
}
#: FITS keywords and their comments. POPPY itself uses only the first of them, and ``BUNIT``.
KEYWORDS: Final = {
    "PUPLSCAL": "m per pixel",
    "WAVELEN": "m, wavelength",
    "IMAGDIST": "m, from the pupil to the image, signed",
    "PUPLRAD": "m, pupil radius",
    "OBSCURAT": "inner radius over the outer",
    "RMPISTON": "m, removed piston",
    "RMTILTU": "removed tilt dW/du of the path excess W",
    "RMTILTV": "removed tilt dW/dv",
    "RMDEFOC": "1/m, removed defocus, times (u^2 + v^2)/2",
}
#: Keywords that are read: those that are written, POPPY's name of the pitch and the unit.
READ: Final = (*KEYWORDS, "PIXELSCL", "BUNIT")


def write_poppy(wavefront: Wavefront, *, opd: str | Path, amplitude: str | Path) -> None:
    """Write a wave to two FITS files for the Python library POPPY (``poppy.FITSOpticalElement``).

    Parameters
    ----------
    wavefront : Wavefront
        Wave with ``layout`` = "grid" (samples on a square grid, see `Wavefront`).
    opd : str or Path
        File for the optical path difference, m. Its sign is that of POPPY, opposite to the
        aberration W of this library: ``OPD = -W``.
    amplitude : str or Path
        File for the amplitude. In a square that the rim of the pupil crosses, it is multiplied by
        the fraction of the square inside the pupil.

    Raises
    ------
    SamplingError
        If the layout of the wave is not "grid".
    SceneError
        If a file cannot be written, or both names are the same.
    MissingExtraError
        If astropy is not installed.

    See Also
    --------
    read_poppy : Read these files.
    to_prysm : Arrays for prysm.

    Notes
    -----
    Values are float64. The FITS keyword ``PUPLSCAL`` holds the pixel side in m and ``BUNIT`` the
    unit; further keywords hold the rest of the wavefront for `read_poppy`.

    POPPY centres a pupil on its array, while a grid of n squares in this library has its axis on
    sample n//2. For even n a dark row and column are therefore added at the upper end.

    POPPY's image coordinates are angles: x and y divided by ``image_distance``. A negative distance
    rotates the image by 180 degrees. Both files are written completely before either replaces an
    existing file.
    """
    fits = _fits()
    paths = {"opd": path_of("opd", opd), "amplitude": path_of("amplitude", amplitude)}
    if paths["opd"].absolute() == paths["amplitude"].absolute():
        raise SceneError(f"opd and amplitude are both {opd}; name two different files")
    even = 1 - wavefront.u.shape[0] % 2 if wavefront.layout == "grid" else 0
    arrays = {
        "amplitude": np.pad(cell_amplitude(wavefront), (0, even)),
        "opd": np.pad(0.0 - wavefront.aberration, (0, even)),
    }
    contents = {}
    for name, path in paths.items():
        unit = fits.PrimaryHDU(arrays[name])
        _describe(fits, unit.header, wavefront, is_opd=name == "opd")
        whole = io.BytesIO()
        unit.writeto(whole)
        contents[path] = whole.getvalue()
    write_whole(contents)


def read_poppy(
    *,
    opd: str | Path | None = None,
    amplitude: str | Path | None = None,
    wavelength: float | None = None,
    image_distance: float | None = None,
    pupil_radius: float | None = None,
    half_pixel: HalfPixel = "refuse",
) -> Wavefront:
    """Read a wave from FITS files of the Python library POPPY: path difference, amplitude or both.

    Parameters
    ----------
    opd : str or Path, optional
        File with the optical path difference in POPPY's sign; the aberration is ``W = -OPD``. The
        FITS keyword ``BUNIT`` gives its unit: metres, microns, nanometres or radians. Values where
        the amplitude is 0 are ignored and may be NaN. Default 0 everywhere.
    amplitude : str or Path, optional
        File with the transmission of the amplitude (not of the intensity), 0 to 1. Default 1
        everywhere, which is a square pupil.
    wavelength : float, optional
        Vacuum wavelength, m. Default: the value in the files, as written by `write_poppy`. Required
        for files written by POPPY, which do not contain it.
    image_distance : float, optional
        Distance from the pupil to the image plane, m; negative if the pupil lies beyond the image.
        Default and requirement as for ``wavelength``.
    pupil_radius : float, optional
        Radius of the pupil, m, which defines the F-number. Default: the value in the files, or else
        the radius of the disc that just fits the array.
    half_pixel : {"refuse", "shift", "scattered"}
        Treatment of arrays with an even number n of pixels per side. Their centre lies between four
        pixels in POPPY, but on pixel n//2 in this library. "refuse" raises an error. "shift" moves
        the pupil by half a pixel toward lower u and v, which changes the phase of the image but not
        its intensity. "scattered" keeps the true position of every pixel of non-zero amplitude, in
        a wave of the layout "scattered". Values are never interpolated.

    Returns
    -------
    Wavefront
        Wave of the layout "grid", or "scattered" if ``half_pixel`` is "scattered" and n is even.

    Raises
    ------
    SceneError
        If a file is missing, is not a square image, lacks its pixel side or unit, or contradicts
        the other file; if no file is given; or if wavelength or image distance is not known.
    SamplingError
        If n is even and ``half_pixel`` is "refuse".
    MissingExtraError
        If astropy is not installed.

    See Also
    --------
    write_poppy : Write a wave to FITS files for POPPY.
    from_prysm : Wave from prysm's maps.
    """
    one_of("half_pixel", half_pixel, ("refuse", "shift", "scattered"))
    if opd is None and amplitude is None:
        raise SceneError("opd and amplitude are both missing; name one file or both")
    heads, arrays = {}, {}
    for name, place in (("amplitude", amplitude), ("opd", opd)):
        if place is not None:
            arrays[name], heads[name] = _read_fits(path_of(name, place))
    path = opd if opd is not None else amplitude
    first = next(iter(arrays.values()))
    light, lead = maps(
        str(path),
        arrays.get("amplitude", np.ones_like(first)),
        arrays.get("opd", np.zeros_like(first)),
    )
    n, pitch = first.shape[0], _pitch(heads)
    if n % 2 == 0 and half_pixel == "refuse":
        raise SamplingError(
            f"{path}: a side of {n} pixels is even, so the pupil's centre lies between pixels; "
            "give half_pixel='shift' to move it by half a pixel, which does not change the image's "
            "intensity, or 'scattered' to keep the positions of all pixels"
        )
    length = _given(wavelength, heads, "WAVELEN", "wavelength")
    radius = pupil_radius if pupil_radius is not None else _common(heads, "PUPLRAD")
    v, u = np.meshgrid(*2 * [(np.arange(n) - n // 2) * pitch], indexing="ij")
    wave = Wavefront(
        u=u,
        v=v,
        aberration=0.0 - lead * _opd_unit(heads.get("opd"), length, path),
        amplitude=light,
        weights=np.full_like(u, pitch**2),
        wavelength=length,
        image_distance=_given(image_distance, heads, "IMAGDIST", "image_distance"),
        pupil_radius=radius if radius is not None else pitch / fitting_pitch(1.0, n),
        obscuration=_common(heads, "OBSCURAT") or 0.0,
        layout="grid",
        removed=_removed(heads),
    )
    if n % 2 == 0 and half_pixel == "scattered":
        return _scattered(wave, pitch / 2)
    return wave


def _scattered(wave: Wavefront, by: float) -> Wavefront:
    """Return the lit nodes of a grid as a scattered wave, shifted by ``by``, m, along u and v."""
    lit = wave.amplitude > 0
    return replace(
        wave,
        layout="scattered",
        u=wave.u[lit] + by,
        v=wave.v[lit] + by,
        aberration=wave.aberration[lit],
        amplitude=wave.amplitude[lit],
        weights=wave.weights[lit],
    )


def _fits() -> ModuleType:
    """Import ``astropy.io.fits`` or raise `MissingExtraError`."""
    try:
        from astropy.io import fits
    except ImportError:
        raise MissingExtraError(
            "FITS files need astropy, which is not installed; run pip install "
            "'nlosoptics[exchange]'"
        ) from None
    module: ModuleType = fits
    return module


def _describe(fits: ModuleType, header: Any, wave: Wavefront, *, is_opd: bool) -> None:
    """Write a wave's geometry, wavelength and removed terms into a FITS header."""
    removed = wave.removed
    values = {
        "PUPLSCAL": wave.pupil_pitch,
        "WAVELEN": wave.wavelength,
        "IMAGDIST": wave.image_distance,
        "PUPLRAD": wave.pupil_radius,
        "OBSCURAT": wave.obscuration,
        "RMPISTON": removed.piston,
        "RMTILTU": removed.tilt[0],
        "RMTILTV": removed.tilt[1],
        "RMDEFOC": removed.defocus,
    }
    for key, value in values.items():
        # Formatted here, because astropy writes only about 14 digits.
        line = f"{key:<8}= {value:.16E} / {KEYWORDS[key]}"
        header.append(fits.Card.fromstring(line))
    if is_opd:
        header["BUNIT"] = ("meter", "optical path difference")
        header["COMMENT"] = "positive where the wave is ahead (a shorter path): POPPY's sign"
    header["COMMENT"] = "row 0 at the lowest v, the axis on the middle pixel"


def _read_fits(path: Path) -> tuple[Array, dict[str, Any]]:
    """Read the square array of a FITS file, and the values of its header that we use."""
    fits = _fits()
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file; give the path of a FITS file")
    try:
        with warnings.catch_warnings():
            # Unusual cards are accepted, and values are checked; other warnings mean damage.
            warnings.simplefilter("error", UserWarning)
            warnings.simplefilter("ignore", fits.verify.VerifyWarning)
            # astropy leaves a file open that it refuses
            with fits.open(io.BytesIO(path.read_bytes()), memmap=False) as units:
                data, header = units[0].data, units[0].header
                values = {key: header[key] for key in READ if key in header}
    except Exception as error:  # astropy raises arbitrary exceptions for damaged headers
        raise SceneError(f"{path} is not a FITS file ({reason(error)}); give a FITS file") from None
    if data is None or data.ndim != 2 or data.shape[0] != data.shape[1]:
        shape = "nothing" if data is None else f"an array of shape {data.shape}"
        raise SceneError(f"{path} begins with {shape}; give a square image (one slice of a cube)")
    return data.astype(np.float64), values


def _common(headers: dict[str, Any], key: str) -> float | None:
    """Return the value of a keyword after checking that the files agree; None if it is missing."""
    found = {name: real(f"{name} file's {key}", h[key]) for name, h in headers.items() if key in h}
    values = list(found.values())
    if len(values) == 2 and not math.isclose(*values, rel_tol=1e-9):
        raise SceneError(
            f"{key} = {values[0]:g} in the amplitude file and {values[1]:g} in the OPD file; give "
            "two files of the same pupil"
        )
    return values[0] if values else None


def _given(value: float | None, headers: dict[str, Any], key: str, name: str) -> float:
    """Return the caller's value, or else that of the files; raise `SceneError` if neither."""
    found = value if value is not None else _common(headers, key)
    if found is None:
        raise SceneError(f"the files have no {key}, the {name}; give {name} in m")
    return real(name, found)


def _pitch(headers: dict[str, Any]) -> float:
    """Return the pupil pitch, m, from the headers."""
    for key in ("PUPLSCAL", "PIXELSCL"):
        found = _common(headers, key)
        if found is not None:
            return positive(key, found, unit="m")
    raise SceneError("the files have neither PUPLSCAL nor PIXELSCL; add one, in m per pixel")


def _opd_unit(header: Any, wavelength: float, path: object) -> float:
    """Return the unit of an OPD file in m."""
    if header is None:
        return 1.0
    name = str(header.get("BUNIT", "")).strip().lower()
    # Like POPPY, accept nm, nanometer and nanometers.
    name = name.removesuffix("s")
    if name == "radian":
        return wavelength / (2 * math.pi)
    if name not in UNITS:
        raise SceneError(
            f"{path}: BUNIT = {header.get('BUNIT')!r} is not a unit of OPD; use meter, micron, "
            "nanometer or radian"
        )
    return UNITS[name]


def _removed(headers: dict[str, Any]) -> Removed:
    """Return the removed terms that the headers state; 0 for missing ones."""
    piston, tilt_u, tilt_v, defocus = (
        _common(headers, key) or 0.0 for key in ("RMPISTON", "RMTILTU", "RMTILTV", "RMDEFOC")
    )
    return Removed(piston=piston, tilt=(tilt_u, tilt_v), defocus=defocus)
