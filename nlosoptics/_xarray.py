"""Results as xarray datasets, with coordinates and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from .errors import MissingExtraError

if TYPE_CHECKING:
    import xarray as xr

#: Dimensions, values and attributes of a variable, as xarray takes them.
Variable = tuple[Sequence[str], Any, dict[str, str]]


class Labels(NamedTuple):
    """Contents of a dataset."""

    variables: Mapping[str, Variable]
    coordinates: Mapping[str, Variable]
    attributes: Mapping[str, Any]


def variable(dimensions: Sequence[str], values: Any, unit: str, name: str) -> Variable:
    """Return a variable with its unit and its long name."""
    return tuple(dimensions), values, {"units": unit, "long_name": name}


def pixels(shape: tuple[int, ...], pitch: float) -> dict[str, Variable]:
    """Return the coordinates x and y of the pixel centres of an image, (ny, nx), m."""
    import numpy as np

    return {
        axis: variable([axis], (np.arange(n) - (n - 1) / 2) * pitch, "m", f"detector {axis}")
        for axis, n in zip("yx", shape, strict=True)
    }


class Labelled:
    """Base of nouns that can be turned into a dataset: they state its contents."""

    def _labels(self) -> Labels:
        raise NotImplementedError

    def to_xarray(self) -> xr.Dataset:
        """Return the arrays as an ``xarray.Dataset`` with coordinates and units.

        Returns
        -------
        xarray.Dataset
            Arrays by name. Each, and each coordinate, has the attributes ``units`` (SI) and
            ``long_name``. Single values, such as a wavelength, are attributes of the dataset.

        Raises
        ------
        MissingExtraError
            If xarray is not installed.
        """
        try:
            import xarray as xr
        except ImportError:
            raise MissingExtraError(
                "to_xarray() needs xarray; run pip install 'nlosoptics[study]'"
            ) from None
        return xr.Dataset(*self._labels())
