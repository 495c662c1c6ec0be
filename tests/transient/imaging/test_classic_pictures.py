"""f-k migration, light-cone transform and backprojection of points and planes in closed form."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.special import erf

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import (
    Detector,
    TransientCapture,
    Volume,
    backprojection,
    depth_map,
    downsampled,
    fk_migration,
    gated,
    lct,
    wall_grid,
)
from nlosoptics.transient.imaging.confocal_grids import (
    DIRECT_SHARE,
    confocal_grid,
    next_size,
    refuse_direct_light,
)
from nlosoptics.transient.imaging.fk_migration import _migrated

SIDE, COUNT = 1.0, 32  # m, wall
GRID = wall_grid(SIDE, COUNT)
PITCH = SIDE / COUNT
DEEP, N_BINS = 0.005, 320  # m of half the path per bin
PULSE = 0.01  # m of half the path, standard deviation
POINT = (0.11, -0.23, 0.72)
POWERS = {"diffuse": 4, "retroreflective": 2}


def capture(H, **changes):
    given = {"laser_points": GRID, "sensor_points": GRID, "delta_t": 2 * DEEP}
    return TransientCapture(**{**given, "pairing": "confocal", "H": H, **changes})


def point_light(*points, target="diffuse", start=0.0, pulse=PULSE):
    """Bins of the light of points, Gaussian pulses integrated over each bin."""
    edges = start + DEEP * np.arange(N_BINS + 1)[:, None, None]
    light = np.zeros((N_BINS, COUNT, COUNT))
    for point in points:
        r = np.linalg.norm(GRID - np.array(point), axis=-1)
        below = 0.5 * erf((edges - r) / (pulse * math.sqrt(2)))
        light += np.diff(below, axis=0) / r ** POWERS[target]
    return light


def around(point, pitch=0.006, count=25):
    """Fine voxels about a point, off its own lattice by a third of a pitch."""
    centre = np.array(point) + pitch * np.array([0.31, -0.27, 0.33])
    return Volume.box(centre, np.full(3, pitch * count), pitch)


def peak(image):
    """Brightest place by parabolas through the brightest voxel, (x, y, z), m."""
    values, found = image.intensity, []
    at = np.unravel_index(values.argmax(), values.shape)
    for i, axis in zip((2, 1, 0), (image.volume.x, image.volume.y, image.volume.z), strict=True):
        line = values[tuple(slice(None) if j == i else at[j] for j in range(3))]
        assert 0 < at[i] < len(line) - 1
        a, b, c = line[at[i] - 1 : at[i] + 2]
        found.append(axis[at[i]] + (axis[1] - axis[0]) * 0.5 * (a - c) / (a - 2 * b + c))
    return np.array(found)


def half_width(axis, line):
    """Full width at half of the maximum."""
    above = np.flatnonzero(line >= 0.5 * line.max())
    first, last = above[0], above[-1]
    step = axis[1] - axis[0]
    half = 0.5 * line.max()
    left = axis[first] - step * (line[first] - half) / (line[first] - line[first - 1])
    right = axis[last] + step * (line[last] - half) / (line[last] - line[last + 1])
    return right - left


METHODS = {
    "fk": lambda c, v, **k: fk_migration(c, v, **k),
    "fk, light": lambda c, v, **k: fk_migration(c, v, amplitude="light", **k),
    "lct": lambda c, v, **k: lct(c, v, **{"snr": 100.0, **k}),
    "backprojection": lambda c, v, target="diffuse": backprojection(
        c, v, filter="laplacian", width=0.012, falloff=target
    ),
}


@pytest.mark.parametrize("target", ["diffuse", "retroreflective"])
@pytest.mark.parametrize("name", METHODS)
def test_a_point_is_where_it_is(name, target):
    light = capture(point_light(POINT, target=target))
    found = peak(METHODS[name](light, around(POINT), target=target))
    # a third of the wall's pitch across; along z a voxel of the light-cone transform's squared
    # distance, and half a bin: the falloff within the pulse moves its middle by 4 PULSE^2/z
    assert found[:2] == pytest.approx(POINT[:2], abs=0.3 * PITCH)
    assert found[2] == pytest.approx(POINT[2], abs=DEEP)


@pytest.mark.parametrize("target", ["diffuse", "retroreflective"])
def test_the_falloff_is_undone(target):
    near, far = (0.05, 0.1, 0.5), (-0.1, 0.05, 0.95)
    sums, peaks = [], []
    for point in (near, far):
        light = capture(point_light(point, target=target))
        image = lct(light, around(point, pitch=0.01), target=target, snr=100.0)
        sums.append(image.intensity.sum())
        one = Volume(point[:1], point[1:2], point[2:])
        peaks.append(float(backprojection(light, one, falloff=target).intensity[0, 0, 0]))
    # equal points, of which Wiener's filter and what it takes below 0 leave unlike shares, 1.28;
    # a power of the depth too much or too little would be a factor of 1.9
    assert sums[1] == pytest.approx(sums[0], rel=0.4)
    # each path adds the middle of its pulse; bins and lines between them lower a Gaussian by
    # (1/24 + 1/12) (DEEP/PULSE)^2 in the mean, 3 %
    expected = COUNT**2 * DEEP / (PULSE * math.sqrt(2 * math.pi))
    assert peaks == pytest.approx([0.97 * expected] * 2, rel=0.01)


@pytest.mark.parametrize("name", METHODS)
def test_pictures_grow_with_the_light(name):
    light = capture(point_light(POINT))
    once = METHODS[name](light, around(POINT, count=7)).intensity
    more = METHODS[name](replace(light, H=3.0 * light.H), around(POINT, count=7)).intensity
    scale = 9.0 if name == "fk, light" else 3.0  # the square of a wave that is the light
    # waves and series in single precision
    assert more == pytest.approx(scale * once, abs=1e-4 * float(once.max()))


@pytest.mark.parametrize("name", METHODS)
def test_mirrored_scenes_have_mirrored_pictures(name):
    volume = Volume.before(SIDE, COUNT // 2, np.arange(0.6, 0.84, 0.01))
    one = METHODS[name](capture(point_light(POINT)), volume).intensity
    x_mirrored = METHODS[name](capture(point_light(POINT * np.array([-1, 1, 1]))), volume)
    turned = METHODS[name](capture(point_light((POINT[1], POINT[0], POINT[2]))), volume)
    # single precision
    assert x_mirrored.intensity[:, :, ::-1] == pytest.approx(one, abs=1e-4 * float(one.max()))
    assert turned.intensity.transpose(0, 2, 1) == pytest.approx(one, abs=1e-4 * float(one.max()))


@pytest.mark.parametrize("name", ["fk", "lct"])
def test_single_precision_is_enough(name):
    light = capture(point_light(POINT))
    volume = around(POINT, count=11)
    single = METHODS[name](light, volume, dtype="float32").intensity
    double = METHODS[name](light, volume, dtype="float64").intensity
    # rounding of 2^-24 per sum of some thousand terms
    assert single == pytest.approx(double, abs=1e-5 * double.max())
    assert double.dtype == np.float64


def test_migration_is_the_sum_over_waves():
    side, count, n_bins = 0.4, 8, 50
    grid, depths = wall_grid(side, count), 0.01 * (np.arange(50) + 0.5)
    r = np.linalg.norm(grid - np.array([0.05, -0.02, 0.3]), axis=-1)
    light = np.exp(-0.5 * ((depths[:, None, None] - r) / 0.015) ** 2)
    volume = Volume([0.05, 0.12], [-0.03], [0.28, 0.3, 0.32])
    seen = capture(light, laser_points=grid, sensor_points=grid, delta_t=0.02)
    found = fk_migration(seen, volume, dtype="float64").intensity
    amplitude = np.sqrt(light * depths[:, None, None] ** 4)
    k = np.arange(-count + 1, count) / (2 * side)
    to_k = np.exp(-2j * np.pi * k[:, None] * grid[0, :, 0])
    waves = np.einsum("ay,bx,tyx->tab", to_k, to_k, amplitude)
    period = 0.02 * next_size(1.5 * n_bins * 0.01 / 0.02)
    field = np.zeros(volume.shape, complex)
    for kz in np.arange(1, int(50 * period) + 1) / period:  # up to 1/(2 bins)
        f = np.sqrt(k[:, None] ** 2 + k**2 + kz**2)
        turns = np.exp(-2j * np.pi * f * depths[:, None, None])
        part = (waves * turns).sum(axis=0) * (kz / f) * (f <= 50.0)
        for (iz, iy, ix), _ in np.ndenumerate(field):
            across = k[:, None] * volume.y[iy] + k * volume.x[ix]
            field[iz, iy, ix] += (part * np.exp(2j * np.pi * (across + kz * volume.z[iz]))).sum()
    expected = np.abs(field) ** 2
    # the gridding kernel errs by 1e-6 of the largest wave; one scale is free
    assert found / found.max() == pytest.approx(expected / expected.max(), abs=1e-5)


def test_waves_of_light_add_up():
    points, volume = ((0.2, 0.15, 0.6), (-0.22, -0.1, 0.9)), around(POINT, pitch=0.05, count=9)
    grid = confocal_grid(capture(point_light(*points)), "test")
    both, *parts = (
        _migrated(point_light(*given), grid, volume, np.complex128, None)
        for given in (points, points[:1], points[1:])
    )
    # rounding of some thousand terms
    assert np.abs(both - sum(parts)).max() < 1e-11 * np.abs(both).max()
    weights = grid.depths[:, None, None] ** 4
    light = capture(point_light(*points) / weights)
    picture = fk_migration(light, volume, amplitude="light", dtype="float64").intensity
    assert picture == pytest.approx(np.abs(both) ** 2, rel=1e-9)


def test_the_wave_of_the_albedo_is_sharper():
    fine = np.linspace(-0.2, 0.2, 101)
    light = capture(point_light((0.0, 0.0, 0.6), pulse=2 * PULSE))
    widths = []
    for amplitude in ("light", "albedo"):
        image = fk_migration(light, Volume(fine, [0.0], [0.6]), amplitude=amplitude)
        widths.append(half_width(fine, image.intensity[0, 0]))
    # along f, the spectrum exp(-a f^2) is replaced by f exp(-a f^2), of thrice the mean square
    assert 0.5 < widths[1] / widths[0] < 0.85


def test_the_window_may_begin_late():
    light = capture(point_light(POINT))
    volume = around(POINT, count=11)
    whole = fk_migration(light, volume).intensity
    late = fk_migration(gated(light, start=1.2), volume).intensity  # first light is at 1.4 m
    # the kernel's error, 1e-6, at another place of its lattice
    assert late == pytest.approx(whole, abs=2e-5 * float(whole.max()))


@pytest.mark.parametrize(("name", "least", "most"), [("fk", 1.0, 2.0), ("lct", 0.5, 1.0)])
def test_the_width_of_a_point_is_the_theory_s(name, least, most):
    pulse = 2.3548 * 2 * PULSE  # half width, half the path; longer than the wall's pitch
    fine = np.linspace(-0.2, 0.2, 101)
    ratios = []
    for depth in (0.4, 0.6, 0.8):
        light = capture(point_light((0.0, 0.0, depth), pulse=2 * PULSE))
        across = pulse * math.hypot(0.5 * SIDE, depth) / (0.5 * SIDE)  # O'Toole 2018, Methods
        image = METHODS[name](light, Volume(fine, [0.0], [depth]))
        ratios.append(half_width(fine, image.intensity[0, 0]) / across)
        line = METHODS[name](light, Volume([0.0], [0.0], depth + fine)).intensity[:, 0, 0]
        # Wiener's filter sharpens below the pulse; the modulus of waves of positive frequency,
        # which have no carrier here, is wider than the pulse, by less than its double
        assert least < half_width(depth + fine, line) / pulse < most
    # the theory sets two points a pulse apart as seen from the wall's edge: no shape, so a factor
    # near 1 is free, but it must be the same at all depths; squares of the depth blur by a sample
    assert np.mean(ratios) == pytest.approx(1.15, abs=0.3)
    assert np.ptp(ratios) < 0.2 * np.mean(ratios)


def test_a_plane_is_at_its_depth():
    depth = 0.643
    edges = DEEP * np.arange(N_BINS + 1)
    # an unbounded plane of points of falloff r^-4: rings 2 pi r dr at the path r
    below = np.where(edges > depth, math.pi * (depth**-2 - np.maximum(edges, depth) ** -2), 0.0)
    light = np.broadcast_to(np.diff(below)[:, None, None], (N_BINS, COUNT, COUNT))
    volume = Volume.before(0.3, 8, np.arange(0.5, 0.8, DEEP))
    for image in (
        fk_migration(capture(light), volume),
        lct(capture(light), volume, snr=100.0),
        backprojection(capture(light), volume, filter="second_derivative", width=0.01),
    ):
        found = depth_map(image).depth
        # the light starts at once and goes on for long: its sharpest place is within two bins
        assert np.abs(found - depth).max() < 2 * DEEP


def test_the_two_transforms_agree_on_two_points():
    points = ((0.2, 0.15, 0.6), (-0.22, -0.1, 0.9))
    light = capture(point_light(*points))
    for point in points:
        places = [peak(METHODS[name](light, around(point))) for name in ("fk", "lct")]
        # both within a third of the pitch across, a bin along
        assert places[0][:2] == pytest.approx(places[1][:2], abs=0.3 * PITCH)
        assert places[0][2] == pytest.approx(places[1][2], abs=1.5 * DEEP)


def forward(values, volume, lasers, sensors, n_bins, delta_t, t_start):
    """Light of voxels, each falling as 1/(r1 r2)^2 on the two bins next to its path."""
    out = np.zeros((n_bins + 2, len(lasers)))
    points = volume.points.reshape(-1, 3)
    for p, (a, b) in enumerate(zip(lasers, sensors, strict=True)):
        r1, r2 = (np.linalg.norm(points - end, axis=1) for end in (a, b))
        place = np.clip((r1 + r2 - t_start) / delta_t + 0.5, 0, n_bins + 1)
        cell = np.minimum(place.astype(int), n_bins)
        light = values.ravel() / (r1 * r2) ** 2
        np.add.at(out[:, p], cell, light * (1 - (place - cell)))
        np.add.at(out[:, p], cell + 1, light * (place - cell))
    return out[1:-1]


@pytest.mark.parametrize("pairing", ["confocal", "all", "one laser"])
def test_backprojection_is_an_adjoint(pairing):
    rng = np.random.default_rng(5)
    volume = Volume(np.linspace(-0.2, 0.3, 5), np.linspace(-0.1, 0.2, 4), np.linspace(0.5, 0.8, 6))
    # less than 0.9 m apart: light cannot come sooner than along the wall
    sensors = rng.uniform(-0.3, 0.3, (7, 3)) * [1, 1, 0]
    lasers = {"confocal": sensors, "all": rng.uniform(-0.3, 0.3, (3, 3)) * [1, 1, 0.1]}.get(
        pairing, np.zeros(3)
    )
    shape = (60, 7) if pairing != "all" else (60, 3, 7)
    light = rng.uniform(0.1, 1.0, shape)
    seen = TransientCapture(
        H=light,
        laser_points=lasers,
        sensor_points=sensors,
        delta_t=0.02,
        t_start=0.9,
        pairing="confocal" if pairing == "confocal" else "all",
    )
    back = backprojection(seen, volume, falloff="matched").intensity
    if pairing == "confocal":
        pairs = sensors, sensors
    else:
        rows = np.atleast_2d(lasers)
        pairs = np.repeat(rows, 7, axis=0), np.tile(sensors, (len(rows), 1))
    values = rng.uniform(size=volume.shape)
    there = forward(values, volume, *pairs, 60, 0.02, 0.9)
    # the capture is stored in single precision: 2^-24 of each value
    assert np.vdot(back, values) == pytest.approx(np.vdot(light, there), rel=1e-7)


def test_two_voxels_have_no_curvature():
    """The Laplacian of a volume two voxels wide and one high is the derivative along z."""
    light, z = capture(point_light(POINT)), POINT[2] + 0.01 * np.arange(-8, 9)
    volume = Volume(POINT[0] + np.array([0.0, 0.02]), [POINT[1]], z)
    images = [backprojection(light, volume, filter=f) for f in ("laplacian", "second_derivative")]
    assert np.ptp(images[0].intensity, axis=2).max() > 0.01 * images[0].intensity.max()
    np.testing.assert_array_equal(images[0].intensity, images[1].intensity)


def test_backprojection_takes_outer_legs_with_it():
    light = capture(point_light(POINT))
    volume = around(POINT, count=7)
    origin = np.array([0.4, -0.3, 1.2])
    legs = 2 * np.linalg.norm(GRID - origin, axis=-1)
    # the same light with the legs in, moved bin by bin
    start = 2.0
    places = (np.arange(700) + 0.5) * light.delta_t + start
    moved = np.zeros((700, COUNT, COUNT))
    for iy in range(COUNT):
        for ix in range(COUNT):
            moved[:, iy, ix] = np.interp(
                places - legs[iy, ix], light.times, light.H[:, iy, ix], left=0, right=0
            )
    outer = capture(
        moved, t_start=start, outer_legs=True, laser_origin=origin, sensor_origin=origin
    )
    found = peak(backprojection(outer, volume))
    # interpolating twice blurs by half a bin and moves nothing
    assert found == pytest.approx(peak(backprojection(light, volume)), abs=0.2 * DEEP)
    with pytest.raises(SceneError, match="without_outer_legs"):
        fk_migration(outer)


def test_blocks_and_threads_change_no_bit(on_threads):
    light = capture(point_light(POINT))
    volume = Volume.before(SIDE, 11, np.arange(0.6, 0.8, 0.02))
    for method in (fk_migration, lct, backprojection):
        one, two = (on_threads(n, lambda f=method: f(light, volume).intensity) for n in (1, 2))
        assert np.array_equal(one, two)


def direct():
    light = point_light(POINT)
    light[0] = 100.0
    return capture(light)


@pytest.mark.parametrize("dark", [0.5, 20.0])
@pytest.mark.parametrize("gate", [None, (0.0, 2.2)])
def test_dark_counts_are_no_direct_light(dark, gate):
    """Dark counts of up to many times the signal pass; the laser's spot among them does not."""
    light = 100.0 * point_light(POINT)
    detector = Detector(dark_counts=dark, gate=gate)

    def counted():
        return detector.measure(downsampled(capture(light), bins=4), seed=3)

    noisy = counted()
    if dark > 1.0:  # what is along the wall alone tells nothing
        assert noisy.H[:2].sum() > 2 * DIRECT_SHARE * noisy.H.sum()
    refuse_direct_light(noisy, "test")
    light[0] = 0.1 * light.sum(axis=0)
    with pytest.raises(SceneError, match="lit point itself"):
        refuse_direct_light(counted(), "test")


