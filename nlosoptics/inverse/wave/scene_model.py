"""Mean camera image as a differentiable function of scene values and of the object."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # its parts are loaded on first use
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from ..._checks import expect, in_range, positive, whole, whole_pair
from ...errors import NlosError, SamplingError, SceneError
from ...imaging import Shadows, SpeckleImage, cast_shadows, form_image
from ...imaging.images import room_light
from ...imaging.object_operator import ObjectOperator
from ...psf import PointSpread, PointSpreadField, point_spread_field, scene_point_spread
from ...scene import PlanarObject, Scene
from ...scene.file.addresses import NOT_IN_POINT_SPREAD, value_at
from ...scene.file.scene_file import own_tables
from ...scene.file.units import measured

Array = NDArray[np.float64]
#: Function of a scene that returns a number or an array.
Figure = Callable[[Scene], Any]


@dataclass(frozen=True)
class Steps:
    """Steps of the differences, in units of the scale of a value.

    Windows, samples and transforms are chosen by the scene, so that an image jumps by up to its
    tolerance at some values. A short step rarely meets a jump, and if it does, the difference is
    too large to be true. Rounding of an image, some 1e-15, leaves an error below 1e-6.
    """

    width: float = 1e-8
    rounding: float = 1e-9  # least step relative to the value
    jump: float = 30.0  # ratio of the relative change to ``width`` from which it is a jump
    first: float = 1e-3  # relative change of a value by which its scale is measured
    change: float = 1e-2  # relative change of the image that measures a scale well
    least: float = 1e-9  # relative change of the image, above rounding, that is an effect


STEPS = Steps()
SMOOTH = 0.01  # reflectance below which the total variation is rounded off
SOLVED = 1e-10  # of the gradient at the minimum, relative to that of a black object
NEWTON = 100  # steps of Newton's method at most


class SceneModel(nn.Module):
    """Mean camera image of a scene, differentiable with respect to its values and the object.

    A torch module from scene to electrons: walls that reflect like mirrors (image, by waves or
    rays) or diffusely, past occluders, with all light and constants of the camera. The image is
    that of `imaging.form_image` before noise.

    Parameters
    ----------
    scene : Scene
        Scene with the start values.
    free : sequence of str, or mapping of str to float
        Addresses of the values to vary, as for `Scene.with_values`, such as "wall.radius" or
        "hidden.position[2]". A mapping also gives their scales in SI units: the change of a value
        that changes the image considerably. By default scales are measured; from one to four
        images for each value.
    tol : float
        Tolerance of the point spread function (PSF), see `psf.scene_point_spread`.
    nodes : int
        Points along each side of a planar object for which a PSF is computed. With 1, the PSF is
        that of the object's centre.

    Attributes
    ----------
    offsets : torch.nn.Parameter, (n,)
        Changes of the values from those of ``scene``, in units of their scales; 0 at first. All
        free values are thus of similar size to an optimiser.
    scales : ndarray, (n,)
        Scale of each value, SI units.

    Raises
    ------
    SceneError
        If an address is wrong, has no number or no effect on the image, or an option is out of
        range.
    NlosError
        If the scene, or one with the current values, has no image; see `imaging.form_image`.

    See Also
    --------
    nlosoptics.imaging.form_image : Image in electrons, with noise.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    The gradient with respect to the object is computed by the adjoint of the image model. Each free
    value is shifted by 1e-8 of its scale, and the exact image is computed again: a backward pass
    takes as long as n images, and memory does not grow with n. Values on which the PSF does not
    depend share it. If the image jumps within the step, because another number of samples is used,
    the other side is taken.

    Without occluders the image has the bits of `form_image`. Past occluders it has those of
    `form_image` with ``shadows=cast_shadows(scene, exact=True)``; the default differs from it by up
    to 5e-3 of the brightest pixel. The view from lens to wall, and the shadows on mirror-like
    images, are counts of 16 paths; they contribute no gradient.

    Examples
    --------
    >>> import torch
    >>> from nlosoptics import Scene
    >>> from nlosoptics.inverse import SceneModel
    >>> scene = Scene.load("examples/scenes/letter_concave.toml").resized(16)
    >>> model = SceneModel(scene, {"wall.radius": 5.0, "laser.power": 5e-3}, tol=1e-2)
    >>> model().sum().backward()
    >>> tuple(model.offsets.grad.shape), model.values["wall.radius"]
    ((2,), 5.0)
    """

    def __init__(
        self,
        scene: Scene,
        free: Sequence[str] | Mapping[str, float] = (),
        *,
        tol: float = 1e-3,
        nodes: int = 1,
    ) -> None:
        super().__init__()
        self._scene = expect("scene", scene, "Scene")
        self._tol, self._nodes = in_range("tol", tol, 1e-12, 1.0), whole("nodes", nodes, 1, 64)
        self.free = _checked_addresses(free)
        tables = own_tables(scene)[0]
        self._start = np.array([_number(tables, address) for address in self.free])
        self._settings: OrderedDict[bytes, _Setting] = OrderedDict()
        self.offsets = nn.Parameter(torch.zeros(len(self.free), dtype=torch.float64))
        self.scales = np.ones(len(self.free))
        if isinstance(free, Mapping):
            self.scales = np.array([positive(f"free[{a!r}]", free[a]) for a in self.free])
        else:
            self.scales = np.array([self._scale(k) for k in range(len(self.free))])
            self._settings.clear()

    @property
    def values(self) -> dict[str, float]:
        """Current values by address, SI units."""
        values = self._start + self.scales * _numbers(self.offsets)
        return dict(zip(self.free, values.tolist(), strict=True))

    @property
    def scene(self) -> Scene:
        """Scene with the current values."""
        return self._setting(_numbers(self.offsets)).scene

    def forward(self, object_image: Tensor | None = None) -> Tensor:
        """Compute the mean image in electrons, (ny, nx), float64.

        ``object_image`` (rows, columns): reflectances, 0 to 1, that replace the picture on a planar
        object, row 0 on top; by default the scene's own. The result is
        ``SpeckleImage.expected``: without noise, and not limited by the full well.
        """
        return self._image(object_image)

    def reading(
        self, object_image: Tensor | None = None, *, generator: torch.Generator | None = None
    ) -> Tensor:
        """Compute an image with noise and full well, (ny, nx), differentiable like the mean.

        Photons, speckle, dark current, readout and digitisation add a normal variate of their total
        variance, drawn from ``generator`` (reparametrisation). Values end at the full well.
        """
        mean = self._image(object_image)
        setting = self._setting(_numbers(self.offsets))
        camera = setting.scene.camera
        native = camera.binning**2
        step = camera.full_well / 2**camera.bit_depth
        variance = mean.clamp(min=0.0) + native * (camera.read_noise**2 + step**2 / 12)
        contrast = setting.formed(_picture(object_image)).speckle_contrast
        if contrast > 0.0:
            dark = camera.dark_current * camera.exposure * native
            room = torch.as_tensor(room_light(setting.scene))
            variance = variance + (contrast * (mean - dark - room)).square()
        normal = torch.randn(mean.shape, dtype=mean.dtype, generator=generator)
        noisy: Tensor = mean + variance.sqrt() * normal
        return noisy.clamp(max=native * camera.full_well)

    def evaluate(self, figure: Figure) -> Tensor:
        """Return a function of the scene with its gradient, such as a figure of merit.

        ``figure`` takes a `Scene` and returns a number or an array of float64, for example
        ``lambda scene: psf.scene_point_spread(scene, 1e-4).point_spread.intensity.max()``. A
        backward pass calls it once for each free value.
        """
        result: Tensor = _Figure.apply(  # type: ignore[no-untyped-call]
            self.offsets, self, figure
        )
        return result

    def tikhonov(
        self,
        image: Tensor,
        damping: float,
        shape: tuple[int, int] | None = None,
        *,
        variation: float = 0.0,
    ) -> Tensor:
        """Reconstruct the object with the current values, differentiable by both.

        Parameters
        ----------
        image : Tensor, (ny, nx)
            Measured electrons.
        damping : float
            Rms noise of the image over the expected rms reflectance, electrons.
        shape : (int, int), optional
            Rows and columns of the object; by default those of the image.
        variation : float
            Weight of the object's total variation V, electrons^2, which keeps edges sharp. It is
            the sum over all texels of ``sqrt(|g|^2 + 0.01^2)``, with the differences g to the next
            texel along both axes.

        Returns
        -------
        Tensor, (rows, columns)
            Object x that minimises ``|image(x) - image|^2 + damping^2 |x|^2 + 2 variation V(x)``,
            without limits to its reflectances, by conjugate gradients and Newton's method.

        Notes
        -----
        The gradient follows from the conditions of the minimum by the implicit function theorem,
        which needs one more linear solution, and no memory for iterations.
        """
        damping = positive("damping", damping)
        variation = in_range("variation", variation, 0.0)
        wanted = self._scene.camera.shape
        if not isinstance(image, Tensor) or tuple(image.shape) != wanted:
            raise SceneError(
                f"image has shape {tuple(np.shape(image))}, must be a tensor {wanted}; give "
                "one image of the camera"
            )
        if not bool(torch.isfinite(image).all()):
            raise SceneError("image has values that are not finite, limit 0; replace them")
        shape = whole_pair("shape", shape or wanted, (4096, 4096))
        result: Tensor = _Tikhonov.apply(  # type: ignore[no-untyped-call]
            self.offsets, image, self, (damping, variation), shape
        )
        return result

    def _image(self, object_image: Tensor | None) -> Tensor:
        if object_image is not None and not isinstance(object_image, Tensor):
            raise SceneError(
                f"object_image of type {type(object_image).__name__} is not a tensor; give "
                "torch.from_numpy(picture)"
            )
        result: Tensor = _Image.apply(  # type: ignore[no-untyped-call]
            self.offsets, object_image, self
        )
        return result

    def _setting(self, offsets: Array, moved: int | None = None) -> _Setting:
        """Return the image model at some offsets; that of the ``moved`` one shares the others'."""
        key = offsets.tobytes()
        if key not in self._settings:
            values = self._start + self.scales * offsets
            changes = dict(zip(self.free, values.tolist(), strict=True))
            scene = self._scene.with_values(changes) if offsets.any() else self._scene
            self._settings[key] = _Setting(scene, self._tol, self._nodes)
        while len(self._settings) > 2 * len(self.free) + 1:
            self._settings.popitem(last=False)
        return self._settings[key]

    def _rates(
        self, offsets: Array, figure: Callable[[_Setting], Array], here: Array | None = None
    ) -> Iterator[Array]:
        """Yield the derivative of a figure by each offset, given its value ``here`` if known."""
        base = self._setting(offsets)
        here = figure(base) if here is None else here

        def change(index: int, step: float) -> Array:
            moved = offsets.copy()
            moved[index] += step
            setting = self._setting(moved)
            setting.follow(base, self.free[index])
            before, after = (
                self._start[index] + self.scales[index] * at[index] for at in (offsets, moved)
            )
            return np.asarray((figure(setting) - here) * (self.scales[index] / (after - before)))

        for index in range(len(self.free)):
            value = self._start[index] + self.scales[index] * offsets[index]
            step = max(STEPS.width, STEPS.rounding * abs(value) / self.scales[index])
            rate = change(index, step)
            if _norm(rate) > STEPS.jump * _norm(here):
                rate = min(rate, change(index, -step), key=_norm)
            yield rate

    def _scale(self, index: int) -> float:
        """Return the change of a value that changes the image by about all of itself."""
        address, start = self.free[index], self._start[index]
        here = self._setting(np.zeros(len(self.free))).formed(None).expected

        def change(step: float) -> float:
            """Return the smaller relative change of the image to both sides."""
            changes = []
            for value in (start + step, start - step):
                try:
                    scene = self._scene.with_values({address: float(value)})
                    image = _Setting(scene, self._tol, self._nodes).formed(None).expected
                    changes.append(_norm(image - here) / _norm(here))
                except NlosError as error:
                    refusal = error
            if not changes:
                raise refusal
            return min(changes)

        step = STEPS.first * (abs(start) or 1.0)
        relative = change(step)
        # changes may also be quadratic, near an extremum
        if STEPS.least < relative < STEPS.change:
            step *= min(math.sqrt(STEPS.change / relative), 0.1 / STEPS.first)
            relative = change(step)
        if relative < STEPS.least:
            raise SceneError(
                f"{address} = {start:g} has no effect on the image, must have one to be free; "
                "remove it from free"
            )
        return step / relative


