"""FITS files of pupils for POPPY, and from it; see `prysm_poppy` for signs and grids."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import one_of, positive, real
from ..._whole_files import write_whole
from ...errors import MissingExtraError, SamplingError, SceneError
from ..aperture.quadrature_nodes import fitting_pitch
from ..wave.wavefront import Removed, Wavefront
from .prysm_poppy import cell_amplitude, maps

if TYPE_CHECKING:
    from types import ModuleType

Array = NDArray[np.float64]
HalfPixel = Literal["refuse", "shift", "scattered"]

#: Names of OPD units, without a plural s, in m; a radian depends on the wavelength.
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
#: FITS keywords, of which POPPY's own are the first and ``BUNIT``, with what they say.
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


def write_poppy(wavefront: Wavefront, *, opd: str | Path, amplitude: str | Path) -> None:
    """Write the two FITS files of a pupil that ``poppy.FITSOpticalElement`` reads.

    Parameters
    ----------
    wavefront : Wavefront
        A grid. POPPY's pupils are centred on their array: an even grid, whose axis is on sample
        n//2, gets a dark row and column at its upper end, which centre it exactly.
    opd : str or Path
        File of the path, m, turned to POPPY's sign: ``OPD = -W``.
    amplitude : str or Path
        File of the amplitude; cells that the rim cuts get the part of it that is inside.

    Raises
    ------
    SamplingError
        If the wave is not on a grid.
    SceneError
        If a file cannot be written, or both are the same.
    MissingExtraError
        Without astropy.

    Notes
    -----
    float64, ``PUPLSCAL`` in m per pixel and ``BUNIT``; further keywords hold the rest of the
    wavefront for `read_poppy`. POPPY's image is in angles, x and y over ``image_distance``: a
    negative one turns the picture by half a turn. Both files are written before either replaces
    an old one.
    """
    fits = _fits()
    paths = {"opd": Path(opd), "amplitude": Path(amplitude)}
    if paths["opd"].absolute() == paths["amplitude"].absolute():
        raise SceneError(f"opd and amplitude are both {opd}; name two files")
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
    """Wavefront of the FITS files of a POPPY pupil.

    Parameters
    ----------
    opd : str or Path, optional
        File of the path, in POPPY's sign, turned to ``W = -OPD``; its unit is that of ``BUNIT``:
        metres, microns, nanometres or radians. Default 0 everywhere. It may be anything, even NaN,
        where the amplitude is 0.
    amplitude : str or Path, optional
        File of the amplitude transmission. Default 1 everywhere, a square pupil.
    wavelength, image_distance, pupil_radius : float, optional
        m, before what the files say, of which POPPY's own say nothing. The radius is by default
        that of the disc that just fits the array.
    half_pixel : {"refuse", "shift", "scattered"}
        What to do with arrays of even side, whose centre POPPY has between four pixels and a grid
        here has on pixel n//2: nothing is ever interpolated. ``shift`` puts the pupil half a pixel
        lower in u and v, which leaves the intensity of the image as it is, and only that;
        ``scattered`` keeps every lit pixel in its place, as a scattered node.

    Returns
    -------
    Wavefront
        A grid, or scattered.

    Raises
    ------
    SceneError
        If a file is missing, is no square picture, lacks its scale or unit, or does not fit the
        other.
    SamplingError
        If the side is even and ``half_pixel`` is ``refuse``.
    MissingExtraError
        Without astropy.
    """
    one_of("half_pixel", half_pixel, ("refuse", "shift", "scattered"))
    if opd is None and amplitude is None:
        raise SceneError("opd and amplitude are both missing; name one file or both")
    heads, arrays = {}, {}
    for name, place in (("amplitude", amplitude), ("opd", opd)):
        if place is not None:
            arrays[name], heads[name] = _read_fits(Path(place))
    path = opd if opd is not None else amplitude
    first = next(iter(arrays.values()))
    light, lead = maps(
        str(path), arrays.get("amplitude", np.ones_like(first)), arrays.get("opd", 0 * first)
    )
    n, pitch = first.shape[0], _pitch(heads)
    if n % 2 == 0 and half_pixel == "refuse":
        raise SamplingError(
            f"{path}: a side of {n} pixels is even, so the pupil's centre lies between pixels; "
            "give half_pixel='shift' to move it by half a pixel, which the image's intensity does "
            "not see, or 'scattered' to keep each place"
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
    """The lit nodes of a grid, moved along u and v by some m."""
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
        # astropy's own cards have room for some 14 digits
        line = f"{key:<8}= {value:.16E} / {KEYWORDS[key]}"
        header.append(fits.Card.fromstring(line))
    if is_opd:
        header["BUNIT"] = ("meter", "optical path difference")
        header["COMMENT"] = "positive where the wave is ahead (a shorter path): POPPY's sign"
    header["COMMENT"] = "row 0 at the lowest v, the axis on the middle pixel"


def _read_fits(path: Path) -> tuple[Array, Any]:
    fits = _fits()
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file; give the path of a FITS file")
    try:
        with fits.open(path, memmap=False) as units:
            data, header = units[0].data, units[0].header
    except (OSError, ValueError) as error:
        raise SceneError(f"{path} is no FITS file ({error}); give one") from None
    if data is None or data.ndim != 2 or data.shape[0] != data.shape[1]:
        shape = "nothing" if data is None else f"an array of shape {data.shape}"
        raise SceneError(f"{path} begins with {shape}; give one square picture, of a cube a slice")
    return data.astype(np.float64), header


def _common(headers: dict[str, Any], key: str) -> float | None:
    """Value that the files agree on; none where none has it."""
    found = {name: real(f"{name} file's {key}", h[key]) for name, h in headers.items() if key in h}
    values = list(found.values())
    if len(values) == 2 and not math.isclose(*values, rel_tol=1e-9):
        raise SceneError(
            f"{key} = {values[0]:g} in the amplitude file and {values[1]:g} in the OPD file; give "
            "two files of one pupil"
        )
    return values[0] if values else None


def _given(value: float | None, headers: dict[str, Any], key: str, name: str) -> float:
    found = value if value is not None else _common(headers, key)
    if found is None:
        raise SceneError(f"{name} is not in the files as {key}; give {name} in m")
    return real(name, found)


def _pitch(headers: dict[str, Any]) -> float:
    for key in ("PUPLSCAL", "PIXELSCL"):
        found = _common(headers, key)
        if found is not None:
            return positive(key, found, unit="m")
    raise SceneError("the files have neither PUPLSCAL nor PIXELSCL; add the m per pixel as one")


def _opd_unit(header: Any, wavelength: float, path: object) -> float:
    """Metres per unit of an OPD file."""
    if header is None:
        return 1.0
    name = str(header.get("BUNIT", "")).strip().lower()
    # as POPPY does: nm, nanometer or nanometers
    name = name.removesuffix("s")
    if name == "radian":
        return wavelength / (2 * math.pi)
    if name not in UNITS:
        raise SceneError(
            f"{path}: BUNIT = {header.get('BUNIT')!r} is no unit of OPD; use meter, micron, "
            "nanometer or radian"
        )
    return UNITS[name]


def _removed(headers: dict[str, Any]) -> Removed:
    piston, tilt_u, tilt_v, defocus = (
        _common(headers, key) or 0.0 for key in ("RMPISTON", "RMTILTU", "RMTILTV", "RMDEFOC")
    )
    return Removed(piston=piston, tilt=(tilt_u, tilt_v), defocus=defocus)