BENT = GRID + np.array([0.0, 0.0, 1.0]) * GRID[..., :1] ** 2
FLIPPED = GRID[::-1]


@pytest.mark.parametrize("method", [fk_migration, lct])
@pytest.mark.parametrize(
    ("given", "volume", "kind", "words"),
    [
        (lambda: capture(np.ones(9), pairing="all", laser_points=np.zeros(3),
                         sensor_points=np.ones(3)), None, SamplingError, "needs a confocal"),
        (lambda: capture(point_light(POINT), laser_points=GRID + 0.01), None, SamplingError,
         "needs a confocal capture"),
        (lambda: capture(np.ones((9, 4)), laser_points=GRID[0, :4], sensor_points=GRID[0, :4]),
         None, SamplingError, "grid of points"),
        (lambda: capture(point_light(POINT), laser_points=BENT, sensor_points=BENT), None,
         SamplingError, "even grid"),
        (lambda: capture(point_light(POINT), laser_points=FLIPPED, sensor_points=FLIPPED), None,
         SamplingError, "rising"),
        (direct, None, SceneError, "lit point itself"),
        (lambda: capture(point_light(POINT)), Volume([0.0], [0.0], [1.0, 2.0]), SamplingError,
         "1 to 2 m are not within the 0 to 1.6 m"),
        (lambda: capture(point_light(POINT), t_start=4.0), Volume([0.0], [0.0], [0.5, 1.0]),
         SamplingError, "are not within the 1.45"),
        (lambda: capture(point_light(POINT)), Volume([3.0], [0.0], [1.0]), SamplingError,
         "along x"),
    ],
)  # fmt: skip
def test_what_transforms_refuse(method, given, volume, kind, words):
    with pytest.raises(kind, match=words) as caught:
        method(given(), volume)
    assert "\n" not in str(caught.value)


