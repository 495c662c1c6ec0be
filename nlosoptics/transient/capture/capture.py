"""The time-resolved capture: intensity at wall points over time, for each laser point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..._checks import Vector, counted, mapping, one_of, positive, real, vector, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._xarray import Labelled, Labels, variable
from ...errors import SamplingError, SceneError
from .wall_points import checked_points, pair_shape

Array = NDArray[np.floating]
Pairing = Literal["all", "confocal"]
Quantity = Literal["irradiance", "radiance", "radiosity", "counts", "unknown"]


@dataclass(frozen=True, eq=False, kw_only=True)
class TransientCapture(Noun, Shown, Labelled):
    """Time-resolved intensity at points of the relay wall, in bins of optical path.

    A laser lights points of the wall one after the other, and a sensor records the light that
    returns to points of the wall. Times are given as optical path, the length that the light has
    travelled: 1 m is 3.34 ns. In the world frame, the wall is the plane z = 0, y points up, and the
    wall's normal is +z, unless other normals are given. Grids of points are ordered [y, x], with
    row 0 at the lowest y.

    Parameters
    ----------
    H : array_like
        Signal in each bin: (n_bins, *laser_shape, *sensor_shape) for ``pairing="all"``, (n_bins,
        *shape) for ``"confocal"``. Values are contributions of the bins, not densities: their sum
        is the ``quantity`` that a laser of constant power causes. float32 is kept, other types
        become float64.
    laser_points, sensor_points : array_like
        Points lit by the laser, (*laser_shape, 3), and points observed by the sensor,
        (*sensor_shape, 3), world frame, m. A single point may have shape (3,); it adds no axis to
        ``H``.
    delta_t : float
        Width of a bin, m of optical path.
    t_start : float
        Start of bin 0, m of optical path.
    pairing : {"all", "confocal"}
        "all": every laser point is observed at every sensor point. "confocal": laser point i is
        observed at sensor point i only; the two points may differ.
    quantity : {"irradiance", "radiance", "radiosity", "counts", "unknown"}
        Physical quantity of ``H``. The first three are per W of laser power on the wall: irradiance
        and radiosity in W/m^2, radiance in W/(m^2 sr). "counts" are detected photons. "unknown" is
        any other unit.
    outer_legs : bool
        Whether times include the outer legs: the paths from laser to wall and from wall to sensor.
    laser_origin, sensor_origin : array_like of 3 floats, optional
        Positions of laser and sensor, world frame, m. Required to subtract the outer legs. None:
        unknown.
    laser_normals, sensor_normals : array_like, optional
        Unit normals of the wall at the points, shaped like the points. None: +z everywhere.
    by_bounce : mapping of int to array_like
        Contributions to ``H`` by number of reflections, each shaped like ``H``. The number
        includes the two reflections at the wall, so that 3 is the least. Empty if unknown.
    standard_error : array_like, optional
        Standard error of ``H``, same shape and unit; 0 for values computed without random numbers.
        None: unknown.
    details : mapping
        Further information from a file or a renderer, by name.

    Raises
    ------
    SamplingError
        If array shapes are inconsistent.
    SceneError
        If a value is not finite or out of range.

    See Also
    --------
    TransientCapture.load : Read a capture from a file.
    render : Simulated capture of hidden meshes.
    render_scene : Simulated capture of a scene.
    phasor_image : Image by virtual waves, for any capture.
    nlosoptics.views.transient : Streak image of a capture.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, wall_grid
    >>> capture = TransientCapture(
    ...     H=np.ones((10, 4, 4)),
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=wall_grid(side=1.0, count=4),
    ...     delta_t=0.02,
    ...     t_start=1.0,
    ... )
    >>> capture.n_bins, capture.laser_shape, capture.sensor_shape
    (10, (), (4, 4))
    >>> print(capture.times[:3].round(3))
    [1.01 1.03 1.05]
    """

    H: Array
    laser_points: Array
    sensor_points: Array
    delta_t: float
    t_start: float = 0.0
    pairing: Pairing = "all"
    quantity: Quantity = "irradiance"
    outer_legs: bool = False
    laser_origin: Vector | None = None
    sensor_origin: Vector | None = None
    laser_normals: Array | None = None
    sensor_normals: Array | None = None
    by_bounce: Mapping[int, Array] = field(default_factory=dict)
    standard_error: Array | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        one_of("pairing", self.pairing, get_args(Pairing))
        one_of("quantity", self.quantity, get_args(Quantity))
        put = object.__setattr__
        put(self, "delta_t", positive("delta_t", self.delta_t, unit="m"))
        put(self, "t_start", real("t_start", self.t_start))
        for name in ("laser", "sensor"):
            points = checked_points(f"{name}_points", getattr(self, f"{name}_points"))
            put(self, f"{name}_points", points)
            normals = getattr(self, f"{name}_normals")
            if normals is not None:
                normals = checked_points(f"{name}_normals", normals)
                if normals.shape != points.shape:
                    raise SamplingError(
                        f"{name}_normals have shape {normals.shape}, must be {points.shape} like "
                        f"{name}_points; give one normal per point"
                    )
                put(self, f"{name}_normals", normals)
            origin = getattr(self, f"{name}_origin")
            if origin is not None:
                put(self, f"{name}_origin", vector(f"{name}_origin", origin))
        put(self, "H", self._bins("H", self.H))
        if self.standard_error is not None:
            put(self, "standard_error", self._bins("standard_error", self.standard_error))
        given = mapping("by_bounce", self.by_bounce, "{number of reflections: bins}")
        parts = {
            whole("a key of by_bounce", n): self._bins(f"by_bounce[{n}]", h)
            for n, h in given.items()
        }
        put(self, "by_bounce", MappingProxyType(parts))
        for name, values in [
            ("standard_error", self.standard_error),
            *((f"by_bounce[{n}]", h) for n, h in parts.items()),
        ]:
            if values is not None and len(values) != len(self.H):
                raise SamplingError(
                    f"{name} has {counted(len(values), 'bin')}, must be {len(self.H)} like H; "
                    "crop both to the same bins"
                )
        put(self, "details", MappingProxyType(dict(self.details)))

    @property
    def laser_shape(self) -> tuple[int, ...]:
        """Shape of the grid or list of laser points, such as (ny, nx); () for a single point."""
        return self.laser_points.shape[:-1]

    @property
    def sensor_shape(self) -> tuple[int, ...]:
        """Shape of the grid or list of sensor points, such as (ny, nx); () for a single point."""
        return self.sensor_points.shape[:-1]

    @property
    def n_bins(self) -> int:
        """Number of time bins."""
        return int(self.H.shape[0])

    @property
    def edges(self) -> Array:
        """Edges of the bins, (n_bins + 1,), m of optical path."""
        return self.t_start + self.delta_t * np.arange(self.n_bins + 1)

    @property
    def times(self) -> Array:
        """Centres of the bins, (n_bins,), m of optical path."""
        return self.t_start + self.delta_t * (np.arange(self.n_bins) + 0.5)

    @property
    def is_confocal(self) -> bool:
        """Whether each laser point is observed only at itself, to 1e-9 m."""
        return self.pairing == "confocal" and bool(
            np.allclose(self.laser_points, self.sensor_points, rtol=0.0, atol=1e-9)
        )

    def _figures(self) -> Figures:
        def told(shape: tuple[int, ...]) -> str:
            return " x ".join(map(str, shape)) or "one point"

        low, high = float(self.edges[0]), float(self.edges[-1])
        figures = {
            "bins": f"{self.n_bins} of {1e3 * self.delta_t:.4g} mm, {low:.4g} to {high:.4g} m",
            "laser points": told(self.laser_shape),
            "sensor points": told(self.sensor_shape),
            "pairing": self.pairing,
            "quantity": self.quantity,
            "outer legs": "included in times" if self.outer_legs else "not included in times",
        }
        alt = "Intensity at the relay wall: optical path against sensor position"
        return Figures("Transient", figures, alt)

    def _labels(self) -> Labels:
        shapes = {"laser": self.laser_shape, "sensor": self.sensor_shape}
        axes = {
            part: [f"{part}_{n}" for n in (("row", "column") if len(s) == 2 else range(len(s)))]
            for part, s in shapes.items()
        }
        names = ["path", *axes["laser"], *axes["sensor"]]
        if self.pairing == "confocal":
            axes["laser"] = axes["sensor"]
            names = ["path", *axes["sensor"]]
        unit = {"irradiance": "1/m^2", "radiosity": "1/m^2", "radiance": "1/(m^2 sr)"}
        told = unit.get(self.quantity, "1")
        arrays = {"H": variable(names, self.H, told, self.quantity)}
        if self.standard_error is not None:
            arrays["standard_error"] = variable(names, self.standard_error, told, "standard error")
        for bounces, part in self.by_bounce.items():
            arrays[f"H_{bounces}"] = variable(names, part, told, f"light of {bounces} reflections")
        where = {
            "path": variable(["path"], self.times, "m", "optical path"),
            "time": variable(["path"], self.times / 299792458.0, "s", "time"),
        }
        for end, dimensions in axes.items():
            points = getattr(self, f"{end}_points")
            for i, axis in enumerate("xyz"):
                name = f"{end} point, world {axis}"
                where[f"{end}_{axis}"] = variable(dimensions, points[..., i], "m", name)
        return Labels(arrays, where, {"pairing": self.pairing, "delta_t": self.delta_t})

    def with_details(self, **more: Any) -> TransientCapture:
        """Return a copy of the capture with additional ``details``.

        Parameters
        ----------
        **more
            Entries to add to ``details``, by name. An existing entry of the same name is replaced.

        Returns
        -------
        TransientCapture
            Capture with the same data and all details.
        """
        return replace(self, details={**self.details, **more})

    def of_laser(self, index: int) -> TransientCapture:
        """Return the part of one laser point, as the virtual camera "transient" needs it.

        Parameters
        ----------
        index : int
            Index of the laser point, counted over the rows of a grid.

        Returns
        -------
        TransientCapture
            Capture of this laser point at all sensor points.

        Raises
        ------
        SceneError
            If the capture has pairs of points, or no such laser point.
        """
        if self.pairing == "confocal":
            raise SceneError("a confocal capture has no laser point for all sensors; omit of_laser")
        count = self.laser_points.size // 3
        which = np.unravel_index(whole("index", index, 0, count - 1), self.laser_shape)

        def part(values: Any) -> Any:
            return None if values is None else values[(slice(None), *which)]

        normals = self.laser_normals
        return replace(
            self,
            H=part(self.H),
            laser_points=self.laser_points[which],
            laser_normals=None if normals is None else normals[which],
            by_bounce={n: part(light) for n, light in self.by_bounce.items()},
            standard_error=part(self.standard_error),
            details={},
        )

    def save(self, path: str | Path, *, compression: int = 0) -> None:
        """Write the capture to an HDF5 file, in the layout of the transient imaging library y-tal.

        `load` and y-tal can read the file. If writing fails, no partial file is left.

        Parameters
        ----------
        path : str or Path
            File to write; an existing file is replaced.
        compression : int
            gzip level of ``H``, 0 (not compressed) to 9.

        Raises
        ------
        SceneError
            If the file cannot be written.

        Notes
        -----
        Spatial axes are [x, y] in the file. y-tal supports grids and lists of points; points of
        any other shape are written as lists. Data that y-tal's layout lacks are stored where y-tal
        ignores them: ``by_bounce``, ``standard_error`` and arrays in ``details`` as uncompressed
        attributes of ``H``, everything else as JSON in ``scene_info``. ``details`` that JSON cannot
        express become lists or text.

        y-tal needs positions of laser and sensor even where it does not use them. An unknown one is
        therefore written as zeros and marked in ``scene_info``, so that `load` returns None again.
        If the times include the outer legs (the paths from laser to wall and from wall to sensor),
        an unknown position is left empty instead, and y-tal refuses the file.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> from nlosoptics.transient import TransientCapture
        >>> capture = TransientCapture(
        ...     H=[0.0, 1.0, 2.0], laser_points=(0, 0, 0), sensor_points=(0.1, 0, 0), delta_t=0.02
        ... )
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     capture.save(Path(folder) / "one.hdf5")
        ...     again = TransientCapture.load(Path(folder) / "one.hdf5")
        >>> print(again.H)
        [0. 1. 2.]
        """
        from .tal_files import save

        save(self, path, compression=compression)

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        array: str | None = None,
        axes: str = "t,y,x",
        side: float | tuple[float, float] | None = None,
        **values: Any,
    ) -> TransientCapture:
        """Read a capture from a file of this or another program.

        The layout is recognised from the names of the variables in the file.

        Parameters
        ----------
        path : str or Path
            HDF5 file of this library, of the library y-tal or of the data set Z-NLOS (2019); or a
            ``.mat`` file (v5 or v7.3) of the light-cone transform (LCT, 2018). In LCT files laser
            and sensor points are equal (confocal), and ``width`` is half the side of the wall; the
            first bins can be direct light, which `hidden_light` removes. Of any other HDF5,
            ``.mat`` or numpy file, name the array, its axes and the side of its wall.
        array : str, optional
            Name of an array of three axes in a file of another layout; "array" for an ``.npy``
            file. Without ``laser_points``, the capture is confocal.
        axes : str
            Order of its axes, such as "y,x,t". With a minus, as in "-y", an axis runs against the
            world's: y points up, and x to the left of a viewer who looks from the wall into the
            room.
        side : float or (float, float), optional
            Side of the wall that its points fill, or extents along x and y, m.
        **values
            Arguments of `TransientCapture` that the file does not state, such as
            ``delta_t=1.2e-3`` (4 ps) for an LCT file. An error names those that are missing. A
            value given here replaces that in the file.

        Returns
        -------
        TransientCapture
            Capture with grids ordered [y, x] and row 0 at the lowest y.

        Raises
        ------
        SceneError, SamplingError
            If the file is missing, broken or of an unknown layout; if a value is missing or not
            finite; if a bin width is so small or large that it is probably not in m; or if array
            shapes are inconsistent.

        See Also
        --------
        TransientCapture.save : Write a capture; its example also reads it.
        """
        from .reading import load_capture

        return load_capture(cls, path, values, array=array, axes=axes, side=side)

    def _bins(self, name: str, values: Any) -> Array:
        try:
            array = np.asarray(values)
        except ValueError:
            raise SamplingError(
                f"{name} has rows of several lengths; give rows of equal length"
            ) from None
        if array.dtype not in (np.float32, np.float64):
            if array.dtype.kind not in "iuf":
                raise SceneError(
                    f"{name} of type {array.dtype} is not an array of real numbers; give floats"
                )
            array = array.astype(np.float64)
        shape = pair_shape(self.pairing, self.laser_shape, self.sensor_shape)
        if array.ndim == 0 or array.shape[0] == 0 or array.shape[1:] != shape:
            raise SamplingError(
                f"{name} has shape {array.shape}, must be (n_bins, {str(shape).strip('(),')}) for "
                f"these points and pairing = {self.pairing!r}"
            )
        n_bad = int(array.size - np.count_nonzero(np.isfinite(array)))
        if n_bad:
            raise SceneError(
                f"{name} has {n_bad} of {array.size} values that are not finite; replace them"
            )
        with np.errstate(over="ignore"):
            if not np.isfinite(np.abs(array).sum(dtype=np.float64)):
                raise SceneError(
                    f"{name} has values up to {np.abs(array).max():g}, whose sum is not finite; "
                    "scale the capture"
                )
        return array
