"""Differentiable point spread and image as functions of the wave in the pupil."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Self, Unpack

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
    checked_tangents,
    fitted_modes,
    like,
    noll_mode,
    on_cells,
    start_values,
)

#: Largest plausible known defocus, m rms; larger values were probably given in waves.
MOST_DEFOCUS = 1e-3


class PupilPSF(nn.Module):
    """Point spread of a round pupil as a differentiable function of the wave's coefficients.

    Build it by `from_zernike`, `from_slopes`, `from_angles` or `from_scene`. All methods accept
    batches: coefficients of shape (..., M), or (..., g, g, 2) for slopes, give point spreads
    (..., H, W). A warning is issued if W changes by more than half a wavelength between
    neighbouring pupil samples for the start values; `steepest` returns this change for any
    coefficients.

    Parameters
    ----------
    optics : PupilOptics
        Pupil, image grid and transform.
    waves : ZernikeWaves or SlopeWaves
        Parametrisation of the wave.
    coefficients : array_like, (..., M) or (..., g, g, 2)
        Start values of the coefficients.

    Attributes
    ----------
    coefficients : torch.nn.Parameter
        Fit parameters, dimensionless, so that optimiser steps have a natural size: Zernike
        coefficients in waves (not metres) rms over the full disc, slopes in waves per pupil
        radius. All other lengths are in m.

    See Also
    --------
    SceneLeaves : Differentiable PSF of scene parameters.
    pcin : Entry point of the blind solvers.
    nlosoptics.psf.point_spread : PSF of a given wave.
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
            raise SceneError("coefficients contain NaN or infinity; give finite start values")
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
        """Build a point spread whose wave is a sum of Zernike modes on a clear round pupil.

        Parameters
        ----------
        modes : sequence of int, or mapping of int to float
            Noll indices from 2, or a mapping from index to start value, m rms. Without values all
            coefficients start at 0.
        wavelength, pupil_radius : float
            Vacuum wavelength and radius of the exit pupil, m.
        image_distance : float
            Signed distance from exit pupil to image, m.
        pitch : float
            Pitch of the image samples, m.
        shape : int or (int, int)
            Image rows H and columns W.
        method : {"fft", "mdft"}
            "fft": the image is periodic, and the transfer function is that of a circular frame.
            "mdft": the image is a window of the image plane, computed by matrix products.
        samples : int, optional
            For "mdft": pupil cells per side; by default the period is twice the window.
        pixel_integrated : bool
            Whether to integrate over square detector pixels of side ``pitch``, which can then have
            any size. Point samples need a pitch of at most lambda |d|/(4 radius).
        device : torch.device or str
            Device of the tensors.
        dtype : torch.dtype
            Precision, ``torch.float32`` or ``torch.float64``.

        Returns
        -------
        PupilPSF
            Point spread with ``coefficients`` of shape (M,), waves rms.

        Raises
        ------
        SceneError
            If a length or mode is out of range.
        SamplingError
            If pitch, shape or samples do not resolve the pupil or the image.

        Examples
        --------
        >>> from nlosoptics.inverse import PupilPSF
        >>> optics = {"wavelength": 633e-9, "pupil_radius": 5e-3, "image_distance": 0.05}
        >>> pupil = PupilPSF.from_zernike({4: 50e-9, 5: 0.0}, **optics, pitch=1.5e-6, shape=32)
        >>> spread = pupil().detach()
        >>> tuple(spread.shape), round(float(spread.sum()), 4)
        ((32, 32), 1.0)
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
        """Build a point spread whose wave is the least-squares fit to slopes on a coarse grid.

        Parameters
        ----------
        slopes : array_like, (g, g, 2)
            Start values of dW/du and dW/dv, rad, with rows along v and node [g//2, g//2] on the
            axis. The wave is interpolated by splines between the nodes.
        slope_pitch : float
            Distance between nodes, m; the grid must cover the pupil.
        wavelength, pupil_radius : float
            Vacuum wavelength and radius of the exit pupil, m.
        image_distance : float
            Signed distance from exit pupil to image, m.
        pitch : float
            Pitch of the image samples, m.
        shape : int or (int, int)
            Image rows H and columns W.
        **options
            ``method``, ``samples``, ``pixel_integrated``, ``device`` and ``dtype``, see
            `from_zernike`.

        Returns
        -------
        PupilPSF
            Point spread with ``coefficients`` of shape (g, g, 2): slopes in waves per pupil radius.

        Raises
        ------
        SceneError
            If a length is out of range, or the slopes are not finite.
        SamplingError
            If the slopes do not cover the pupil, or pitch, shape or samples do not resolve the
            pupil or the image.

        Notes
        -----
        The wave is that of `psf.wavefront_from_slopes` on the whole grid. `curl_residual` returns
        the part of the slopes that no wave can have.
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
        values = checked_slopes("slopes", slopes, slope_pitch, optics.pupil_radius)
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
        """Build a point spread from the angles at which light leaves the exit pupil.

        Parameters
        ----------
        angles : array_like, (g, g, 2)
            Start values, rad, from the axis toward u and v, with rows along v. The ray of a node
            meets the image at ``tan(angle) * image_distance``, so that the wave's slope is the
            tangent.
        angle_pitch : float
            Distance between nodes, m; the grid must cover the pupil.
        wavelength, pupil_radius : float
            Vacuum wavelength and radius of the exit pupil, m.
        image_distance : float
            Signed distance from exit pupil to image, m.
        pitch : float
            Pitch of the image samples, m.
        shape : int or (int, int)
            Image rows H and columns W.
        **options
            ``method``, ``samples``, ``pixel_integrated``, ``device`` and ``dtype``, see
            `from_zernike`.

        Returns
        -------
        PupilPSF
            Point spread with slopes as ``coefficients``, see `from_slopes`.

        Raises
        ------
        SceneError
            If a length is out of range, or an angle is not finite or not below pi/2.
        SamplingError
            If the angles do not cover the pupil, or pitch, shape or samples do not resolve the
            pupil or the image.
        """
        angle_pitch = positive("angle_pitch", angle_pitch, unit="m")
        pupil_radius = positive("pupil_radius", pupil_radius, unit="m")
        return cls.from_slopes(
            checked_tangents(angles, angle_pitch, pupil_radius),
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
        """Build a point spread that starts at the wave aberration W of an approximate scene.

        Parameters
        ----------
        scene : Scene
            Scene that provides W, exit pupil and wavelength.
        modes : sequence of int
            Noll indices of the fit parameters, from 2. They start at their least-squares fit to W;
            the rest of W stays constant.
        pitch : float
            Pitch of the image samples, m; for a camera image ``scene.camera.image_pitch``.
        shape : int or (int, int)
            Image rows H and columns W.
        object_point : array_like, (3,), optional
            Object point, world frame, m; by default the hidden object's reference point.
        **options
            ``method``, ``samples``, ``pixel_integrated``, ``device`` and ``dtype``, see
            `from_zernike`.

        Returns
        -------
        PupilPSF
            Point spread with ``coefficients`` of shape (M,), waves rms.

        Raises
        ------
        CausticError, NotWaveGradeError
            If W is undefined, see `psf.wavefront`.
        SamplingError
            If pitch, shape or samples do not resolve the pupil or the image.
        SceneError
            If the scene, a mode or a length is invalid.
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
        known, fit = fitted_modes(wave, modes)
        return cls(optics, ZernikeWaves(modes, optics, known), fit)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the point spread."""
        return self.optics.shape

    @property
    def pitch(self) -> float:
        """Pitch of the image samples, m."""
        return self.optics.pitch

    @property
    def wavelength(self) -> float:
        """Vacuum wavelength, m."""
        return self.optics.wavelength

    @property
    def modes(self) -> tuple[int, ...]:
        """Noll indices of the coefficients; empty for slopes."""
        return self.waves.modes

    def forward(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Compute the point spread.

        Parameters
        ----------
        coefficients : Tensor, optional
            Coefficients, (..., M) or (..., g, g, 2), as in the class; by default the module's own.
        defocus : Tensor or sequence of float, optional
            Known additional defoci, (K,), m rms (Noll 4).

        Returns
        -------
        Tensor
            Energy per pixel, (..., H, W), or (..., K, H, W) with ``defocus``, centred at
            [H//2, W//2]. For "fft" it sums to 1; for "mdft" the sum over the whole image plane is
            1.

        Raises
        ------
        SamplingError
            If a shape or the coefficients' dtype does not match.
        SceneError
            If the coefficients are not a tensor, or a defocus is not finite or too large for
            metres.
        """
        return self.optics.point_spread(self._turns(coefficients, defocus))

    def transfer(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Compute the transfer function, (..., H, W//2 + 1), complex.

        It is the ``rfft2`` of the point spread with the centre at sample [0, 0]. Multiplied by
        ``torch.fft.rfft2`` of an object, it gives the spectrum of its image in a periodic frame.
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
        """Compute an object's image: ``gain * (point spread convolved with object) + background``.

        Parameters
        ----------
        object_image : Tensor
            Object, (..., h, w), on the image's pixels. Its shape must be the point spread's if
            ``boundary`` is "circular". Batch dimensions broadcast with those of the coefficients.
        coefficients : Tensor, optional
            Coefficients, (..., M) or (..., g, g, 2), as in the class; by default the module's own.
        defocus : Tensor or sequence of float, optional
            Known additional defoci, (K,), m rms (Noll 4).
        gain, background : float or Tensor
            Image units; tensors broadcast with the result.
        boundary : {"padded", "circular"}
            Surroundings of the object: dark, or periodic copies.

        Returns
        -------
        Tensor
            Image, (..., h, w), or (..., K, h, w) with ``defocus``.

        Raises
        ------
        SamplingError
            If the object is empty, or with ``boundary="circular"`` has another shape than the
            point spread.
        SceneError
            If the object or the coefficients are not tensors, or a defocus is out of range.
        """
        one_of("boundary", boundary, ("padded", "circular"))
        if not isinstance(object_image, Tensor):
            raise SceneError(
                f"object_image of type {type(object_image).__name__} is not a tensor; give "
                "torch.from_numpy(picture)"
            )
        frame = tuple(object_image.shape[-2:])
        if object_image.ndim < 2 or 0 in frame:
            raise SamplingError(
                f"object_image has shape {tuple(object_image.shape)}, must be (..., h, w); give at "
                "least one image"
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
        """Compute the wave aberration W at the pupil's samples; 0 outside the pupil.

        Parameters
        ----------
        coefficients : Tensor, optional
            Coefficients, as in the class; by default the module's own.

        Returns
        -------
        Tensor
            W, (..., n_v, n_u), m, on the grid of ``optics.v`` and ``optics.u``, m.
        """
        if coefficients is None:
            coefficients = self.coefficients
        turns: Tensor = self.waves.unwrapped(self._checked(coefficients))
        return turns * self.wavelength

    def steepest(self, coefficients: Tensor | None = None) -> float:
        """Return the largest difference of W between neighbouring pupil samples, wavelengths.

        Above 1/2 the samples are too coarse for the wave.
        """
        with torch.no_grad():
            return self.optics.steepest(self.aberration(coefficients) / self.wavelength)

    def curl_residual(self, coefficients: Tensor | None = None) -> float:
        """Return the rms difference between slopes given as coefficients and the wave's, rad.

        The wave is the least-squares fit to the slopes, see `psf.wavefront_from_slopes`. The
        result is 0 for Zernike modes.
        """
        if not isinstance(self.waves, SlopeWaves):
            return 0.0
        leaves = self._checked(self.coefficients if coefficients is None else coefficients)
        return self.waves.curl_residual(leaves) * self.wavelength / self.optics.pupil_radius

    def _checked(self, coefficients: Tensor) -> Tensor:
        wanted = self.waves.leaf_shape
        if not isinstance(coefficients, Tensor):
            raise SceneError(
                f"coefficients of type {type(coefficients).__name__} are not a tensor; give "
                "torch.tensor(values)"
            )
        if tuple(coefficients.shape[-len(wanted) :]) != wanted:
            raise SamplingError(
                f"coefficients have shape {tuple(coefficients.shape)}, must end in {wanted}; "
                "give one value per parameter"
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
        """Return the wave aberration divided by the wavelength, (..., n_v, n_u)."""
        if coefficients is None:
            coefficients = self.coefficients
        turns: Tensor = self.waves(self._checked(coefficients))
        if defocus is None:
            return turns
        try:
            extra = torch.as_tensor(defocus, dtype=turns.dtype, device=turns.device)
        except (TypeError, ValueError):
            raise SceneError(
                f"defocus of type {type(defocus).__name__} has no numbers; give one value per "
                "frame in metres"
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
        """Return the aberration W that known defoci add at the pupil's samples, in wavelengths.

        Parameters
        ----------
        extra : Tensor, (K,)
            Defocus of each image, m rms over the pupil.

        Returns
        -------
        Tensor, (K, rows, columns)
            Aberration W in wavelengths, 0 outside the pupil.
        """
        return (extra / self.wavelength)[:, None, None] * self._defocus