class _Setting:
    """Image model of one scene, with what its images share."""

    def __init__(self, scene: Scene, tol: float, nodes: int) -> None:
        self.scene, self._tol, self._nodes = scene, tol, nodes
        self._shape: tuple[int, int] | None = None
        self._lit: tuple[bytes, Scene, Shadows | None] | None = None
        self._formed: tuple[bytes, SpeckleImage] | None = None
        self._operator: tuple[bytes, ObjectOperator] | None = None

    @cached_property
    def spread(self) -> PointSpread | PointSpreadField | None:
        """Point spread; None for a wall without a mirror-like lobe."""
        if self.scene.wall_material.specular_reflectance == 0.0:
            return None
        if self._nodes > 1:
            return point_spread_field(self.scene, self._nodes, tol=self._tol)
        return scene_point_spread(self.scene, self._tol, shape=self._shape).point_spread

    def follow(self, base: _Setting, address: str) -> None:
        """Take the window of another setting's point spread, or all of it if it is the same."""
        if base.spread is None or "spread" in vars(self):
            return
        if address.startswith(NOT_IN_POINT_SPREAD):
            self.spread = base.spread
        elif isinstance(base.spread, PointSpread):
            self._shape = base.spread.shape

    def formed(self, picture: Array | None) -> SpeckleImage:
        """Return the image of a picture, by default the scene's own."""
        key, scene, shadows = self._lit_by(picture)
        if self._formed is None or self._formed[0] != key:
            self._formed = key, form_image(scene, self.spread, shadows=shadows)
        return self._formed[1]

    def operator(self, picture: Array) -> ObjectOperator:
        """Return the linear operator for pictures of a shape; past occluders, for this one."""
        key, scene, shadows = self._lit_by(picture)
        if shadows is None:
            key = repr(picture.shape).encode()
        if self._operator is None or self._operator[0] != key:
            self._operator = key, ObjectOperator(scene, self.spread, shadows)
        return self._operator[1]

    def _lit_by(self, picture: Array | None) -> tuple[bytes, Scene, Shadows | None]:
        """Return a key of the picture, the scene with it, and the shadows past its occluders."""
        key = b"" if picture is None else repr(picture.shape).encode() + picture.tobytes()
        if self._lit is None or self._lit[0] != key:
            scene = self._painted(picture)
            self._lit = key, scene, cast_shadows(scene, exact=True) if scene.occluders else None
        return self._lit

    def _painted(self, picture: Array | None) -> Scene:
        if picture is None:
            return self.scene
        if not isinstance(self.scene.hidden, PlanarObject):
            raise SceneError(
                "object_image is given, but scene.hidden is a mesh and carries no picture; leave "
                "it out or use a PlanarObject"
            )
        return replace(self.scene, hidden=replace(self.scene.hidden, image=picture))


