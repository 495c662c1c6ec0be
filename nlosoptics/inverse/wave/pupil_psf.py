"""A point spread function whose wave is unknown: pupil, point spread and image, differentiable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Self, Unpack

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from ..._checks import one_of, positive
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import Boundary
from ...psf import wavefront
from ...scene import Scene
from ..data.forward import padded_transfer
from .pupil_optics import ImageOptions, Method, PupilOptics
from .pupil_waves import (
    DEFOCUS,
    SlopeWaves,
    ZernikeWaves,
    checked_slopes,
    fitted_modes,
    like,
    noll_mode,
    on_cells,
    start_values,
)

#: Known defoci beyond this, m rms, are taken for waves.
MOST_DEFOCUS = 1e-3


class PupilPSF(nn.Module):
    """Point spread of a round pupil as a function of the wave's coefficients.

    Build it by `from_zernike`, `from_slopes`, `from_angles` or `from_scene`. Everything is
    differentiable and batched: coefficients of shape (..., M), or (..., g, g, 2) for slopes, give
    point spreads (..., H, W). Start values whose slope exceeds lambda/(2 pupil cell) draw a
    warning; `steepest` tells it of any.

    Parameters
    ----------
    optics : PupilOptics
    waves : ZernikeWaves or SlopeWaves
    coefficients : array_like
        Start values of the leaves, of shape ``waves.leaf_shape`` or (..., *leaf_shape).

    Attributes
    ----------
    coefficients : torch.nn.Parameter
        Leaves, dimensionless, so that an optimiser's steps have a natural size: Zernike
        coefficients in WAVES rms over the full disc, slopes in waves per pupil radius. All other
        lengths are in m.
    """

    _defocus: Tensor

    def __init__(
        self, optics: PupilOptics, waves: ZernikeWaves | SlopeWaves, coefficients: Any
    ) -> None:
        super().__init__()
        self.optics, self.waves = optics, waves
        self.coefficients = nn.Parameter(like(optics, coefficients))
        self._checked(self.coefficients)
        if not bool(torch.isfinite(self.coefficients).all()):
            raise SceneError("coefficients hold NaN or infinity; give finite start values")
        self.register_buffer("_defocus", like(optics, noll_mode(DEFOCUS, optics)))
        optics.warn_of_steps(self.aberration().detach() / optics.wavelength)

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

    @classmethod
    def from_slopes(
        cls,
        slopes: ArrayLike,
        *,
        slope_pitch: float,
        wavelength: float,
        pupil_radius: float,
        image_distance: float,
        pitch: float,
        shape: int | tuple[int, int],
        **options: Unpack[ImageOptions],
    ) -> Self:
        """Wave that fits slopes on a coarse grid in the least squares, by splines between.

        Parameters
        ----------
        slopes : array_like, (g, g, 2)
            Start values of dW/du and dW/dv, rad, rows along v, node [g//2, g//2] on the axis.
        slope_pitch : float
            Between nodes, m; the grid covers the pupil.
        wavelength, pupil_radius, image_distance, pitch, shape
            As of `from_zernike`.
        **options
            ``method``, ``samples``, ``pixel_integrated``, ``device`` and ``dtype`` of
            `from_zernike`.

        Returns
        -------
        PupilPSF
            ``coefficients`` (g, g, 2) are the slopes in waves per pupil radius.

        Raises
        ------
        SceneError, SamplingError
            As of `from_zernike`, and if the slopes are not finite or leave a part of the pupil.

        Notes
        -----
        The wave is that of `psf.wavefront_from_slopes` on the whole grid, by its filter
        (`psf.pupil.slope_integration.slope_filter`). What of the slopes no wave has is in
        `curl_residual`.
        """
        optics = PupilOptics(
            wavelength=wavelength,
            pupil_radius=pupil_radius,
            image_distance=image_distance,
            pitch=pitch,
            shape=shape,
            **options,
        )
        slope_pitch = positive("slope_pitch", slope_pitch, unit="m")
        values = checked_slopes(slopes, slope_pitch, optics)
        waves = SlopeWaves(len(values), slope_pitch, optics)
        return cls(optics, waves, values * (optics.pupil_radius / optics.wavelength))

    @classmethod
    def from_angles(
        cls,
        angles: ArrayLike,
        *,
        angle_pitch: float,
        wavelength: float,
        pupil_radius: float,
        image_distance: float,
        pitch: float,
        shape: int | tuple[int, int],
        **options: Unpack[ImageOptions],
    ) -> Self:
        """Wave of the angles at which light leaves the exit pupil.

        Parameters
        ----------
        angles : array_like, (g, g, 2)
            Start values, rad, from the axis toward u and toward v, rows along v: the ray of a node
            meets the image at ``tan(angle) image_distance``, so its slope is the tangent.
        angle_pitch : float
            Between nodes, m.
        wavelength, pupil_radius, image_distance, pitch, shape, **options
            As of `from_slopes`.

        Returns
        -------
        PupilPSF
            That of `from_slopes`.

        Raises
        ------
        SceneError, SamplingError
            As of `from_slopes`, and if an angle is not below pi/2.
        """
        try:
            values = np.asarray(angles, dtype=np.float64)
        except (TypeError, ValueError):
            raise SceneError("angles are not an array of real numbers; give (g, g, 2)") from None
        if values.size and not np.abs(values).max() < np.pi / 2:
            raise SceneError(
                f"angles reach {np.abs(values).max():.3g} rad, must stay below pi/2; give finite "
                "angles from the axis"
            )
        return cls.from_slopes(
            np.tan(values),
            slope_pitch=angle_pitch,
            wavelength=wavelength,
            pupil_radius=pupil_radius,
            image_distance=image_distance,
            pitch=pitch,
            shape=shape,
            **options,
        )

    @classmethod
    def from_scene(
        cls,
        scene: Scene,
        modes: Sequence[int],
        *,
        pitch: float,
        shape: int | tuple[int, int],
        object_point: ArrayLike | None = None,
        **options: Unpack[ImageOptions],
    ) -> Self:
        """Wave of a scene whose wall is known nearly: its own W is the start.

        Parameters
        ----------
        scene : Scene
        modes : sequence of int
            Noll indices that may change, as of `from_zernike`. They start at their least-squares
            fit to W; what they leave of W stays as it is.
        pitch, shape
            As of `from_zernike`; the image's pixels are ``scene.camera``'s pixels binned.
        object_point : array_like, (3,), optional
            World, m; by default the hidden object's reference point.
        **options
            As of `from_slopes`.

        Returns
        -------
        PupilPSF

        Raises
        ------
        CausticError, NotWaveGradeError, SamplingError, SceneError
            As of `psf.wavefront` on polar nodes, and of `from_zernike`.
        """
        wave = wavefront(scene, object_point, "polar")
        series = wave.series(wave.amplitude)
        optics = PupilOptics(
            wavelength=wave.wavelength,
            pupil_radius=wave.pupil_radius,
            image_distance=wave.image_distance,
            pitch=pitch,
            shape=shape,
            transmission=partial(on_cells, series),
            **options,
        )
        known, fit = fitted_modes(wave, modes, optics)
        return cls(optics, ZernikeWaves(modes, optics, known), fit)

    @property
    def holds_more(self) -> bool:
        """Whether a wave or a transmission is known that its leaves do not tell."""
        known = isinstance(self.waves, ZernikeWaves) and self.waves.rest is not None
        return known or self.optics.amplitude is not self.optics.share

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
        """Noll indices of the coefficients; empty for slopes."""
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

        Raises
        ------
        SamplingError
            If a shape or the coefficients' dtype does not fit.
        SceneError
            If the coefficients are no tensor, or a defocus is not finite or not in metres.
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
        SceneError
            If it is no tensor; or as of `forward`.
        """
        one_of("boundary", boundary, ("padded", "circular"))
        if not isinstance(object_image, Tensor):
            raise SceneError(
                f"object_image of type {type(object_image).__name__} is no tensor; give "
                "torch.from_numpy(picture)"
            )
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
        if coefficients is None:
            coefficients = self.coefficients
        turns: Tensor = self.waves.unwrapped(self._checked(coefficients))
        return turns * self.wavelength

    def steepest(self, coefficients: Tensor | None = None) -> float:
        """Largest step of W between neighbouring cells of the pupil, waves.

        Above 1/2, which is a slope of lambda/(2 cell), the cells no longer hold the wave.
        """
        with torch.no_grad():
            return self.optics.steepest(self.aberration(coefficients) / self.wavelength)

    def curl_residual(self, coefficients: Tensor | None = None) -> float:
        """Rms of what the slopes between neighbours differ by from those of the wave, rad.

        0 for a sum of modes, which is a wave already. See `psf.wavefront_from_slopes`.
        """
        if not isinstance(self.waves, SlopeWaves):
            return 0.0
        leaves = self._checked(self.coefficients if coefficients is None else coefficients)
        return self.waves.curl_residual(leaves) * self.wavelength / self.optics.pupil_radius

    def _checked(self, coefficients: Tensor) -> Tensor:
        wanted = self.waves.leaf_shape
        if not isinstance(coefficients, Tensor):
            raise SceneError(
                f"coefficients of type {type(coefficients).__name__} are no tensor; give "
                "torch.tensor(values)"
            )
        if tuple(coefficients.shape[-len(wanted) :]) != wanted:
            raise SamplingError(
                f"coefficients have shape {tuple(coefficients.shape)}, must end in {wanted}; "
                "give one value per leaf"
            )
        if coefficients.dtype != self.coefficients.dtype:
            raise SamplingError(
                f"coefficients are {coefficients.dtype}, the point spread "
                f"{self.coefficients.dtype}; give coefficients.to(...) or build it with that dtype"
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
        try:
            extra = torch.as_tensor(defocus, dtype=turns.dtype, device=turns.device)
        except (TypeError, ValueError):
            raise SceneError(
                f"defocus of type {type(defocus).__name__} holds no numbers; give metres, one "
                "value per frame"
            ) from None
        if extra.ndim != 1:
            raise SamplingError(
                f"defocus has shape {tuple(extra.shape)}, must be (K,); give one value per frame"
            )
        told = extra.detach()
        if not bool((told.abs() <= MOST_DEFOCUS).all()):  # nor is NaN
            raise SceneError(
                f"defocus = {told.tolist()} m rms, limit {MOST_DEFOCUS:g}; give metres, not waves"
            )
        return turns.unsqueeze(-3) + self.defocus_turns(extra)

    def defocus_turns(self, extra: Tensor) -> Tensor:
        """Known defoci (K,), m rms, over the wavelength, (K, rows, columns)."""
        return (extra / self.wavelength)[:, None, None] * self._defocus
