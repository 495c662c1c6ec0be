"""Differentiable point spread of independent facets: density of their rays in the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from ..._checks import fits_memory, positive
from ...errors import SamplingError
from ...psf.aperture.quadrature_nodes import circle_shares
from ...psf.window.window import shape_of
from .pupil_optics import centred, check_precision, checked_distance, checked_wavelength
from .pupil_waves import checked_tangents


class FacetPSF(nn.Module):
    """Differentiable point spread function (PSF) of a round pupil of independent facets.

    The exit pupil is divided into square facets. Each facet sends its light to one point of the
    image, at the distance ``tan(angle) * image_distance`` from the centre; with all angles 0 the
    image is in perfect focus. Unlike in `PupilPSF`, the facets form no continuous wave, and their
    light does not interfere. Angles and pixels may therefore have any size. Use this model for
    spots that are much wider than wavelength times F-number. All methods accept batches of
    coefficients (..., g, g, 2).

    Parameters
    ----------
    angles : array_like, (g, g, 2)
        Start values of the angles by which the g x g facets deflect light away from the centre of
        the image, rad. The last axis holds the angles toward +u (x in the image) and toward +v (y).
        The first index counts facets along v, the second along u. Facet [g//2, g//2] is on the
        axis. Facets outside the pupil have no effect.
    angle_pitch : float
        Side of a facet, m. The facets must cover the pupil.
    pupil_radius : float
        Radius of the exit pupil, m.
    image_distance : float
        Distance from the exit pupil to the image, m; negative if the pupil lies beyond the image.
    pitch : float
        Pixel pitch of the image, m.
    shape : int or (int, int)
        Image rows H and columns W; one number for a square. The image is periodic.
    wavelength : float, optional
        Wavelength, m, of the diffraction at each facet. By default only rays are used, without
        diffraction.
    device : torch.device or str
        Device of the tensors.
    dtype : torch.dtype
        Precision, ``torch.float32`` or ``torch.float64``.

    Attributes
    ----------
    coefficients : torch.nn.Parameter
        Fit parameters (g, g, 2): image coordinates x and y at which the light of each facet
        arrives, relative to the centre, pixels. They start at
        ``tan(angles) * image_distance / pitch``.

    Raises
    ------
    SceneError
        If a length or an angle is out of range.
    SamplingError
        If the facets do not cover the pupil.

    See Also
    --------
    PupilPSF : Point spread of a continuous wave.
    wu2024_fit : Fit of exit angles and a network.

    Notes
    -----
    The light of a facet fills a square of one pixel around the point where its ray lands. The
    energy of a pixel is therefore a bilinear function of the displacement and has a gradient. With
    a wavelength lambda, the transfer function at the spatial frequency (f_x, f_y) is multiplied by
    that of a square aperture of side c (``angle_pitch``),
    ``(1 - lambda d |f_x|/c)(1 - lambda d |f_y|/c)``, with d the image distance; a negative factor
    is replaced by 0. Facets at the pupil's edge are weighted by their area inside the pupil, but
    diffract like whole ones.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import FacetPSF
    >>> angles = np.random.default_rng(1).normal(0.0, 2e-3, size=(16, 16, 2))
    >>> pupil = {"angle_pitch": 0.85e-3, "pupil_radius": 6.25e-3, "image_distance": 0.025}
    >>> spread = FacetPSF(angles, **pupil, pitch=12e-6, shape=32)().detach()
    >>> tuple(spread.shape), round(float(spread.sum()), 4)
    ((32, 32), 1.0)
    """

    _share: Tensor
    _slopes: Tensor
    _facet: Tensor | None

    def __init__(
        self,
        angles: ArrayLike,
        *,
        angle_pitch: float,
        pupil_radius: float,
        image_distance: float,
        pitch: float,
        shape: int | tuple[int, int],
        wavelength: float | None = None,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        check_precision(dtype)
        self.angle_pitch = positive("angle_pitch", angle_pitch, unit="m")
        self.pupil_radius = positive("pupil_radius", pupil_radius, unit="m")
        self.image_distance = checked_distance(image_distance)
        self.pitch = positive("pitch", pitch, unit="m")
        self.shape = shape_of(shape)
        tangents = checked_tangents(angles, self.angle_pitch, self.pupil_radius)
        count = len(tangents)
        fits_memory(f"{count} x {count} facets", 200.0 * count**2, "use fewer facets")
        like: dict[str, Any] = {"device": device, "dtype": dtype}
        axis = (np.arange(count, dtype=np.float64) - count // 2) * self.angle_pitch
        share = circle_shares(axis, axis, self.angle_pitch, self.pupil_radius)
        self.register_buffer("_share", torch.tensor(share / share.sum(), **like))
        # displacement per metre of defocus, pixels: Noll's defocus of 1 m rms is
        # 2 sqrt(3) (u^2 + v^2)/R^2 m, apart from piston
        steepness = 4.0 * math.sqrt(3.0) / self.pupil_radius**2 * self.image_distance / self.pitch
        u, v = np.meshgrid(axis, axis)
        self.register_buffer("_slopes", torch.tensor(steepness * np.stack([u, v], -1), **like))
        self.wavelength = None
        facet = None
        if wavelength is not None:
            self.wavelength = checked_wavelength(wavelength)
            facet = torch.tensor(self._facet_transfer(self.wavelength), **like)
        self.register_buffer("_facet", facet)
        moved = tangents * (self.image_distance / self.pitch)
        self.coefficients = nn.Parameter(torch.tensor(moved, **like))

    def forward(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Compute the PSF: energy per pixel, (..., H, W), or (..., K, H, W) with ``defocus``.

        It sums to 1 and is centred at [H//2, W//2]. ``coefficients``, (..., g, g, 2) in pixels, are
        by default the attribute of this name; ``defocus`` is that of `PupilPSF`. A `SamplingError`
        is raised if the coefficients' shape does not match.
        """
        if self._facet is None:
            return centred(self._density(coefficients, defocus))
        transfer = self.transfer(coefficients, defocus=defocus)
        return centred(torch.fft.irfft2(transfer, s=self.shape))

    def transfer(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Compute the transfer function, complex, (..., H, W//2 + 1) or (..., K, H, W//2 + 1).

        It is the ``rfft2`` of the PSF with its centre at sample [0, 0]; see `forward`.
        """
        spectrum: Tensor = torch.fft.rfft2(self._density(coefficients, defocus))
        return spectrum if self._facet is None else spectrum * self._facet

    def _density(
        self, coefficients: Tensor | None, defocus: Tensor | Sequence[float] | None
    ) -> Tensor:
        """Return the energy of the rays in each pixel, their centre at sample [0, 0]."""
        moved = self.coefficients if coefficients is None else coefficients
        wanted = tuple(self._slopes.shape)
        if tuple(moved.shape[-3:]) != wanted:
            raise SamplingError(
                f"coefficients have shape {tuple(moved.shape)}, must end in {wanted}; give one "
                "displacement per facet"
            )
        if defocus is not None:
            extra = torch.as_tensor(defocus, dtype=moved.dtype, device=moved.device)
            moved = moved.unsqueeze(-4) + extra[:, None, None, None] * self._slopes
        rows, columns = self.shape
        batch = moved.shape[:-3]
        flat = moved.reshape(-1, self._share.numel(), 2)
        first = flat.detach().floor()
        right, up = (flat - first).unbind(-1)
        column, row = first.long().unbind(-1)
        spread = flat.new_zeros(len(flat), rows * columns)
        share = self._share.reshape(-1)
        for down, tall in ((0, 1.0 - up), (1, up)):
            line = (row + down).remainder(rows) * columns
            for across, wide in ((0, 1.0 - right), (1, right)):
                place = line + (column + across).remainder(columns)
                spread = spread.scatter_add(1, place, share * tall * wide)
        return spread.reshape(*batch, rows, columns)

    def _facet_transfer(self, wavelength: float) -> NDArray[np.float64]:
        """Return the transfer function of one facet's diffraction, (H, W//2 + 1)."""
        reach = wavelength * abs(self.image_distance) / (self.angle_pitch * self.pitch)
        y, x = np.fft.fftfreq(self.shape[0]), np.fft.rfftfreq(self.shape[1])
        up, along = (np.maximum(1.0 - reach * np.abs(f), 0.0) for f in (y, x))
        return np.outer(up, along)
