"""Point spread as a differentiable function of scene parameters, such as wall radius or focus."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Unpack

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from ..._checks import one_of
from ...errors import SamplingError, SceneError
from ...psf import wall_view, wavefront
from ...scene import PlanarObject, Scene
from .pupil_optics import ImageOptions, centred
from .pupil_waves import like, optics_of
from .wall_paths import CurvedWall, WallPaths

Array = NDArray[np.float64]
#: Scene parameters that can be fitted.
LEAVES = (
    "wall_radius",
    "object_position",
    "object_tilt",
    "camera_position",
    "focus_distance",
    "lobe_slope",
)


class SceneLeaves(nn.Module):
    """Point spread function (PSF) of a scene, differentiable with respect to scene parameters.

    A torch module whose parameters are values of the scene, such as the wall's radius. It serves to
    fit them to a measured PSF or image.

    Parameters
    ----------
    scene : Scene
        Scene that provides the start values of the parameters and all other values.
    leaves : sequence of str
        Names of the parameters to fit ("leaves" of torch's graph):

        - ``wall_radius``: radius of a spherical or cylindrical wall, m.
        - ``object_position``: position of the object, (3,), world frame, m.
        - ``object_tilt``: yaw and pitch of a planar object, (2,), rad. They have no effect at the
          object's centre.
        - ``camera_position``: position of the lens, (3,), world frame, m. The camera keeps looking
          at its aim.
        - ``focus_distance``: distance from the lens to the plane in focus, m. The distance from
          lens to detector is kept.
        - ``lobe_slope``: rms slope of the wall's mirror-like lobe, one number for both axes, rad.
    pitch : float
        Distance between the samples of the PSF on the detector, m.
    shape : int or (int, int)
        Rows H and columns W of the PSF; one number for a square.
    **options
        ``method``, ``samples``, ``pixel_integrated``, ``device`` and ``dtype``, see
        `PupilPSF.from_zernike`.

    Attributes
    ----------
    leaves : torch.nn.ParameterDict
        Fit parameters by name. They are always float64, because path lengths of metres must be
        accurate to nanometres.

    Raises
    ------
    SceneError
        If a parameter is unknown, repeated or absent from the scene, or the scene has
        ``wall_roughness`` or several mirror-like lobes with a slope.
    CausticError, NotWaveGradeError, SamplingError
        If the wave is undefined or not resolved, at the start or later, or the wall's edge cuts the
        light; see `psf.wavefront`.

    See Also
    --------
    PupilPSF : Differentiable PSF of a wave.
    nlosoptics.psf.scene_point_spread : Wave and PSF of a scene.

    Notes
    -----
    The wave is computed as in `psf.wavefront`, anew at every call. Its piston and tilt over the
    pupil are removed by least squares, because tilt only shifts the image. The amplitude in the
    pupil keeps its start value.

    A mirror-like lobe of rms slope s multiplies the transfer function at the image frequency f by
    ``exp(-2 pi^2 |s (cos a + cos b) d M f|^2)``. Here a and b are the angles of incidence and
    reflection at the wall, and d is the image distance. The 2 x 2 matrix M is ``footprint`` of
    `psf.wall_view`: seen from a pupil point displaced by (du, dv), the object's light comes from a
    wall point displaced by M (du, dv). The factor is the limit of `psf.mean_point_spread` for
    heights much larger than the wavelength; a, b, d and M are not updated during a fit. Rays are
    traced on the CPU; the transform runs on ``device``.
    """

    _frequencies: Tensor

    def __init__(
        self,
        scene: Scene,
        leaves: Sequence[str],
        *,
        pitch: float,
        shape: int | tuple[int, int],
        **options: Unpack[ImageOptions],
    ) -> None:
        super().__init__()
        self.scene = scene
        wave = wavefront(scene, nodes="polar")
        self.optics = optics_of(wave, pitch, shape, **options)
        self._start = _start_values(scene)
        names = _checked_names(leaves, self._start, scene)
        self.leaves = nn.ParameterDict({name: nn.Parameter(self._given(name)) for name in names})
        self._lit = self.optics.share > 0
        v, u = np.meshgrid(self.optics.v, self.optics.u, indexing="ij")
        self._nodes = torch.from_numpy(np.stack([u[self._lit], v[self._lit]], axis=-1))
        self._plane = _plane_fit(u[self._lit], v[self._lit], self.optics.amplitude[self._lit])
        self._blurs = bool(self._start["lobe_slope"])
        if self._blurs:
            if self.optics.method != "fft":
                raise SamplingError(
                    f"method = {self.optics.method!r}, must be 'fft' for a lobe with a slope"
                )
            self.register_buffer("_frequencies", like(self.optics, _lobe_frequencies(self)))

        with torch.no_grad():
            self.optics.warn_of_steps(self.aberration() / self.optics.wavelength)

    def forward(self, field: ArrayLike | None = None) -> Tensor:
        """Compute the PSF at one or several object points.

        Parameters
        ----------
        field : array_like, (K, 2), optional
            Positions of K points on a planar object relative to its centre, m: to the right and up,
            as in its image array with row 0 on top. By default one point, the centre.

        Returns
        -------
        Tensor
            Energy per sample, (H, W), or (K, H, W) with ``field``. For the method "fft" each PSF
            sums to 1; for "mdft" the sum over the whole image plane would be 1. Each is centred at
            [H//2, W//2] on the mean ray from its object point.
        """
        turns = self._turns(field)
        if not self._blurs:
            return self.optics.point_spread(turns)
        return centred(torch.fft.irfft2(self._blurred(turns), s=self.optics.shape))

    def transfer(self, field: ArrayLike | None = None) -> Tensor:
        """Compute the transfer function, (H, W//2 + 1) or (K, H, W//2 + 1), complex.

        It is the ``rfft2`` of the PSF, with the PSF's centre at sample [0, 0]. ``field`` is that of
        `forward`.
        """
        turns = self._turns(field)
        return self._blurred(turns) if self._blurs else self.optics.transfer(turns)

    def aberration(self, field: ArrayLike | None = None) -> Tensor:
        """Compute the wave aberration at the pupil's samples, m; 0 outside the pupil.

        The shape is (n_v, n_u), or (K, n_v, n_u) for K object points. ``field`` is that of
        `forward`.
        """
        if field is None:
            return self._path(self._value("object_position"))
        try:
            places = np.asarray(field, dtype=np.float64)
        except (TypeError, ValueError):
            raise SceneError("field is not an array of numbers; give positions (K, 2), m") from None
        if (
            places.ndim != 2
            or places.shape[1] != 2
            or not len(places)
            or not np.isfinite(places).all()
        ):
            raise SceneError(
                f"field has shape {places.shape} or values that are not finite; give finite "
                "positions (K, 2), m"
            )
        if not isinstance(self.scene.hidden, PlanarObject):
            raise SceneError(
                "field is given, but the hidden object is a mesh; leave it out, or use a planar "
                "object"
            )
        axes = self._object_axes()
        points = self._value("object_position") + torch.from_numpy(places) @ axes
        return torch.stack([self._path(point) for point in points])

    def _value(self, name: str) -> Tensor:
        if name in self.leaves:
            # rays are aimed on the processor, in double precision
            value: Tensor = self.leaves[name].to(device="cpu", dtype=torch.float64)
            return value
        return self._given(name)

    def _given(self, name: str) -> Tensor:
        return torch.tensor(self._start[name], dtype=torch.float64)

    def _turns(self, field: ArrayLike | None) -> Tensor:
        turns = self.aberration(field) / self.optics.wavelength
        # subtract whole waves before the conversion to single precision, to keep digits
        turns = turns - turns.detach().round()
        return turns.to(device=self.optics.device, dtype=self.optics.dtype)

    def _blurred(self, turns: Tensor) -> Tensor:
        slope = self._value("lobe_slope").to(device=turns.device, dtype=turns.dtype)
        return self.optics.transfer(turns) * torch.exp(-(slope**2) * self._frequencies)

    def _object_axes(self) -> Tensor:
        """Return the object's unit vectors right and up, world frame, (2, 3)."""
        hidden = self.scene.hidden
        yaw, pitch = self._value("object_tilt")
        one, zero = torch.ones((), dtype=torch.float64), torch.zeros((), dtype=torch.float64)
        (cy, sy), (cp, sp) = ((a.cos(), a.sin()) for a in (yaw, pitch))
        about_y = torch.stack([cy, zero, sy, zero, one, zero, -sy, zero, cy]).view(3, 3)
        about_x = torch.stack([one, zero, zero, zero, cp, -sp, zero, sp, cp]).view(3, 3)
        roll = hidden.roll
        about_z = [[math.cos(roll), -math.sin(roll), 0.0], [math.sin(roll), math.cos(roll), 0.0]]
        unturned = torch.tensor([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
        rolled = torch.tensor([*about_z, [0.0, 0.0, 1.0]], dtype=torch.float64)
        return unturned @ (about_y @ about_x @ rolled).T

    def _path(self, object_point: Tensor) -> Tensor:
        """Return the wave aberration W, m, of an object point (3,), m, on the pupil's cells."""
        centre = self._value("camera_position")
        line = torch.tensor(self.scene.camera.aim, dtype=torch.float64) - centre
        axis = line / line.norm()
        offsets = self._nodes @ _frame(axis)
        offsets = torch.cat((torch.zeros(1, 3, dtype=torch.float64), offsets))
        excess, _ = WallPaths.apply(  # type: ignore[no-untyped-call]
            self._value("wall_radius"),
            object_point,
            centre + offsets,
            axis.detach(),
            self.scene.wall,
        )
        mirrored = object_point * torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64) - centre
        in_focus = mirrored * (self._value("focus_distance") / (mirrored @ axis))
        path = excess[1:] - excess[0]
        path = path + (_longer(mirrored, offsets) - _longer(in_focus, offsets))[1:]
        terms, fit = self._plane
        path = path - (fit @ path) @ terms
        aberration = torch.zeros(self._lit.shape, dtype=torch.float64)
        lit = torch.from_numpy(self._lit)
        return aberration.masked_scatter(lit, path)


def _longer(line: Tensor, offsets: Tensor) -> Tensor:
    """Return |line - offset| - |line|, m, without cancellation; vectors (..., 3), m."""
    change = (offsets * offsets).sum(dim=-1) - 2 * offsets @ line
    length = line.norm()
    longer: Tensor = change / ((length**2 + change).sqrt() + length)
    return longer


def _frame(axis: Tensor) -> Tensor:
    """Return the pupil's unit vectors e1 and e2, (2, 3), for an optical axis (3,).

    They equal those of `scene.pupil_frame`.
    """
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    if float(torch.linalg.cross(up, axis.detach()).norm()) < 1e-12:
        up = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    e1 = torch.linalg.cross(up, axis)
    e1 = e1 / e1.norm()
    return torch.stack([e1, torch.linalg.cross(axis, e1)])


def _plane_fit(u: Array, v: Array, weights: Array) -> tuple[Tensor, Tensor]:
    """Prepare the removal of piston and tilts from a wave on n pupil cells.

    Returns these functions at the cells, (3, n), and the matrix of their weighted fit, (3, n).
    """
    terms = np.stack([np.ones_like(u), u / np.abs(u).max(), v / np.abs(v).max()])
    fit = np.linalg.solve((terms * weights) @ terms.T, terms * weights)
    return torch.from_numpy(terms), torch.from_numpy(fit)


def _start_values(scene: Scene) -> dict[str, list[float] | float]:
    if scene.wall_roughness is not None:
        raise SceneError(
            "scene.wall_roughness is not among the parameters of a fit; leave it out, or give the "
            "mirror-like lobe its slope_rms"
        )
    lobes = scene.wall_material.mirror_lobes
    if len(lobes) > 1 and any(lobe.slope_rms > 0 for lobe in lobes):
        raise SceneError(
            f"the wall has {len(lobes)} mirror-like lobes, must be 1 for a lobe with a slope; use "
            "one lobe"
        )
    return {
        "wall_radius": scene.wall.radius if isinstance(scene.wall, CurvedWall) else 1.0,
        "object_position": scene.object_point.tolist(),
        "object_tilt": [scene.hidden.yaw, scene.hidden.pitch],
        "camera_position": list(scene.camera.position),
        "focus_distance": scene.focus_distance,
        "lobe_slope": float(lobes[0].slope_rms) if lobes else 0.0,
    }


def _checked_names(
    leaves: Sequence[str], start: dict[str, list[float] | float], scene: Scene
) -> tuple[str, ...]:
    names = (leaves,) if isinstance(leaves, str) else tuple(leaves)
    for name in names:
        one_of("leaf", name, LEAVES)
    if not names or len(set(names)) < len(names):
        raise SceneError(f"leaves = {names!r}; give each leaf once, and at least one")
    if "wall_radius" in names and not isinstance(scene.wall, CurvedWall):
        raise SceneError(
            f"wall_radius is given, but a {type(scene.wall).__name__} has none; use a ConcaveWall "
            "or ConvexWall, or leave it out"
        )
    if "object_tilt" in names and not isinstance(scene.hidden, PlanarObject):
        raise SceneError(
            "object_tilt is given, but the hidden object is a mesh; use a planar object, or leave "
            "it out"
        )
    if "lobe_slope" in names and not start["lobe_slope"]:
        raise SceneError(
            "lobe_slope starts at 0, where its gradient vanishes; give the wall one mirror-like "
            "lobe with a slope above 0"
        )
    return names


def _lobe_frequencies(leaves: SceneLeaves) -> Array:
    """Return the exponent of a lobe's Gaussian transfer function per squared slope rms.

    It is 2 pi^2 |(cos_i + cos_o) d_i M f|^2 on the half spectrum of frequencies f.
    """
    optics, view = leaves.optics, wall_view(leaves.scene)
    rows, columns = optics.shape
    fy = np.fft.fftfreq(rows, optics.pitch)[:, None]
    fx = np.fft.rfftfreq(columns, optics.pitch)[None, :]
    footprint = view.footprint
    seen = [footprint[i, 0] * fx + footprint[i, 1] * fy for i in (0, 1)]
    reach = view.cos_sum * optics.image_distance
    return np.asarray(2 * np.pi**2 * reach**2 * (seen[0] ** 2 + seen[1] ** 2))
