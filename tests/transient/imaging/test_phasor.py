"""Virtual cameras: sums against brute force, widths against closed forms, and warnings."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from nlosoptics.errors import (
    MemoryLimitError,
    PerformanceWarning,
    SamplingError,
    SceneError,
    ValidityWarning,
)
from nlosoptics.transient import TransientCapture, Volume, phasor_image, wall_grid

CENTRE = (0.0, 0.0, 0.0)


def noise_capture(laser_points=CENTRE, sensor_points=None, **changes):
    """Random bins: sums must agree on any light."""
    sensors = wall_grid(1.0, 6) if sensor_points is None else sensor_points
    lasers = np.asarray(laser_points)
    paired = changes.get("pairing") == "confocal"
    shape = sensors.shape[:-1] if paired else lasers.shape[:-1] + sensors.shape[:-1]
    given = {
        "H": np.random.default_rng(1).random((220, *shape)),
        "laser_points": lasers,
        "sensor_points": sensors,
        "delta_t": 0.02,
        "t_start": 0.4,
    }
    return TransientCapture(**{**given, **changes})


def quiet(capture, volume, **options):
    """A picture whose sampling is meant to be coarse."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        return phasor_image(capture, volume, **options)


def pulse(times, wl_mean, wl_sigma):
    return np.exp(2j * np.pi * times / wl_mean - 0.5 * (times / wl_sigma) ** 2)


def brute_force(capture, points, wl_mean, wl_sigma, *, leg=True, time=0.0):
    """Sum of H_j K(path + time - t_j) over lasers, sensors and bins at points, in plain numpy."""
    lasers, sensors = (p.reshape(-1, 3) for p in (capture.laser_points, capture.sensor_points))
    bins = capture.H.reshape(capture.n_bins, -1)
    if capture.pairing == "confocal":
        pairs = [(i, i) for i in range(len(lasers))]
    else:
        pairs = [(i, j) for i in range(len(lasers)) for j in range(len(sensors))]
    field = np.zeros(points.shape[:-1], dtype=complex)
    for column, (i, j) in enumerate(pairs):
        path = np.linalg.norm(points - sensors[j], axis=-1) + time
        if leg:
            path = path + np.linalg.norm(points - lasers[i], axis=-1)
        if capture.outer_legs:
            path = path + np.linalg.norm(np.subtract(capture.laser_origin, lasers[i]))
            path = path + np.linalg.norm(np.subtract(capture.sensor_origin, sensors[j]))
        seen = pulse(path[..., None] - capture.times, wl_mean, wl_sigma)
        field += seen @ bins[:, column]
    return field


