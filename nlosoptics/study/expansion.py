"""Second-order expansion of fields, such as the aberration at pupil nodes, in scene values."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError

Array = NDArray[np.float64]
Fields = Mapping[str, Array]
#: Largest error of a derivative times a unit step. Fields have units in which it is negligible.
PRECISE = 1e-6
MOST_HALVINGS = 6  # of the step of differences


@dataclass(frozen=True, eq=False, kw_only=True)
class Expansion:
    """Fields at the middle of some values, with all first and second derivatives.

    Parameters
    ----------
    shapes : mapping of str to tuple
        Shape of each field.
    terms : ndarray, (1 + d + d (d + 1)/2, m)
        Coefficients of `monomials` for the joined fields of m values.
    """

    shapes: Mapping[str, tuple[int, ...]]
    terms: Array

    @classmethod
    def of(cls, fields: Callable[[tuple[float, ...]], Fields], size: int) -> Expansion:
        """Expand fields by differences whose steps are halved until they agree.

        Parameters
        ----------
        fields : callable
            Function of ``size`` coordinates, 0 in the middle and about 1 for a usual deviation.
            It returns fields of constant shapes.
        size : int
            Number of coordinates d.

        Raises
        ------
        SceneError
            If a derivative is uncertain by more than `PRECISE`.

        Notes
        -----
        Central differences at steps 1, 1/2, 1/4, ... are extrapolated to step 0 by Richardson's
        method. Mixed derivatives follow from second differences along the sum of two axes.
        """
        middle = fields((0.0,) * size)
        centre = _joined(middle)

        def along(*axes: int) -> Array:
            def at(step: float) -> Array:
                return _joined(fields(tuple(step * (i in axes) for i in range(size))))

            return _derivatives(at, centre)

        single = [along(i) for i in range(size)]
        mixed = [
            along(i, j)[1] - single[i][1] - single[j][1]
            for i, j in itertools.combinations(range(size), 2)
        ]
        firsts, seconds = ([pair[k] / (1 + k) for pair in single] for k in (0, 1))
        return cls(
            shapes={name: np.shape(field) for name, field in middle.items()},
            terms=np.stack([centre, *firsts, *seconds, *(both / 2 for both in mixed)]),
        )

    def at(self, coordinates: Array) -> dict[str, Array]:
        """Return all fields at coordinates (n, d), with n as their first dimension."""
        # einsum does not call BLAS, so results are bit-identical for any thread count.
        found: Array = np.einsum("nt,tm->nm", monomials(coordinates), self.terms)
        sizes = [int(np.prod(shape)) for shape in self.shapes.values()]
        parts = np.split(found, np.cumsum(sizes)[:-1], axis=1)
        return {
            name: part.reshape(len(found), *shape)
            for part, (name, shape) in zip(parts, self.shapes.items(), strict=True)
        }


def first_steps(size: int) -> list[tuple[float, ...]]:
    """Return the middle and the first places about it at which `Expansion.of` needs fields."""
    axes = [(i,) for i in range(size)] + list(itertools.combinations(range(size), 2))
    steps = [
        tuple(step * (i in some) for i in range(size)) for some in axes for step in (1.0, -1.0)
    ]
    return [(0.0,) * size, *steps]


def monomials(coordinates: Array) -> Array:
    """Return 1, all coordinates, their squares and products of two, for coordinates (n, d)."""
    columns = [np.ones(len(coordinates)), *coordinates.T, *(coordinates**2).T]
    columns += [a * b for a, b in itertools.combinations(coordinates.T, 2)]
    return np.stack(columns, axis=1)


def _joined(fields: Fields) -> Array:
    return np.concatenate([np.ravel(field) for field in fields.values()])


def _derivatives(at: Callable[[float], Array], centre: Array) -> Array:
    """Return first and second derivatives (2, m) along a line at 0, where the value is known."""
    before: list[Array] = []
    error = np.inf
    for halving in range(MOST_HALVINGS + 1):
        step = 0.5**halving
        up, down = at(step), at(-step)
        row = [np.stack([(up - down) / (2 * step), (up - 2 * centre + down) / step**2])]
        for k, coarser in enumerate(before):
            row.append(row[k] + (row[k] - coarser) / (4.0 ** (k + 1) - 1))
        if before:
            error = float(np.abs(row[-1] - before[-1]).max(initial=0.0))
            if error <= PRECISE:
                return row[-1]
        before = row
    raise SceneError(
        f"derivatives of the wave change by {error:.2g} waves when steps are halved, limit "
        f"{PRECISE:g}; use tier = 'full', or narrower distributions"
    )