class _Image(torch.autograd.Function):
    """Mean image; differences for the scene's values, the adjoint for the object."""

    @staticmethod
    def forward(
        ctx: Any, offsets: Tensor, object_image: Tensor | None, model: SceneModel
    ) -> Tensor:
        ctx.model, ctx.at = model, _numbers(offsets)
        ctx.picture, ctx.dtype = _picture(object_image), getattr(object_image, "dtype", None)
        return torch.tensor(model._setting(ctx.at).formed(ctx.picture).expected)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:
        model, weight = ctx.model, cotangent.numpy()
        by_value = by_object = None
        if ctx.needs_input_grad[0]:
            rates = model._rates(ctx.at, lambda setting: setting.formed(ctx.picture).expected)
            by_value = _tensor((weight * rate).sum() for rate in rates)
        if ctx.needs_input_grad[1]:
            by_object = torch.tensor(model._setting(ctx.at).operator(ctx.picture).adjoint(weight))
            by_object = by_object.to(ctx.dtype)
        return by_value, by_object, None


class _Figure(torch.autograd.Function):
    """Function of the scene; differences for the scene's values."""

    @staticmethod
    def forward(ctx: Any, offsets: Tensor, model: SceneModel, figure: Figure) -> Tensor:
        ctx.model, ctx.figure, ctx.at = model, figure, _numbers(offsets)
        ctx.here = np.asarray(figure(model._setting(ctx.at).scene), dtype=np.float64)
        return torch.tensor(ctx.here)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:
        weight = cotangent.numpy()
        rates = ctx.model._rates(
            ctx.at, lambda setting: np.asarray(ctx.figure(setting.scene), np.float64), ctx.here
        )
        return _tensor((weight * rate).sum() for rate in rates), None, None