def test_what_backprojection_refuses():
    light = capture(point_light(POINT))
    with pytest.raises(SamplingError, match=r"depths 1\.6 to 2 m have no path"):
        backprojection(light, Volume([0.0], [0.0], np.linspace(1.0, 2.0, 21)))
    with pytest.raises(SceneError, match="lit point itself"):
        backprojection(direct(), Volume([0.0], [0.0], [0.7, 0.8]))
    with pytest.raises(SamplingError, match="at least 3 voxels"):
        backprojection(light, Volume([0.0], [0.0], [1.0]), filter="laplacian")
    with pytest.raises(SceneError, match="sharpen"):
        backprojection(light, Volume([0.0], [0.0], [1.0]), filter="sharpen")
    with pytest.raises(SceneError, match="width is for a filter"):
        backprojection(light, Volume([0.0], [0.0], [1.0]), width=0.02)
    with pytest.raises(SceneError, match=r"volume\.z begins at 0 m, must be above 0"):
        backprojection(light, Volume([0.0], [0.0], [0.0, 1.0]), falloff="matched")
    with pytest.raises(SceneError, match="snr"):
        lct(light, snr=0.0)
    with pytest.raises(SceneError, match="target"):
        fk_migration(light, target="glossy")
    single = capture(point_light(POINT)[150:151], t_start=300 * DEEP)
    with pytest.raises(SamplingError, match=r"needs 2 bins, the capture has 1; give amplitude"):
        fk_migration(single, amplitude="albedo")