def relative(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


LASERS = wall_grid(0.8, 3)
SINGLE = noise_capture((0.1, -0.05, 0.0))
CONFOCAL = noise_capture(wall_grid(1.0, 6), pairing="confocal")
EXHAUSTIVE = noise_capture(LASERS)
SWAPPED = noise_capture(wall_grid(1.0, 6), np.array(CENTRE))
PITCH = 1.0 / 6
#: shifted by whole and by broken steps of the pitch, as wide as the wall and not, and with steps
#: of several pitches and several to a pitch
VOLUMES = {
    "before": Volume.before(1.0, 6, [0.5, 0.6, 0.7]),
    "shifted": Volume(PITCH * (np.arange(6) - 1.5), PITCH * (np.arange(6) - 3.5), [0.5, 0.6]),
    "aside": Volume(PITCH * (np.arange(4) + 1.5), PITCH * (np.arange(3) - 6.5), [0.8]),
    "between": Volume(PITCH * np.arange(5) - 0.31, PITCH * np.arange(9) + 0.123, [0.55, 0.65]),
    "coarse": Volume(3 * PITCH * np.arange(3) - 0.4, 2 * PITCH * (np.arange(4) - 1.25), [0.7]),
    "fine": Volume(PITCH / 2 * np.arange(7) - 0.4, PITCH / 3 * np.arange(4) + 0.1, [0.55, 0.65]),
    "line": Volume([0.2], PITCH * np.arange(7) - 0.4, [0.55, 0.65]),
}


@pytest.mark.parametrize("volume", VOLUMES.values(), ids=VOLUMES)
@pytest.mark.parametrize("method", ["direct", "fft"])
@pytest.mark.parametrize(
    ("capture", "options", "brute"),
    [
        (SINGLE, {}, {}),
        (SWAPPED, {"camera": "direct_light"}, {}),
        (CONFOCAL, {}, {}),
        (EXHAUSTIVE, {}, {}),
        (SINGLE, {"camera": "transient", "times": [0.9]}, {"leg": False, "time": 0.9}),
        (CONFOCAL, {"times": [0.2]}, {"time": 0.2}),
        (SINGLE, {"times": [-0.15]}, {"time": -0.15}),
    ],
    ids=["single", "swapped", "confocal", "exhaustive", "transient", "late", "early"],
)
def test_cameras_are_the_sum_over_bins_and_points(capture, options, brute, method, volume):
    image = quiet(capture, volume, wl_mean=0.3, wl_sigma=0.25, method=method, tol=1e-14, **options)
    field = image.field if image.times is None else image.field[0]
    expected = brute_force(capture, volume.points, 0.3, 0.25, **brute)
    # rounding of phases of some hundred rad, and tol's 1e-14 of each path's pulse
    assert relative(field, expected) < 1e-12
    assert image.intensity == pytest.approx(np.abs(field) ** 2, rel=1e-12)


@pytest.mark.parametrize("method", ["direct", "fft"])
@pytest.mark.parametrize("tol", [0.1, 1e-2, 1e-4])
def test_tol_bounds_the_pulse(tol, method):
    """One bin of light shows the pulse itself."""
    light = np.zeros((220, 1, 1))
    light[100] = 1.0
    capture = noise_capture(CENTRE, np.zeros((1, 1, 3)), H=light)
    volume = Volume([0.0], [0.0], 0.2 + 0.01 * np.arange(220))
    image = quiet(capture, volume, wl_mean=0.3, tol=tol, method=method)
    expected = pulse(2.0 * volume.z - capture.times[100], 0.3, 0.3 / math.sqrt(2.0))
    error = np.abs(image.field[:, 0, 0] - expected).max()
    assert 1e-3 * tol < error < tol


TWO = noise_capture(np.array([[0.1, 0.0, 0.0], [-0.2, 0.3, 0.0]]))


@pytest.mark.parametrize(
    "capture",
    [
        *(SINGLE, TWO, CONFOCAL, EXHAUSTIVE),
        noise_capture(LASERS, wall_grid(1.0, 6)[2:3]),
        noise_capture(LASERS[:, :2], wall_grid(1.0, 6)[:, 3:4]),
    ],
    ids=["one", "two", "pairs", "all", "row", "column"],
)
def test_transforms_and_sums_agree_in_both_precisions(capture):
    volume = VOLUMES["between"]
    # a tenth of tol for the interpolation of the pulse, and rounding
    for tol, kind, least in (
        (1e-13, np.complex128, 3e-14),
        (9e-6, np.complex128, 9e-7),
        (1e-5, np.complex64, 2e-6),
        (1e-3, np.complex64, 1e-4),
    ):
        options = {"wl_mean": 0.3, "tol": tol}
        direct = quiet(capture, volume, method="direct", **options)
        fast = quiet(capture, volume, method="fft", **options)
        assert fast.field.dtype == kind
        assert relative(fast.field, direct.field) < least


def test_outer_legs_are_taken_away_point_by_point():
    origins = {"laser_origin": (0.4, 0.3, 0.9), "sensor_origin": (-0.2, 0.1, 0.7)}
    capture = noise_capture(LASERS, outer_legs=True, t_start=1.5, **origins)
    volume = VOLUMES["aside"]
    image = quiet(capture, volume, wl_mean=0.3, wl_sigma=0.25, tol=1e-14)
    expected = brute_force(capture, volume.points, 0.3, 0.25)
    assert relative(image.field, expected) < 1e-12
    with pytest.raises(SceneError, match="sensor_origin not given"):
        quiet(noise_capture(outer_legs=True, laser_origin=(0.4, 0.3, 0.9)), volume, wl_mean=0.3)


def test_start_of_bins_is_a_phase_and_no_padding():
    shifted = noise_capture(H=np.concatenate([np.zeros((20, 6, 6)), SINGLE.H]), t_start=0.0)
    single = noise_capture()
    volume = VOLUMES["before"]
    fields = [quiet(c, volume, wl_mean=0.3, tol=1e-14).field for c in (single, shifted)]
    assert relative(fields[1], fields[0]) < 1e-12


def test_falling_grids_and_single_precision_bins():
    flipped = noise_capture(sensor_points=wall_grid(1.0, 6)[::-1, ::-1])
    volume = VOLUMES["between"]
    options = {"wl_mean": 0.3, "tol": 1e-13}
    fast, direct = (quiet(flipped, volume, method=m, **options) for m in ("fft", "direct"))
    assert relative(fast.field, direct.field) < 1e-13
    single = noise_capture(H=flipped.H.astype(np.float32), sensor_points=flipped.sensor_points)
    # eps of single precision, over the square root of the light's count
    assert relative(quiet(single, volume, **options).field, fast.field) < 1e-6


@pytest.mark.parametrize("n_slices", [2, 5])
def test_waves_done_in_slices_add_up(monkeypatch, n_slices):
    from nlosoptics.transient.imaging import phasor_camera

    volume = VOLUMES["before"]
    whole = quiet(EXHAUSTIVE, volume, wl_mean=0.3, tol=1e-6, method="direct")
    waves = whole.details["n_waves"]
    monkeypatch.setattr(
        phasor_camera, "SPECTRA", 16 * EXHAUSTIVE.H[0].size * math.ceil(waves / n_slices)
    )
    told = []
    options = {
        "wl_mean": 0.3,
        "tol": 1e-6,
        "progress": lambda text, share: told.append((share, text)),
    }
    sliced = quiet(EXHAUSTIVE, volume, method="direct", **options)
    assert relative(sliced.field, whole.field) < 1e-13
    assert len({text for _, text in told}) == n_slices
    assert [share for share, _ in told] == sorted(share for share, _ in told)
    assert told[-1][0] == pytest.approx(1.0)
    told.clear()
    fast = quiet(EXHAUSTIVE, volume, method="fft", **options)
    # a tenth of tol
    assert relative(fast.field, whole.field) < 1e-7
    assert len({text for _, text in told}) == n_slices


def test_apertures_are_squares():
    capture, volume = EXHAUSTIVE, VOLUMES["before"]
    # a square of 0.7 m holds 4 of 6 sensor points along each side, and all laser points
    cut = quiet(capture, volume, wl_mean=0.3, aperture=0.6)
    within = [(np.abs(p[..., :2]) <= 0.3).all(axis=-1) for p in (LASERS, wall_grid(1.0, 6))]
    few = noise_capture(LASERS, H=capture.H * within[0][:, :, None, None] * within[1])
    # two of tol
    assert relative(cut.field, quiet(few, volume, wl_mean=0.3).field) < 2e-3
    with pytest.raises(SamplingError, match="contains none of 36 wall points"):
        quiet(SINGLE, volume, wl_mean=0.3, aperture=0.1)


def point_capture(count, side, place, wl_mean, pairing, bins_per_wave=32):
    """A point's light, shared by the two bins whose middles are next to its path."""
    sensors = wall_grid(side, count)
    width = wl_mean / bins_per_wave
    leg = np.linalg.norm(sensors - place, axis=-1)
    path = 2.0 * leg if pairing == "confocal" else leg + np.linalg.norm(place)
    start = math.floor(path.min() / width) * width - 2.0 * width
    n_bins = math.ceil((path.max() - start) / width) + 3
    place_in_bins = (path - start) / width - 0.5
    low = np.floor(place_in_bins).astype(int)
    light = np.zeros((n_bins, count, count))
    rows, columns = np.indices(low.shape)
    light[low, rows, columns] = 1.0 - (place_in_bins - low)
    light[low + 1, rows, columns] = place_in_bins - low
    return TransientCapture(
        H=light,
        laser_points=sensors if pairing == "confocal" else CENTRE,
        sensor_points=sensors,
        delta_t=width,
        t_start=start,
        pairing=pairing,
    )


def full_width(x, light):
    """Between the two places where it is half of its peak."""
    above = np.flatnonzero(light >= 0.5 * light.max())
    ends = []
    for inside, outside in ((above[0], above[0] - 1), (above[-1], above[-1] + 1)):
        share = (light[inside] - 0.5 * light.max()) / (light[inside] - light[outside])
        ends.append(x[inside] + share * (x[outside] - x[inside]))
    return ends[1] - ends[0]


@pytest.mark.thorough
@pytest.mark.parametrize("pairing", ["all", "confocal"])
@pytest.mark.parametrize(
    ("side", "depth", "one_way", "confocal"),
    # FWHM in wl_mean depth/side of |sum exp(i k w (r0 - r))|^2, 128 x 128 points, equal weights
    [(0.896, 1.25, 0.937, 0.468), (1.792, 1.25, 1.064, 0.532), (1.792, 1.7, 0.988, 0.494)],
)
def test_points_are_as_wide_as_diffraction_says(side, depth, one_way, confocal, pairing):
    wl_mean = 0.112
    capture = point_capture(128, side, np.array([0.0, 0.0, depth]), wl_mean, pairing)
    unit = wl_mean * depth / side
    volume = Volume(np.linspace(-0.9, 0.9, 181) * unit, [0.0], [depth])
    # one wave: a pulse of 30 wavelengths
    image = quiet(capture, volume, wl_mean=wl_mean, wl_sigma=30 * wl_mean, method="direct")
    assert image.method.startswith("phasor field")
    expected = one_way if pairing == "all" else confocal
    assert full_width(volume.x, image.intensity[0, 0]) / unit == pytest.approx(
        expected, abs=0.003 + 0.01 * expected
    )


@pytest.mark.parametrize("pairing", ["all", "confocal"])
def test_point_is_found_where_it_is_between_planes(pairing):
    """Depth to a twentieth of the wavelength from planes half a wavelength apart."""
    wl_mean, place = 0.2, np.array([-0.13, 0.21, 0.97])
    capture = point_capture(32, 1.6, place, wl_mean, pairing)
    volume = Volume.before(1.6, 32, 0.6 + 0.5 * wl_mean * np.arange(8))
    image = quiet(capture, volume, wl_mean=wl_mean)
    row, column = np.unravel_index(image.projection().argmax(), (32, 32))
    assert abs(volume.x[column] - place[0]) <= 0.025
    assert abs(volume.y[row] - place[1]) <= 0.025
    found = image.peak_depth()[row, column]
    # the envelope along z is a Gaussian up to what the aperture adds
    assert found == pytest.approx(place[2], abs=0.05 * wl_mean)
    assert abs(volume.z - place[2]).min() > 0.1 * wl_mean


def test_depth_of_one_plane_or_of_darkness_is_a_plane():
    capture = noise_capture(H=np.zeros((220, 6, 6)))
    image = quiet(capture, VOLUMES["before"], wl_mean=0.3)
    assert np.isin(image.peak_depth(), VOLUMES["before"].z).all()
    assert (quiet(SINGLE, VOLUMES["aside"], wl_mean=0.3).peak_depth() == 0.8).all()


def test_transient_camera_sees_light_arrive():
    """A film of one point: brightest when the pulse that left the laser reaches it."""
    place = np.array([0.1, -0.1, 0.8])
    capture = point_capture(16, 1.6, place, 0.2, "all")
    volume = Volume(place[:1], place[1:2], place[2:])
    times = np.linspace(0.3, 1.3, 101)
    film = quiet(capture, volume, wl_mean=0.2, camera="transient", times=times)
    light = np.abs(film.field[:, 0, 0, 0])
    assert times[light.argmax()] == pytest.approx(np.linalg.norm(place), abs=0.01)
    assert film.intensity[0, 0, 0] == pytest.approx(light.max() ** 2)


def test_slow_sums_are_warned_of(monkeypatch):
    from nlosoptics.transient.imaging import phasor_camera

    points = wall_grid(1.0, 24)
    large = noise_capture(H=np.ones((120, 24, 24)), sensor_points=points)
    facing = Volume.facing(points, (0.5, 0.6, 0.1))
    off = Volume(1.01 * facing.x, 1.01 * facing.y, facing.z)
    # a fraction of a second is not worth a word
    with warnings.catch_warnings():
        warnings.simplefilter("error", PerformanceWarning)
        assert phasor_image(large, off, wl_mean=0.4).details["sum"] == "direct"
    monkeypatch.setattr(phasor_camera, "LARGE", 1e5)
    words = "steps by 0.0420833 m and the wall's points by 0.0416667 m.*about 0.0.* s of a core"
    with pytest.warns(PerformanceWarning, match=words) as caught:
        phasor_image(large, off, wl_mean=0.4)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error", PerformanceWarning)
        # asked for, on the grid, or few paths
        phasor_image(large, off, wl_mean=0.4, method="direct")
        phasor_image(large, facing, wl_mean=0.4)
        phasor_image(large, Volume(facing.x[:2], facing.y[:2], off.z), wl_mean=0.4)


def test_coarse_sampling_is_warned_of():
    volume = VOLUMES["before"]
    with pytest.warns(ValidityWarning, match=r"0.1667 m apart, limit 0.15 m, wl_mean/2"):
        image = phasor_image(SINGLE, volume, wl_mean=0.3)
    assert len(image.notes) == 1
    with pytest.warns(ValidityWarning, match=r"limit 0.125 m, wl_mean/4"):
        phasor_image(CONFOCAL, volume, wl_mean=0.5)
    with pytest.warns(ValidityWarning, match="laser points are up to 0.2667 m"):
        phasor_image(EXHAUSTIVE, volume, wl_mean=0.4)
    wide = noise_capture(H=np.ones((60, 6, 6)), delta_t=0.12)
    with pytest.warns(ValidityWarning, match="a quarter of wl_mean"):
        phasor_image(wide, volume, wl_mean=0.4)
    with pytest.raises(SamplingError, match="delta_t = 0.12 m"):
        phasor_image(wide, volume, wl_mean=0.2)
    short = noise_capture(H=np.ones((50, 6, 6)), t_start=1.2)
    with pytest.warns(ValidityWarning, match="leave out"):
        phasor_image(short, volume, wl_mean=0.4)
    bent = wall_grid(1.0, 6)
    bent[..., 0] += 0.02 * bent[..., 0] ** 2
    with pytest.warns(ValidityWarning, match="unevenly spaced"):
        image = phasor_image(noise_capture(sensor_points=bent), volume, wl_mean=0.4)
    assert image.details["sum"] == "direct"


def test_share_of_paths_outside_the_bins_is_exact_for_few_voxels():
    """All paths of up to 15 voxels along each axis are counted, not only a sample of them."""
    volume = Volume(np.linspace(-0.4, 0.1, 7), np.linspace(-0.2, 0.3, 5), np.linspace(0.5, 0.9, 11))
    points = volume.points[..., None, :]
    paths = 2 * np.linalg.norm(points - CONFOCAL.sensor_points.reshape(-1, 3), axis=-1)
    late = np.median(paths)
    short = noise_capture(
        np.array(CONFOCAL.laser_points), pairing="confocal", H=CONFOCAL.H[: int(late / 0.02)],
        t_start=0.0,
    )  # fmt: skip
    outside = 100 * np.mean(paths > short.edges[-1])
    with pytest.warns(ValidityWarning, match=f"leave out {outside:.2g} % of the paths"):
        phasor_image(short, volume, wl_mean=0.7)
    few = quiet(short, volume, wl_mean=0.7)
    assert f"({paths.min():.4g} to {paths.max():.4g} m)" in few.notes[-1]


@pytest.mark.parametrize(
    ("capture", "options", "kind", "message"),
    [
        (SINGLE, {"camera": "pinhole"}, SceneError, "camera = 'pinhole' is unknown"),
        (SINGLE, {"camera": "transient"}, SceneError, "needs times"),
        (SINGLE, {"times": "now"}, SceneError, "times of type <U3 are not real numbers"),
        (SINGLE, {"times": [[0.0], [0.0, 0.1]]}, SamplingError, "times have rows of several"),
        (SINGLE, {"camera": "direct_light", "times": [0.1]}, SceneError, "is at t = 0"),
        (EXHAUSTIVE, {"camera": "transient", "times": [1.0]}, SceneError, "needs one laser point"),
        (CONFOCAL, {"camera": "transient", "times": [1.0]}, SamplingError, "has pairs"),
        (SINGLE, {"times": [math.nan]}, SceneError, "not finite"),
        (SINGLE, {"wl_mean": -1.0}, SceneError, "wl_mean = -1 m"),
        (SINGLE, {"aperture": np.ones((6, 6))}, SceneError, "aperture"),
        (SINGLE, {"wl_sigma": 1e-9}, SamplingError, "wl_sigma = 1e-09 m, limit 0.005 m"),
        (SINGLE, {"wl_sigma": 1e12}, MemoryLimitError, "a pulse of wl_sigma"),
    ],
)
def test_errors_say_what_is_wrong(capture, options, kind, message):
    with pytest.raises(kind, match=message) as caught:
        quiet(capture, VOLUMES["before"], **{"wl_mean": 0.3, **options})
    assert "\n" not in str(caught.value)


def test_transforms_refuse_what_is_no_grid():
    uneven = Volume.box((0, 0, 0.6), (0.5, 0.5, 0.1), 0.05)
    with pytest.raises(SamplingError, match="steps by 0.05 m and the wall's points by 0.166667 m"):
        quiet(SINGLE, uneven, wl_mean=0.3, method="fft")
    scattered = noise_capture(sensor_points=wall_grid(1.0, 6).reshape(-1, 3))
    with pytest.raises(SamplingError, match="are no grid"):
        quiet(scattered, uneven, wl_mean=0.3, method="fft")
    assert quiet(scattered, uneven, wl_mean=0.3).details["sum"] == "direct"
    with pytest.raises(SamplingError, match="check t_start"):
        quiet(noise_capture(t_start=30.0), uneven, wl_mean=0.3)
    with pytest.raises(SceneError, match="must be above 0"):
        quiet(SINGLE, Volume([0.0], [0.0], [0.0, 0.1]), wl_mean=0.3)


@pytest.mark.parametrize("method", ["fft", "direct"])
def test_threads_and_blocks_of_planes_change_no_bit(monkeypatch, on_threads, method):
    from nlosoptics.transient.imaging import plane_convolutions

    volume = Volume.before(1.0, 6, 0.5 + 0.05 * np.arange(12))
    single = [
        on_threads(n, lambda: quiet(EXHAUSTIVE, volume, wl_mean=0.3, method=method)) for n in (1, 2)
    ]
    assert (single[0].field == single[1].field).all()
    options = {"wl_mean": 0.3, "method": method, "tol": 1e-6}
    whole = quiet(EXHAUSTIVE, volume, **options)
    monkeypatch.setattr(plane_convolutions, "FEW", 1)
    monkeypatch.setattr(plane_convolutions, "PLANES", 2**16)
    parts = on_threads(2, lambda: quiet(EXHAUSTIVE, volume, **options))
    assert (parts.field == whole.field).all()


def test_auto_takes_the_cheaper_sum():
    assert quiet(SINGLE, Volume([0.0], [0.0], [0.5, 0.6]), wl_mean=0.3).details["sum"] == "direct"
    wide = noise_capture(sensor_points=wall_grid(1.0, 32), H=np.ones((220, 32, 32)))
    volume = Volume.before(1.0, 32, [0.5])
    assert quiet(wide, volume, wl_mean=0.3).details["sum"] == "fft"


@pytest.mark.parametrize("count", [16, 32])
def test_rendered_letter_is_upright_and_unmirrored(data, count):
    """A Z at 1 m before a wall of 2 m, rendered elsewhere."""
    light = np.load(data / "peer_transient" / f"Z_single{count}_3b.npz")["H"]
    capture = noise_capture(
        CENTRE, wall_grid(2.0, count), H=np.moveaxis(light, -1, 0), delta_t=0.01, t_start=1.8
    )
    volume = Volume.before(2.0, count, np.linspace(0.8, 1.2, 9))
    picture = quiet(capture, volume, wl_mean=0.25).projection()
    x, y = wall_grid(2.0, count)[..., 0], wall_grid(2.0, count)[..., 1]
    slope = 0.254 / 0.24  # of the stroke's edges, along x
    stroke = np.abs(x - y * slope) <= 0.096 + 1e-9
    letter = (np.abs(x) <= 0.35) & (np.abs(y) <= 0.4) & ((np.abs(y) >= 0.24) | stroke)

    def overlap(seen):
        levels = np.unique(seen)
        return max(np.sum(letter & (seen >= t)) / np.sum(letter | (seen >= t)) for t in levels)

    # the letter's corners are darker than its middle and cells are 6 to 12 cm
    assert overlap(picture) > 0.6
    assert overlap(picture[:, ::-1]) < overlap(picture) - 0.1


def test_what_does_not_fit_is_refused_before_it_is_made():
    axis = 0.1 + 1e-4 * np.arange(20000)
    with pytest.raises(MemoryLimitError, match="ask for fewer voxels or times"):
        quiet(SINGLE, Volume(axis, axis, axis), wl_mean=0.3)