class _Tikhonov(torch.autograd.Function):
    """Least squares with penalties; the implicit function theorem for values and image."""

    @staticmethod
    def forward(
        ctx: Any,
        offsets: Tensor,
        image: Tensor,
        model: SceneModel,
        penalty: tuple[float, float],
        shape: tuple[int, int],
    ) -> Tensor:
        ctx.model, ctx.at, ctx.penalty = model, _numbers(offsets), penalty
        black, setting = np.zeros(shape), model._setting(ctx.at)
        light = image.detach().double().numpy() - setting.formed(black).expected
        operator = setting.operator(black)
        ctx.object = _minimum(operator, operator.adjoint(light), penalty)
        ctx.residual = operator.forward(ctx.object) - light
        return torch.tensor(ctx.object)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:
        black = np.zeros(ctx.object.shape)
        operator = ctx.model._setting(ctx.at).operator(black)
        dual = _newton_step(operator, cotangent.numpy(), ctx.object, ctx.penalty)
        seen = operator.forward(dual)
        by_value = None
        if ctx.needs_input_grad[0]:

            def product(setting: _Setting) -> Array:
                moved = setting.operator(black)
                image = moved.forward(ctx.object) + setting.formed(black).expected
                # the normal equations, weighted by the dual solution
                return np.asarray(-np.sum(moved.forward(dual) * ctx.residual + seen * image))

            by_value = _tensor(ctx.model._rates(ctx.at, product))
        return by_value, torch.tensor(seen), None, None, None


