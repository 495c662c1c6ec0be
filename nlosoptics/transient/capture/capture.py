"""What a time-resolved capture holds: light at wall points over time, per laser point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import Vector, one_of, positive, real, vector, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from .wall_points import checked_points, pair_shape

Array = NDArray[np.floating]
Pairing = Literal["all", "confocal"]
Quantity = Literal["irradiance", "radiance", "radiosity", "counts", "unknown"]

QUANTITIES = ("irradiance", "radiance", "radiosity", "counts", "unknown")


@dataclass(frozen=True, eq=False, kw_only=True)
class TransientCapture(Noun, Shown):
    """Light at points of the relay wall in bins of optical path.

    The wall is the plane z = 0 with its normal +z, unless normals say otherwise. Grids of points
    are [y, x], row 0 at the lowest y.

    Parameters
    ----------
    H : array_like
        (n_bins, *laser_shape, *sensor_shape) where each laser point is seen at each sensor point
        (``pairing="all"``), (n_bins, *shape) where each at its own (``"confocal"``, which need not
        be the same point). The integral over each bin, not a density. Single precision is kept.
    laser_points, sensor_points : array_like
        (*laser_shape, 3) and (*sensor_shape, 3), m. One point may be (3,): it adds no axis.
    delta_t : float
        Width of a bin, m of optical path.
    t_start : float
        Where bin 0 begins, m of optical path.
    pairing : {"all", "confocal"}
    quantity : {"irradiance", "radiance", "radiosity", "counts", "unknown"}
    outer_legs : bool
        Whether the times hold the legs from the laser to the wall and from the wall to the sensor.
    laser_origin, sensor_origin : array_like of 3 floats, optional
        Where the laser and the sensor stand, m; needed to take the outer legs away.
    laser_normals, sensor_normals : array_like, optional
        Of the points' shapes; None: +z.
    by_bounce : mapping of int to array_like
        Parts of ``H`` by the number of reflections, wall included: 3, 4, 5.
    standard_error : array_like, optional
        Of ``H``, same shape and unit; 0 where nothing was drawn at random.
    details : mapping
        What else a file or a renderer had to say.

    Raises
    ------
    SamplingError
        If shapes do not fit one another.
    SceneError
        If a value is not finite or out of range.
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
        one_of("pairing", self.pairing, ("all", "confocal"))
        one_of("quantity", self.quantity, QUANTITIES)
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
                        "the points"
                    )
                put(self, f"{name}_normals", normals)
            origin = getattr(self, f"{name}_origin")
            if origin is not None:
                put(self, f"{name}_origin", vector(f"{name}_origin", origin))
        put(self, "H", self._bins("H", self.H))
        if self.standard_error is not None:
            put(self, "standard_error", self._bins("standard_error", self.standard_error))
        given: Any = self.by_bounce
        if not isinstance(given, Mapping):
            kind = type(given).__name__
            raise SceneError(f"by_bounce is a {kind}; give bins by the number of reflections")
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
                    f"{name} has {len(values)} bins, must be {len(self.H)} like H; cut both alike"
                )
        put(self, "details", MappingProxyType(dict(self.details)))

    @property
    def laser_shape(self) -> tuple[int, ...]:
        """Axes of the laser points, () for one."""
        return self.laser_points.shape[:-1]

    @property
    def sensor_shape(self) -> tuple[int, ...]:
        """Axes of the sensor points, () for one."""
        return self.sensor_points.shape[:-1]

    @property
    def n_bins(self) -> int:
        """Bins of time."""
        return int(self.H.shape[0])

    @property
    def edges(self) -> Array:
        """(n_bins + 1,), m of optical path."""
        return self.t_start + self.delta_t * np.arange(self.n_bins + 1)

    @property
    def times(self) -> Array:
        """(n_bins,), the bins' middles, m of optical path."""
        return self.t_start + self.delta_t * (np.arange(self.n_bins) + 0.5)

    @property
    def is_confocal(self) -> bool:
        """Whether each laser point is seen at that very point."""
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
            "outer legs": "in the times" if self.outer_legs else "not in the times",
        }
        alt = "Light on the relay wall: optical path against sensor position"
        return Figures("Transient", figures, alt)

    def with_details(self, **more: Any) -> TransientCapture:
        """Return the same capture with more ``details``."""
        return replace(self, details={**self.details, **more})

    def save(self, path: str | Path, *, compression: int = 0) -> None:
        """Write y-tal's HDF5 layout, whole or not at all; `load` and y-tal read it.

        Space is [x, y] in the file. y-tal has grids and lists of points: other shapes are written
        as lists. What its layout lacks it does not see: ``by_bounce``, ``standard_error`` and
        arrays among the ``details`` are attributes of ``H``, the rest is in ``scene_info``, where
        ``details`` that JSON has no form for become lists or text.

        Parameters
        ----------
        path : str or Path
            An existing file is replaced.
        compression : int
            Of ``H`` by gzip, 0 (none) to 9. Attributes are never compressed.

        Raises
        ------
        SceneError
            If the file cannot be written.
        """
        from .tal_files import save

        save(self, path, compression=compression)

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        format: str | None = None,
        bin_width: float | None = None,
        t_start: float | None = None,
        side: float | None = None,
        pairing: Pairing | None = None,
        laser_point: ArrayLike | None = None,
        outer_legs: bool | None = None,
        quantity: Quantity | None = None,
        gate_start: float | None = None,
    ) -> TransientCapture:
        """Read a capture of this or another program; the layout is told by what the file holds.

        What a layout leaves open is an error that names the argument which decides. Arguments go
        before what the file says.

        Parameters
        ----------
        path : str or Path
            HDF5 of y-tal, Z-NLOS or NLOS-DIRAC; ``.mat`` (v5 or v7.3) of the phasor field (2019,
            2020) or the LCT (2018).
        format : {"tal", "znlos", "dirac", "phasor_field_2019", "phasor_field_2020", "lct"}
            Confirms a layout whose conventions its variables alone do not prove: of the LCT,
            confocal pairs and a ``width`` of half the side; of the phasor field (2020), a
            ``SPAD_index`` that counts from 0.
        bin_width : float
            m of optical path; a bin of 4 ps is 1.2e-3.
        t_start : float
            Where bin 0 begins, m of optical path.
        side : float
            Of the square wall whose cells' middles were scanned, m, whole.
        pairing : {"all", "confocal"}
        laser_point : array_like of 3 floats
            The one laser point, m.
        outer_legs : bool
            Whether the times hold the legs from the laser to the wall and on to the sensor.
        quantity : str
            Of the bins; "unknown" where nothing says it.
        gate_start : float
            m of optical path; bins that begin before it, direct light, become 0.

        Returns
        -------
        TransientCapture
            Grids [y, x], row 0 at the lowest y. Scans of the phasor field, which move the laser,
            have laser and sensor swapped, which light does not tell.

        Raises
        ------
        SceneError, SamplingError
            If the file is missing, foreign or cut short, a value is missing, not finite or in
            another unit, or arrays do not fit one another.
        """
        from .formats import load_capture

        return load_capture(
            cls,
            path,
            format=format,
            bin_width=bin_width,
            t_start=t_start,
            side=side,
            pairing=pairing,
            laser_point=laser_point,
            outer_legs=outer_legs,
            quantity=quantity,
            gate_start=gate_start,
        )

    def _bins(self, name: str, values: Any) -> Array:
        try:
            array = np.asarray(values)
        except ValueError:
            raise SamplingError(f"{name} has rows of several lengths; give them all one") from None
        if array.dtype not in (np.float32, np.float64):
            if array.dtype.kind not in "iuf":
                raise SceneError(f"{name} of type {array.dtype} is not an array of real numbers")
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
        return array
