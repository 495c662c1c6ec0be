"""Differentiable point spread and image as functions of the wave in the pupil."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self, Unpack

import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from ..._checks import positive
from ...errors import SamplingError, SceneError
from ...psf import wavefront
from ...scene import Scene
from .pupil_optics import ImageOptions, PupilOptics
from .pupil_waves import (
    DEFOCUS,
    SlopeWaves,
    ZernikeWaves,
    checked_tangents,
    fitted_modes,
    like,
    noll_mode,
    optics_of,
    start_values,
)


def check_defocus(defocus: Any) -> None:
    """Raise a `SceneError` if known defoci, an array or tensor in m rms, are not plausible."""
    most = 1e-3  # larger values were probably given in waves
    if not bool((abs(defocus) <= most).all()):  # nor is NaN
        raise SceneError(
            f"defocus = {defocus.tolist()} m rms, limit {most:g}; give metres, not waves"
        )


class PupilPSF(nn.Module):
    """Point spread function (PSF) of a round pupil, differentiable with respect to its wave.

    A torch module whose parameters are coefficients of the wave aberration in the exit pupil. Build
    it by `from_zernike`, `from_angles` or `from_scene`. All methods accept batches: M Zernike
    coefficients, (..., M), or slopes at g x g points, (..., g, g, 2), give PSFs of H rows and W
    columns, (..., H, W). A warning is issued if the wave aberration changes by more than half a
    wavelength between neighbouring pupil samples.

    Methods take ``coefficients`` in the shape and unit of the attribute of this name, which is
    their default, and ``defocus``, (K,): K known additional defoci, m rms over the pupil (Noll 4),
    above 0 for a detector too close to the lens. Results then have a further axis of length K.

    Parameters
    ----------
    optics : PupilOptics
        Pupil, image grid and transform.
    waves : ZernikeWaves or SlopeWaves
        How the coefficients determine the wave: as Zernike modes, or as slopes at grid points.
    coefficients : array_like, (..., M) or (..., g, g, 2)
        Start values of the coefficients.

    Attributes
    ----------
    coefficients : torch.nn.Parameter
        Fit parameters: Zernike coefficients in waves rms over the full pupil, or slopes in waves
        per pupil radius. Unlike all lengths, which are in m, they are in units of the wavelength,
        so that the steps of an optimiser have a suitable size.

    Raises
    ------
    SceneError
        If a length, mode or angle is out of range or not finite, or coefficients are no tensor.
    SamplingError
        If pitch and shape do not resolve the pupil or the image, or shapes do not match.
    CausticError, NotWaveGradeError
        If the wave of a scene is undefined, see `psf.wavefront`.

    See Also
    --------
    pcin : Reconstruction via an unknown wall.
    nlosoptics.psf.point_spread : PSF of a given wave.
    """

    _defocus: Tensor

    def __init__(
        self, optics: PupilOptics, waves: ZernikeWaves | SlopeWaves, coefficients: Any
    ) -> None:
        super().__init__()
        self.optics, self.waves = optics, waves
        self.coefficients = nn.Parameter(like(optics, coefficients))
        self._checked(None)
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
        pixel_integrated: bool = False,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> Self:
        """Build a PSF whose wave is a sum of Zernike modes on a clear round pupil.

        Parameters
        ----------
        modes : sequence of int, or mapping of int to float
            Noll indices of the modes, from 2, or a mapping from index to start value of the
            coefficient, m rms. Without values all coefficients start at 0.
        wavelength, pupil_radius : float
            Vacuum wavelength and radius of the exit pupil, m.
        image_distance : float
            Distance from exit pupil to image, m; negative if the pupil lies beyond the image.
        pitch : float
            Distance between the samples of the PSF, m.
        shape : int or (int, int)
            Rows H and columns W of the PSF; one number for a square. The image is periodic.
        pixel_integrated : bool
            Whether the PSF is integrated over square detector pixels of side ``pitch``, which can
            then have any size. Otherwise it is sampled at points, and the pitch must be at most
            wavelength times |image_distance| / (4 pupil_radius).
        device : torch.device or str
            Device of the tensors.
        dtype : torch.dtype
            Precision, ``torch.float32`` or ``torch.float64``.

        Returns
        -------
        PupilPSF
            PSF with ``coefficients`` of shape (M,), waves rms.

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
            pixel_integrated=pixel_integrated,
            device=device,
            dtype=dtype,
        )
        return cls(optics, ZernikeWaves(modes, optics), start_values(modes, wavelength))

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
        """Build a PSF from the angles at which light leaves points of the exit pupil.

        Parameters
        ----------
        angles : array_like, (g, g, 2)
            Start values of the angles toward u and v at g x g grid points of the pupil, rad; 0 is
            the direction to the image's centre. ``angles[i, j]`` is at ``v = (i - g//2)
            angle_pitch`` and ``u = (j - g//2) angle_pitch``. The ray from a point meets the image
            at ``tan(angle) * image_distance``, so that the slope of the wave is ``tan(angle)``.
            Between the points the wave is interpolated by splines.
        angle_pitch : float
            Distance between grid points, m; the grid must cover the pupil.
        wavelength, pupil_radius, image_distance, pitch, shape, **options
            See `from_zernike`.

        Returns
        -------
        PupilPSF
            PSF with ``coefficients`` of shape (g, g, 2): slopes in waves per pupil radius.

        Notes
        -----
        Arbitrary slopes need not be the gradient of any wave. The wave is their least-squares fit
        over the whole grid, as in `psf.wavefront_from_slopes`.
        """
        optics = PupilOptics(
            wavelength=wavelength,
            pupil_radius=pupil_radius,
            image_distance=image_distance,
            pitch=pitch,
            shape=shape,
            **options,
        )
        angle_pitch = positive("angle_pitch", angle_pitch, unit="m")
        slopes = checked_tangents(angles, angle_pitch, optics.pupil_radius)
        waves = SlopeWaves(len(slopes), angle_pitch, optics)
        return cls(optics, waves, slopes * (optics.pupil_radius / optics.wavelength))

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
        """Build a PSF whose coefficients start at the wave aberration W of an approximate scene.

        Parameters
        ----------
        scene : Scene
            Scene that provides W, exit pupil and wavelength.
        modes : sequence of int
            Noll indices of the Zernike modes to fit, from 2. Their coefficients start at the
            least-squares fit to W; the rest of W is kept as a fixed part of the wave.
        pitch, shape, **options
            See `from_zernike`; the pitch of camera images is ``scene.camera.image_pitch``.
        object_point : array_like, (3,), optional
            Object point, world frame, m; by default the centre of a planar hidden object or the
            centroid of a mesh.

        Returns
        -------
        PupilPSF
            PSF with ``coefficients`` of shape (M,), waves rms.
        """
        wave = wavefront(scene, object_point, "polar")
        optics = optics_of(wave, pitch, shape, **options)
        known, fit = fitted_modes(wave, modes)
        return cls(optics, ZernikeWaves(modes, optics, known), fit)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the PSF."""
        return self.optics.shape

    @property
    def pitch(self) -> float:
        """Distance between the samples of the PSF, m."""
        return self.optics.pitch

    @property
    def wavelength(self) -> float:
        """Vacuum wavelength, m."""
        return self.optics.wavelength

    @property
    def modes(self) -> tuple[int, ...]:
        """Noll indices of the coefficients; empty if these are slopes."""
        return self.waves.modes

    def forward(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Compute the PSF: energy per sample, (..., H, W), or (..., K, H, W) with ``defocus``.

        It is centred at [H//2, W//2] and sums to 1.
        """
        return self.optics.point_spread(self._turns(coefficients, defocus))

    def transfer(
        self, coefficients: Tensor | None = None, *, defocus: Tensor | Sequence[float] | None = None
    ) -> Tensor:
        """Compute the transfer function, complex, (..., H, W//2 + 1) or (..., K, H, W//2 + 1).

        It is the ``rfft2`` of the PSF with its centre at sample [0, 0]. Times ``torch.fft.rfft2``
        of an object, (H, W), it is the spectrum of the object's image, with both periodic.
        """
        return self.optics.transfer(self._turns(coefficients, defocus))

    def aberration(self, coefficients: Tensor | None = None) -> Tensor:
        """Compute the wave aberration W, (..., n_v, n_u), m, 0 outside the pupil.

        Its grid is that of ``optics.v`` and ``optics.u``, m.
        """
        turns: Tensor = self.waves.unwrapped(self._checked(coefficients))
        return turns * self.wavelength

    def _checked(self, coefficients: Tensor | None) -> Tensor:
        """Return coefficients, by default those of the module; raise if they do not match."""
        coefficients = self.coefficients if coefficients is None else coefficients
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
        check_defocus(extra.detach())
        return turns.unsqueeze(-3) + self.defocus_turns(extra)

    def defocus_turns(self, extra: Tensor) -> Tensor:
        """Return the wave aberration of defoci (K,), m rms, in wavelengths, (K, n_v, n_u)."""
        return (extra / self.wavelength)[:, None, None] * self._defocus