def _minimum(operator: ObjectOperator, right: Array, penalty: tuple[float, float]) -> Array:
    """Return the object at which the least squares with penalties are smallest."""
    damping, variation = penalty
    found = _newton_step(operator, right, np.zeros_like(right), (damping, 0.0))
    if variation == 0.0:
        return found

    def cost(picture: Array) -> tuple[float, Array]:
        """Return half of what is minimised, up to a constant, and its gradient."""
        steps, length = _steps(picture)
        inner = operator.adjoint(operator.forward(picture)) + damping**2 * picture
        slope = inner - right + variation * _steps_adjoint(steps / length)
        return float((picture * (inner / 2 - right)).sum() + variation * length.sum()), slope

    value, slope = cost(found)
    for _ in range(NEWTON):
        if _norm(slope) <= SOLVED * _norm(right):
            return found
        step, part = _newton_step(operator, -slope, found, penalty, 1e-3), 1.0
        ahead, steeper = cost(found + step)
        while ahead > value + 1e-12 * abs(value) and part > 1e-6:
            part /= 2
            ahead, steeper = cost(found + part * step)
        found, value, slope = found + part * step, ahead, steeper
    raise SamplingError(
        f"variation = {variation:g} has no solution after {NEWTON} steps; use a smaller one, or a "
        "larger damping"
    )


