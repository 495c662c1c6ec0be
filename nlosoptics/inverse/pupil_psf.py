"""A point spread function whose wave is unknown: pupil, point spread and image, differentiable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .._checks import one_of
from ..errors import SamplingError, SceneError
from ..imaging.forward_model import Boundary
from .padding import padded_transfer
from .pupil_optics import Method, PupilOptics
from .pupil_waves import DEFOCUS, ZernikeWaves, like, noll_mode, start_values

Array = NDArray[np.float64]


class PupilPSF(nn.Module):
    """Point spread of a round pupil as a function of the wave's coefficients.

    Build it by `from_zernike`. Everything is differentiable and batched: coefficients of shape
    (..., M) give point spreads (..., H, W).

    Parameters
    ----------
    optics : PupilOptics
    waves : ZernikeWaves
    coefficients : array_like
        Start values of the leaves, of shape ``waves.leaf_shape`` or (..., *leaf_shape).

    Attributes
    ----------
    coefficients : torch.nn.Parameter
        Leaves. Zernike coefficients are in WAVES rms over the full disc, dimensionless, so that
        an optimiser's steps have a natural size; all other lengths are in m.
    """

    _defocus: Tensor

    def __init__(self, optics: PupilOptics, waves: ZernikeWaves, coefficients: Any) -> None:
        super().__init__()
        self.optics, self.waves = optics, waves
        self.coefficients = nn.Parameter(like(optics, coefficients))
        self._checked(self.coefficients)
        if not bool(torch.isfinite(self.coefficients).all()):
            raise SceneError("coefficients hold NaN or infinity; give finite start values")
        self.register_buffer("_defocus", like(optics, noll_mode(DEFOCUS, optics)))

    @classmethod
    def from_zernike(
        cls,
        modes: Sequence[int] | Mapping[int, float],
        *,
        wavelength: float,
        pupil_radius: float,
        image_distance: float,
        pitch: float,
        shape: int | tuple[int, int],
        method: Method = "fft",
        samples: int | None = None,
        pixel_integrated: bool = False,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> Self:
        """Wave of Zernike polynomials on a clear round pupil.

        Parameters
        ----------
        modes : sequence of int, or mapping of int to float
            Noll indices from 2 on, or index to start value, m rms; without values all start at 0.
        wavelength, pupil_radius, image_distance : float
            m; the distance is signed, from pupil to image.
        pitch : float
            Of the image, m.
        shape : int or (int, int)
            Image rows H and columns W.
        method : {"fft", "mdft"}
            "fft": the image is one period, the transfer function that of a circular frame.
            "mdft": a window of the plane, by matrix products.
        samples : int, optional
            For "mdft": pupil cells per side; by default the period is twice the window.
        pixel_integrated : bool
            Integrate over square detector pixels of side ``pitch``, which may then be any; point
            samples need a pitch of at most lambda |d|/(4 radius).
        device, dtype
            ``torch.float32`` or ``torch.float64``.

        Returns
        -------
        PupilPSF

        Raises
        ------
        SceneError
            If a length or mode is out of range.
        SamplingError
            If the pitch, shape or samples cannot hold the pupil or the image.
        """
        optics = PupilOptics(
            wavelength=wavelength,
            pupil_radius=pupil_radius,
            image_distance=image_distance,
            pitch=pitch,
            shape=shape,
            method=method,
            samples=samples,
            pixel_integrated=pixel_integrated,
            device=device,
            dtype=dtype,
        )
        return cls(optics, ZernikeWaves(modes, optics), start_values(modes, wavelength))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the point spread."""
        return self.optics.shape

    @property
    def pitch(self) -> float:
        """Of the image, m."""
        return self.optics.pitch

    @property
    def wavelength(self) -> float:
        """In m."""
        return self.optics.wavelength

    @property
    def modes(self) -> tuple[int, ...]:
        """Noll indices of the coefficients."""
        return self.waves.modes

    def forward(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Point spread, (..., H, W), centre at [H//2, W//2].

        Parameters
        ----------
        coefficients : Tensor, optional
            (..., M), waves rms; default the module's own.
        defocus : Tensor or sequence of float, optional
            (K,), known further defocus, m rms (Noll 4): the result is (..., K, H, W).

        Returns
        -------
        Tensor
            By "fft" it sums to 1, by "mdft" the whole plane does.
        """
        return self.optics.point_spread(self._turns(coefficients, defocus))

    def transfer(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """``rfft2`` of `forward`, origin at sample [0, 0], (..., H, W//2 + 1), complex.

        What `torch.fft.rfft2` of an object is multiplied by for an image in a circular frame.
        """
        return self.optics.transfer(self._turns(coefficients, defocus))

    def image(
        self,
        object_image: Tensor,
        coefficients: Tensor | None = None,
        *,
        defocus: Tensor | Sequence[float] | None = None,
        gain: Tensor | float = 1.0,
        background: Tensor | float = 0.0,
        boundary: Boundary = "padded",
    ) -> Tensor:
        """Image of an object: ``gain * (point spread convolved with object) + background``.

        Parameters
        ----------
        object_image : Tensor
            (..., h, w), on the image's pixels; of the point spread's shape where ``boundary`` is
            "circular". Its batch and that of the coefficients broadcast.
        coefficients, defocus
            As of `forward`; with ``defocus`` the result is (..., K, h, w).
        gain, background : float or Tensor
            Image units; tensors broadcast against the result.
        boundary : {"padded", "circular"}
            As of `imaging.ForwardModel`: nothing around the object, or its periodic copies.

        Returns
        -------
        Tensor
            (..., h, w).

        Raises
        ------
        SamplingError
            If the object does not fit the frame.
        """
        one_of("boundary", boundary, ("padded", "circular"))
        frame = tuple(object_image.shape[-2:])
        if object_image.ndim < 2 or 0 in frame:
            raise SamplingError(
                f"object_image has shape {tuple(object_image.shape)}, must be (..., h, w)"
            )
        if boundary == "circular":
            if frame != self.shape:
                raise SamplingError(
                    f"object_image has shape {tuple(object_image.shape)}, must end in {self.shape} "
                    "like the point spread; resample it, or use boundary='padded'"
                )
            grid, transfer = self.shape, self.transfer(coefficients, defocus=defocus)
        else:
            spread = self(coefficients, defocus=defocus)
            grid, transfer = padded_transfer(spread, (frame[0], frame[1]))
        if defocus is not None:
            object_image = object_image.unsqueeze(-3)
        seen: Tensor = torch.fft.irfft2(torch.fft.rfft2(object_image, s=grid) * transfer, s=grid)
        seen = gain * seen[..., : frame[0], : frame[1]] + background
        return seen

    def aberration(self, coefficients: Tensor | None = None) -> Tensor:
        """W on the pupil's cells, m, (..., n_v, n_u), 0 outside the pupil."""
        return self._turns(coefficients, None) * self.wavelength

    def _checked(self, coefficients: Tensor) -> Tensor:
        wanted = self.waves.leaf_shape
        if tuple(coefficients.shape[-len(wanted) :]) != wanted:
            raise SamplingError(
                f"coefficients have shape {tuple(coefficients.shape)}, must end in {wanted}; "
                "give one value per leaf"
            )
        return coefficients

    def _turns(
        self, coefficients: Tensor | None, defocus: Tensor | Sequence[float] | None
    ) -> Tensor:
        """Aberration over wavelength."""
        if coefficients is None:
            coefficients = self.coefficients
        turns: Tensor = self.waves(self._checked(coefficients))
        if defocus is None:
            return turns
        extra = torch.as_tensor(defocus, dtype=turns.dtype, device=turns.device)
        if extra.ndim != 1:
            raise SamplingError(
                f"defocus has shape {tuple(extra.shape)}, must be (K,); give one value per frame"
            )
        frames = (extra / self.wavelength)[:, None, None] * self._defocus
        return turns.unsqueeze(-3) + frames
