"""Random valid scenes over all walls, materials and scales, each by its number."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import trimesh

from nlosoptics.errors import NlosError
from nlosoptics.scene import (
    CallableWall,
    Camera,
    ConcaveWall,
    ConvexWall,
    FacetWall,
    FlatWall,
    GaussianWall,
    HeightMapWall,
    Lambert,
    Laser,
    Material,
    MeshObject,
    MeshWall,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    Wall,
    WallRoughness,
    Ward,
    WavyWall,
)

WALLS = (
    *("flat", "bounded flat", "concave", "convex", "cylinder", "wavy", "crossed waves"),
    *("bumps", "drawn heights", "callable", "mesh", "mirror-flat wave"),
)
MATERIALS = ("smooth", "beckmann", "ggx", "ward", "two lobes", "matt", "rough gloss", "Oren-Nayar")


@dataclass
class Case:
    """A scene with the tolerance it is to be computed to, and what was drawn, for a report."""

    scene: Scene
    tol: float
    drawn: dict[str, Any] = field(default_factory=dict)


class _Draw:
    def __init__(self, seed: int, attempt: int, wild: bool) -> None:
        self.random = np.random.default_rng([seed, attempt, int(wild)])
        self.wild = wild

    def log(self, low: float, high: float) -> float:
        return float(math.exp(self.random.uniform(math.log(low), math.log(high))))

    def between(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def one(self, values: Any) -> Any:
        return values[int(self.random.integers(len(values)))]

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def scale(
        self, ordinary: tuple[float, float], wild: tuple[float, float], few: float = 0.3
    ) -> float:
        """Within the ordinary range, or of a wild scene often within the wild one."""
        return self.log(*(wild if self.wild and self.chance(few) else ordinary))


def random_case(seed: int, *, wild: bool = False, rough: bool = False) -> Case:
    """Scene and tolerance of a number; at ordinary scales, or with some figures far off them.

    With ``rough``, the scene's wall has a roughness of its own.
    """
    for attempt in range(200):
        draw = _Draw(seed, attempt, wild)
        try:
            return _roughened(draw, _case(draw)) if rough else _case(draw)
        except NlosError:  # what no scene can be: a corner behind the wall, a stop without a focus
            continue
    raise AssertionError(f"number {seed} gives no scene")


def _case(draw: _Draw) -> Case:
    wavelength = draw.scale((4e-7, 1.1e-6), (2e-7, 1e-5))
    far = draw.scale((0.5, 2.0), (0.1, 30.0))  # of the object from the wall
    near = draw.scale((0.5, 2.0), (0.1, 30.0))  # of the camera
    turn = draw.between(0.1, 0.7)
    position = (far * math.sin(turn), draw.between(-0.1, 0.1) * far, far * math.cos(turn))
    lens = (-near * math.sin(turn), draw.between(-0.1, 0.1) * near, near * math.cos(turn))
    focal = min(draw.scale((0.012, 0.1), (5e-3, 1.0)), (far + near) / 3)
    stop = draw.scale((1e-3, 2.5e-2), (5e-4, 5e-2))
    stop = min(stop, focal / 0.7)
    # where the mirrored object appears in the plane z = 0
    share = lens[2] / (lens[2] + position[2])
    aim = tuple(a + share * (b - a) for a, b in zip(lens[:2], position[:2], strict=True))
    kind = draw.one(WALLS)
    wall = _wall(draw, kind, far * near / (far + near), stop, wavelength, max(map(abs, aim)))
    paint = draw.one(MATERIALS)
    pitch = draw.scale((2e-6, 3e-5), (1e-6, 1e-3))
    most = 600 if draw.chance(0.1) else 160
    shape = [round(draw.log(8, most)) for _ in range(2)]
    size = draw.scale((0.05, 0.5), (0.02, 1.0)) * far
    hidden = _hidden(draw, position, size)
    tol = 10 ** draw.between(-4, -1) if draw.chance(0.8) else 10 ** draw.between(-6, -4)
    focus = None
    if draw.chance(0.2):
        focus = (far + near) * draw.scale((0.9, 1.1), (0.5, 3.0))
    camera = Camera(
        position=lens,
        aim=(*(a + draw.between(-0.02, 0.02) * near for a in aim), 0.0),
        focal_length=focal,
        stop_diameter=stop,
        pixel_pitch=pitch,
        pixels=(shape[0], shape[1]),
        binning=1,
        exposure=draw.scale((5e-3, 0.1), (1e-6, 100.0)),
        full_well=draw.scale((1e4, 1e5), (1e2, 1e7)),
        bit_depth=draw.one((8, 12, 16)),
        dark_current=draw.one((0.0, 1.0, 50.0)),
        focus_distance=focus,
        glare_fraction=draw.one((0.0, 0.0, 0.01)),
        field_stop=draw.one((None, None, None, draw.between(0.1, 1.5))),
    )
    laser = Laser(
        wavelength=wavelength,
        power=draw.scale((1e-3, 1.0), (1e-9, 1e6)),
        beam_diameter=draw.scale((5e-4, 5e-3), (1e-5, 5e-2)),
        position=(draw.between(0.2, 1.0) * near, draw.between(-0.3, 0.3), draw.log(0.3, 3.0)),
        aim=(draw.between(-0.02, 0.02), draw.between(-0.02, 0.02), 0.0),
        independent_patterns=draw.one((None, 1, 10)),
    )
    occluders = ()
    if draw.chance(0.1):
        plate = trimesh.creation.box((0.1 * far, 0.3 * far, 0.002))
        place = [draw.between(-0.3, 0.3) * far, 0.0, draw.between(0.3, 0.8) * position[2]]
        plate.apply_translation(place)
        occluders = (plate,)
    scene = Scene(laser, wall, hidden, camera, occluders, wall_material=_material(draw, paint))
    drawn = {"wall": kind, "material": paint, "hidden": type(hidden).__name__}
    return Case(scene, tol, drawn)


def _roughened(draw: _Draw, case: Case) -> Case:
    """The same scene with random heights that carry the slope of the gloss."""
    length = draw.scale((2e-4, 5e-3), (2e-5, 2e-2))
    slope = draw.scale((1e-5, 5e-3), (1e-7, 0.1))
    seed = int(draw.random.integers(1000))
    kind = draw.one(("facets", "gaussian"))
    heights: FacetWall | GaussianWall = FacetWall(length, slope, seed=seed)
    if kind == "gaussian":
        heights = GaussianWall(length * slope / math.sqrt(2), length, seed=seed)
    realisation = draw.one(("pattern", "mean"))
    changed = replace(
        case.scene,
        wall_material=_material(draw, "smooth"),
        wall_roughness=WallRoughness(heights, realisation),
    )
    return Case(changed, case.tol, case.drawn | {"material": f"{kind} {realisation}"})


def _wall(
    draw: _Draw, kind: str, d_eff: float, stop: float, wavelength: float, reach: float
) -> Wall:
    """Walls that bend the wave by a fraction of a wave to some thousand, most by a few."""
    size = None
    if kind in ("bounded flat", "bumps", "drawn heights", "mesh") or draw.chance(0.3):
        size = draw.scale((0.5, 3.0), (0.05, 5.0)) + 2.2 * reach
    bend = draw.scale((1e-2, 0.3), (1e-4, 5.0)) / d_eff  # curvature, 1/m
    period = draw.scale((0.05, 0.5), (2e-3, 1.0))
    height = draw.scale((1e-7, 1e-5), (1e-9, 1e-3))
    height = min(height, 0.3 / (d_eff * (2 * math.pi / period) ** 2) if not draw.wild else math.inf)
    if kind == "flat":
        return FlatWall()
    if kind == "bounded flat":
        return FlatWall(size=(size, draw.between(0.7, 1.0) * size))
    if kind == "concave":
        return ConcaveWall(1 / bend, size=size)
    if kind == "convex":
        return ConvexWall(1 / bend, size=size)
    if kind == "cylinder":
        axis = draw.one("xy")
        return draw.one((ConcaveWall, ConvexWall))(1 / bend, size=size, shape="cylinder", axis=axis)
    wave = WavyWall(height, period, draw.between(0, 6), size=size, direction=draw.between(0, 3))
    if kind == "wavy":
        return wave
    if kind == "mirror-flat wave":
        return WavyWall(1e-3 * wavelength, period, size=size)
    if kind == "crossed waves":
        return SumWall(wave, ConcaveWall(1 / bend), size=size)
    if kind == "callable":
        return _bowl(bend, size or 2.0 + 2.2 * reach)
    n = 48
    if kind == "drawn heights":
        pitch = size / n
        return HeightMapWall.random(
            height_rms=height,
            correlation_length=draw.between(4, 12) * pitch,
            size=size,
            pitch=pitch,
            seed=int(draw.random.integers(1000)),
        )
    x = np.linspace(-size / 2, size / 2, n)
    y = x[:, None]
    heights = height * (np.cos(7 * x / size) * np.cos(5 * y / size) + (x / size) ** 2)
    if kind == "bumps":
        return HeightMapWall(heights, size / (n - 1))
    return MeshWall(_mesh_of(x, heights))


def _bowl(bend: float, size: float) -> CallableWall:
    return CallableWall(
        lambda x, y: bend / 2 * (x**2 + 0.5 * y**2),
        lambda x, y: (bend * x, bend / 2 * y),
        hessian=lambda x, y: (bend + 0 * x, 0 * x, bend / 2 + 0 * x),
        size=(size, size),
        max_height=bend * size**2,
        max_curvature=bend,
    )


def _mesh_of(x: np.ndarray, heights: np.ndarray) -> trimesh.Trimesh:
    n = len(x)
    u, v = np.meshgrid(x, x)
    vertices = np.stack([u.ravel(), v.ravel(), heights.ravel()], axis=1)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([i, i + 1, i + n + 1], axis=1), np.stack([i, i + n + 1, i + n], axis=1)]
    )
    return trimesh.Trimesh(vertices, faces, process=False)


def _material(draw: _Draw, kind: str) -> Material:
    reflectance = draw.between(0.02, 0.3)
    slope = draw.scale((1e-5, 1e-2), (1e-6, 0.3))
    diffuse = Lambert(draw.between(0.2, 0.6))
    width = min(math.sqrt(2) * slope, 1.0)
    variant = draw.one(("1992", "duer", "bounded"))
    kinds: dict[str, Callable[[], Material]] = {
        "smooth": lambda: SumMaterial(diffuse, SpecularMicrofacet(reflectance, 0.0)),
        "beckmann": lambda: SumMaterial(diffuse, SpecularMicrofacet(reflectance, slope)),
        "ggx": lambda: SumMaterial(
            diffuse, SpecularMicrofacet(reflectance, slope, distribution="ggx")
        ),
        "ward": lambda: SumMaterial(diffuse, Ward(reflectance, width, variant=variant)),
        "two lobes": lambda: SumMaterial(
            OrenNayar(0.4, 0.3), SpecularMicrofacet(0.05, 0.0), SpecularMicrofacet(0.1, slope)
        ),
        "matt": lambda: diffuse,
        "rough gloss": lambda: SumMaterial(diffuse, SpecularMicrofacet(reflectance, 0.2)),
        "Oren-Nayar": lambda: OrenNayar(
            0.7, 0.35, model=draw.one(("fit", "full")), normalised=draw.chance(0.5)
        ),
    }
    return kinds[kind]()


def _hidden(
    draw: _Draw, position: tuple[float, float, float], size: float
) -> PlanarObject | MeshObject:
    if draw.chance(0.12):
        mesh = draw.one((trimesh.creation.icosphere(2, 0.5), trimesh.creation.box((1, 1, 0.2))))
        return MeshObject(mesh, scale=size, position=position)
    rows, columns = (int(draw.random.integers(1, 40)) for _ in range(2))
    picture = draw.random.random((rows, columns)) * (draw.random.random((rows, columns)) > 0.4)
    if draw.chance(0.03):
        picture[:] = 0.0
    yaw = draw.between(-0.5, 0.5) if draw.chance(0.3) else 0.0
    material = draw.one((Lambert(0.8), OrenNayar(0.8, 0.3)))
    high = size * draw.between(0.5, 1.5)
    return PlanarObject(picture, (size, high), position=position, yaw=yaw, material=material)