def _newton_step(
    operator: ObjectOperator,
    right: Array,
    at: Array,
    penalty: tuple[float, float],
    tol: float = 1e-9,
) -> Array:
    """Solve the linear equations of a Newton step at an object by conjugate gradients."""
    (damping, variation), size, shape = penalty, right.size, right.shape
    steps, length = _steps(at)

    def curvature(flat: Array) -> Array:
        picture = flat.reshape(shape)
        result = operator.adjoint(operator.forward(picture)) + damping**2 * picture
        if variation > 0.0:
            ahead = _steps(picture)[0]
            ahead = ahead / length - steps * ((steps * ahead).sum(axis=0) / length**3)
            result += variation * _steps_adjoint(ahead)
        return np.asarray(result).ravel()

    matrix = scipy.sparse.linalg.LinearOperator((size, size), matvec=curvature, dtype=np.float64)
    most = 10 * size
    solution, ended = scipy.sparse.linalg.cg(matrix, right.ravel(), rtol=tol, maxiter=most)
    if ended != 0:
        raise SamplingError(
            f"damping = {damping:g} is too small to solve for the object in {most} steps; use a "
            "larger one"
        )
    return np.asarray(solution).reshape(shape)


def _steps(picture: Array) -> tuple[Array, Array]:
    """Return the differences (2, rows, columns) to the next texels, and their smooth length."""
    steps = np.stack([np.diff(picture, axis=k, append=picture.take([-1], k)) for k in (0, 1)])
    return steps, np.sqrt((steps**2).sum(axis=0) + SMOOTH**2)


def _steps_adjoint(steps: Array) -> Array:
    """Apply the adjoint of the differences, the last of which are 0."""
    down, across = steps.copy()
    down[-1], across[:, -1] = 0.0, 0.0
    return np.asarray(-np.diff(down, axis=0, prepend=0.0) - np.diff(across, axis=1, prepend=0.0))


def _picture(object_image: Tensor | None) -> Array | None:
    if object_image is None:
        return None
    picture: Array = object_image.detach().cpu().double().numpy().copy()
    return picture


def _numbers(offsets: Tensor) -> Array:
    numbers: Array = offsets.detach().double().numpy().copy()
    return numbers


def _tensor(rates: Iterable[Any]) -> Tensor:
    return torch.tensor([float(rate) for rate in rates], dtype=torch.float64)


def _norm(values: ArrayLike) -> float:
    return float(np.linalg.norm(np.ravel(values)))


def _checked_addresses(free: Sequence[str] | Mapping[str, float]) -> tuple[str, ...]:
    if isinstance(free, str) or not all(isinstance(address, str) for address in free):
        raise SceneError(
            f"free = {free!r} is no list of addresses; give for example ['wall.radius']"
        )
    if len(set(free)) < len(free):
        raise SceneError(f"free = {list(free)} names a value twice; give each address once")
    return tuple(free)


def _number(tables: Mapping[str, Any], address: str) -> float:
    """Return the number at an address of a scene's tables, SI units."""
    value = value_at(tables, address)
    number = measured(value)
    if number is not None:
        return number[0]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    raise SceneError(
        f"free: {address} is {value!r} in the scene, must be a number; give the address of one, "
        "and set it by Scene.with_values if the scene has none"
    )