def letter_z(volume):
    """The Z of the peer's captures, (ny, nx)."""
    x, y = volume.x, volume.y[:, None]
    inside = (np.abs(x) <= 0.35) & (np.abs(y) <= 0.4)
    left = -0.35 + (y + 0.24) * (0.158 + 0.35) / 0.48  # the bar's left side, from low to high
    bar = (x >= left) & (x <= left + 0.192)
    return inside & ((np.abs(y) >= 0.24) | bar)


@pytest.mark.skipif("NLOSOPTICS_DATA" not in os.environ, reason="recorded data is not there")
def test_the_letter_of_another_renderer_is_read():
    folder = Path(os.environ["NLOSOPTICS_DATA"]) / "peer_transient"
    with np.load(folder / "Z_confocal16_3b.npz") as file:
        light, meta = file["H"], json.loads(str(file["meta"]))
    grid = wall_grid(2.0, 16)
    to_laser = np.array(meta["sensor_origin"]) - grid
    distance = np.linalg.norm(to_laser, axis=-1)
    light = light / (to_laser[..., 2] / distance**3)[..., None]  # the laser's cos/d^2 per point
    seen = capture(
        light.transpose(2, 0, 1),
        laser_points=grid,
        sensor_points=grid,
        delta_t=meta["bin_width_opl_m"],
        t_start=meta["start_opl_m"],
    )
    volume = Volume.before(1.2, 48, np.arange(0.94, 1.06, 0.01))
    truth = letter_z(volume)
    blurred = gaussian_filter1d(seen.H, 0.04 / seen.delta_t, axis=0, mode="nearest")
    soft = replace(seen, H=blurred)
    for image in (fk_migration(soft, volume), lct(seen, volume, snr=1.0)):
        picture = image.projection()
        iou = {
            name: max(overlap(picture, t, share) for share in np.arange(0.1, 0.9, 0.02))
            for name, t in (("right", truth), ("turned", truth.T), ("mirrored", truth[:, ::-1]))
        }
        # a blur of the 12.5 cm between the points takes 2 cm off each side of strokes of 16 cm
        assert iou["right"] > 0.75
        assert max(iou["turned"], iou["mirrored"]) < 0.6


def overlap(picture, truth, share):
    found = picture >= share * picture.max()
    return (found & truth).sum() / (found | truth).sum()
