"""The search for the best focus, by criteria whose values in each plane are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.metrics import focus
from nlosoptics.psf.wave.detilted import split

WAVELENGTH, RADIUS = 500e-9, 4e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS}


@pytest.fixture(params=[0.13, -0.07], ids=["before", "behind"])
def wave(request):
    """A wave without aberration, whose image lies on either side of the pupil."""
    return psf.Wavefront.from_zernike({}, image_distance=request.param, samples=6, **SYSTEM)


def defocus(wave, radius=None):
    """Defocus of a wave's image plane at the rim, wavelengths, from that at the start."""
    r = focus._radius(wave) if radius is None else radius
    start = wave.image_distance
    return lambda one: (1 / one.image_distance - 1 / start) * r**2 / 2 / WAVELENGTH


def shift_of(wave, waves):
    r, d = focus._radius(wave), wave.image_distance
    return 1 / (1 / d + 2 * waves * WAVELENGTH / r**2) - d


def between(wave, low, high):
    """Limits of a search from one defocus to another, the largest shift last."""
    return tuple(sorted(shift_of(wave, waves) for waves in (low, high)))


def bumps(wave, *peaks, width=0.4):
    """A sum of bumps (height, place in waves), and the places at which it was asked for."""
    at, seen = defocus(wave), []

    def criterion(one):
        seen.append(at(one))
        return sum(h * math.exp(-(((seen[-1] - t) / width) ** 2)) for h, t in peaks)

    return criterion, seen


def test_radius_is_that_of_the_farthest_lit_node():
    u = np.array([[-1.0, 2.0, 0.5, 7.0]]) * 1e-3
    v = np.array([[0.3, -1.0, 2.0, 7.0]]) * 1e-3
    amplitude, weights = np.array([[1.0, 0.5, 2.0, 0.0]]), np.array([[3e-6, 2e-6, 1e-6, 1e-6]])
    one = psf.Wavefront(
        u=u[0],
        v=v[0],
        aberration=0 * u[0],
        amplitude=amplitude[0],
        weights=weights[0],
        image_distance=0.1,
        layout="scattered",
        **SYSTEM | {"pupil_radius": 1e-2},
    )
    share = (amplitude * weights)[0] / (amplitude * weights).sum()
    away = np.hypot(u[0] - share @ u[0], v[0] - share @ v[0])[:3]
    assert focus._radius(one) == approx(away.max(), rel=1e-12)


def test_search_visits_an_even_scan(wave):
    """Four planes for each wave of defocus, both ends, and then a refinement of one peak."""
    criterion, seen = bumps(wave, (1.0, 1.7))
    found = psf.best_focus(wave, criterion=criterion, limits=between(wave, -3.0, 6.1))
    assert found == approx(shift_of(wave, 1.7), rel=1e-5)
    count = math.ceil(4 * 9.1) + 1
    assert seen[:count] == approx(np.linspace(-3.0, 6.1, count), abs=1e-6)
    assert len(seen) > count
    step = 9.1 / (count - 1)
    assert max(abs(t - 1.7) for t in seen[count:]) < 1.6 * step
    criterion, seen = bumps(wave, (1.0, 0.1))
    assert psf.best_focus(wave, criterion=criterion, limits=between(wave, -1.0, 1.5)) == approx(
        shift_of(wave, 0.1), abs=1e-5 * abs(shift_of(wave, 1.0))
    )
    assert seen[:17] == approx(np.linspace(-1.0, 1.5, 17), abs=1e-6)  # the fewest planes


@pytest.mark.parametrize(("lack", "refused"), [(0.9e-4, True), (1.1e-4, False)])
def test_two_peaks_that_differ_by_a_ten_thousandth(wave, lack, refused):
    limits = between(wave, -3.0, 4.0)
    for peaks in (((1.0, -1.0), (1 - lack, 2.0)), ((1 - lack, -1.0), (1.0, 2.0))):
        criterion, _ = bumps(wave, *peaks)
        best = max(peaks)[1]
        if not refused:
            found = psf.best_focus(wave, criterion=criterion, limits=limits)
            assert found == approx(shift_of(wave, best), rel=1e-4)
            continue
        with pytest.raises(SamplingError, match="criterion has two best foci, at shift = ") as told:
            psf.best_focus(wave, criterion=criterion, limits=limits)
        both = [f"{shift_of(wave, t):.4g} m" for t in (best, 1.0 - best)]
        assert f"at shift = {both[0]} and {both[1]}, which differ by less than 0.0001" in str(
            told.value
        )


def test_peaks_that_the_scan_underrates(wave):
    """Between two planes of the scan the higher peak may look lower by a fifth, and no more."""
    limits = between(wave, -4.0 + 1e-7, 4.0)  # 33 planes, a quarter of a wave apart
    for part, taken in ((0.17, True), (0.23, False)):
        width = 0.125 / math.sqrt(-math.log(1 - part))  # what is left halfway between planes
        at = defocus(wave)

        def criterion(one, width=width, at=at):
            t = at(one)
            sharp = 1.001 * math.exp(-(((t - 2.125) / width) ** 2))
            return max(math.exp(-(((t + 1.0) / 0.6) ** 2)), sharp)

        found = psf.best_focus(wave, criterion=criterion, limits=limits)
        assert found == approx(shift_of(wave, 2.125 if taken else -1.0), rel=1e-4)


@pytest.mark.parametrize(("part", "refused"), [(0.9e-4, True), (1.1e-4, False)])
def test_criteria_that_hardly_change(wave, part, refused):
    at = defocus(wave)
    limits = between(wave, -2.0, 2.0)

    def criterion(one):
        return 3.0 * (1 - part * (at(one) / 2.0) ** 2)

    if not refused:
        assert abs(psf.best_focus(wave, criterion=criterion, limits=limits)) < 1e-6
        return
    ends = " m to ".join(f"{s:.3g}" for s in (shift_of(wave, 2.0), shift_of(wave, -2.0)))
    with pytest.raises(SamplingError, match=f"0.0001 of its value from shift = {ends} m, so that"):
        psf.best_focus(wave, criterion=criterion, limits=limits)


@pytest.mark.parametrize("side", [-1, 1])
def test_criteria_that_are_best_at_an_end(wave, side):
    at = defocus(wave)
    ends = " m to ".join(f"{s:.3g}" for s in (shift_of(wave, 2.0), shift_of(wave, -2.0)))
    message = f"<lambda> is best at the edge of the search from shift = {ends} m; give wider"
    with pytest.raises(SamplingError, match=message):
        psf.best_focus(wave, criterion=lambda one: side * at(one), limits=between(wave, -2.0, 2.0))


def planes_of(wave, waves, **options):
    """Number of planes that a search over so many waves of defocus is refused for."""
    with pytest.raises(SamplingError, match="takes [0-9]+ image planes") as told:
        psf.best_focus(wave, limits=between(wave, -waves / 3, 2 * waves / 3), **options)
    text = str(told.value)
    ends = [shift_of(wave, part * waves) for part in (2 / 3, -1 / 3)]
    assert f"from shift = {ends[0]:.3g} m to {ends[1]:.3g} m, limit 512; give narrower" in text
    return int(text.split("takes ")[1].split()[0])


def test_planes_are_limited(wave):
    """At most 512: four for each wave, fewer for an MTF, whose fringes are wider, and 17."""
    assert planes_of(wave, 127.9) == 513
    assert planes_of(wave, 127.9, criterion=lambda one: 1.0) == 513
    wide = psf.Wavefront.from_zernike(
        {}, image_distance=wave.image_distance, **SYSTEM | {"pupil_radius": 0.03}, samples=6
    )
    cutoff = 2 * focus._radius(wide) / (WAVELENGTH * abs(wave.image_distance))
    for share, waves, periods in (
        (0.3, 120.3, 8 * 0.3 * 0.7),
        (0.06, 400.7, 8 * 0.06 * 0.94),
        (0.5, 90.2, 2.0),
        (0.8, 90.2, 2.0),
        (0.002, 1500.3, 0.1),
    ):
        found = planes_of(wide, waves, criterion="mtf", frequency=share * cutoff)
        assert found == math.ceil(4 * periods * waves) + 1
    criterion, seen = bumps(wave, (1.0, 1.7))
    psf.best_focus(wave, criterion=criterion, limits=between(wave, -42.5, 85.2))
    assert np.argmax(np.array(seen) > 85.19) + 1 == 512


@pytest.mark.parametrize("waves", [0.3, -1.4])
def test_default_search(wave, waves):
    """About the least rms, by the steepest slope of the rest and two waves, from d/8 to 8 d."""
    r, d = RADIUS, wave.image_distance

    def path(u, v):
        x, y = u / r, v / r
        return WAVELENGTH * (waves * (x * x + y * y) + 0.8 * x**3 - 0.3 * y + 0.1)

    bent = psf.Wavefront.from_function(path, image_distance=d, samples=20, **SYSTEM)
    radius = focus._radius(bent)
    assert radius < r
    basis = np.stack([np.ones_like(bent.u), bent.u, bent.v, bent.u**2 + bent.v**2], axis=-1)
    root = np.sqrt(bent.amplitude * bent.weights)
    scale = np.abs(basis).max(axis=(0, 1))
    fit = np.linalg.lstsq(
        (basis / scale * root[..., None]).reshape(-1, 4),
        (bent.aberration * root).ravel(),
        rcond=None,
    )[0]
    rest = replace(bent, aberration=bent.aberration - basis @ (fit / scale))
    slope = split(rest).rays.slope
    middle = -fit[3] / scale[3] * radius**2
    low, high = focus._search_range(bent, radius)
    half = radius * slope + 2 * WAVELENGTH
    assert middle == approx(-waves * WAVELENGTH * (radius / r) ** 2, rel=1e-3)
    assert (low, high) == approx((middle - half, middle + half), rel=1e-6)
    weak = replace(bent, image_distance=math.copysign(8.0, d))
    low, high = focus._search_range(weak, radius)
    best = 1 / (1 / weak.image_distance + 2 * middle / radius**2)
    for end, distance in (
        (low, best * (8 if d > 0 else 1 / 8)),
        (high, best / (8 if d > 0 else 1 / 8)),
    ):
        edge = (1 / distance - 1 / weak.image_distance) * radius**2 / 2
        inner = middle - half if end == low else middle + half
        assert end == approx(max(edge, inner) if end == low else min(edge, inner), rel=1e-6)


def test_waves_without_a_focus_on_their_side():
    d = 2.0
    for waves, focused in ((2.0, True), (16.5, False)):
        # a vergence of 1 - 2 W d/a^2 from the defocus W at the rim
        coefficient = waves * WAVELENGTH / (2 * math.sqrt(3))
        bent = psf.Wavefront.from_zernike({4: coefficient}, image_distance=d, **SYSTEM)
        if focused:
            assert abs(psf.best_focus(bent, criterion="rms")) > 0.1
            continue
        with pytest.raises(SceneError, match="leaves no focus on the side of .* at 2 m; give"):
            psf.best_focus(bent, criterion="rms")


@pytest.mark.parametrize(("jump", "refused"), [(0.495, False), (0.505, True)])
def test_neighbours_half_a_wave_apart(jump, refused):
    """Nodes of a grid alias a tilt beyond half a wave from one to the next."""
    flat = psf.Wavefront.from_zernike({}, image_distance=0.1, nodes="grid", samples=40, **SYSTEM)
    # a defocus of this largest step between neighbours; tilt does not count
    bent = replace(flat, aberration=(flat.u**2 + flat.v**2))
    largest = split(bent).grid_jump()[0]
    bent = replace(bent, aberration=bent.aberration * jump / largest)
    if not refused:
        assert focus._strehl(bent) == approx(psf.strehl(bent, remove=("tilt",)))
        return
    message = r"jumps 0\.5[01] waves between neighbours in the image plane at 0\.1 m, limit 0\.50"
    with pytest.raises(SamplingError, match=message):
        focus._strehl(bent)


def test_through_focus_holds_what_it_was_given(wave):
    shifts = np.array([2e-4, -3e-4, 1e-4])
    at = defocus(wave)

    def score(one):
        return 7.0 + at(one)

    found = psf.through_focus(wave, shifts, criterion=score)
    r, d = focus._radius(wave), wave.image_distance
    known = 7 + (1 / (d + shifts) - 1 / d) * r**2 / 2 / WAVELENGTH
    assert found.values == approx(known, rel=1e-12)
    assert np.array_equal(found.shifts, shifts)
    assert (found.criterion, found.wavelength, found.f_number) == ("score", 5e-7, wave.f_number)
    assert found.best == int(np.argmax(known))
    rms = psf.through_focus(wave, shifts, criterion="rms")
    assert rms.best == 2
    assert psf.through_focus(wave, shifts).best == 2
    for array in (found.shifts, found.values):
        assert not array.flags.writeable
    rows = dict(found._figures()[1])
    assert rows["criterion"] == "score"
    assert rows["planes"] == "3, -0.3 to 0.2 mm"
    assert rows["best plane"] == f"{1e3 * shifts[found.best]:.4g} mm, {known.max():.4g}"
    assert rows["F-number"] == f"{wave.f_number:.4g}"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"azimuth": 0.1}, "frequency = None, azimuth = 0.1 without criterion='mtf'"),
        ({"frequency": 3e3}, r"frequency = 3000.0, azimuth = 0.0 without criterion='mtf'"),
        ({"criterion": "mtf", "frequency": -1.0}, "frequency = -1 1/m"),
        ({"criterion": "mtf", "frequency": 1e3, "azimuth": math.inf}, "azimuth = inf"),
        ({"criterion": lambda one: math.nan}, r"criterion\(wavefront\) = nan"),
        ({"criterion": "sharp"}, "criterion = 'sharp' is unknown"),
    ],
)
def test_criteria_that_are_none(wave, options, message):
    with pytest.raises(SceneError, match=message):
        psf.through_focus(wave, [0.0], **options)
    for shifts in ([], [[0.0]], 0.0):
        with pytest.raises(SceneError, match="shifts have shape"):
            psf.through_focus(wave, shifts)


def test_limits_that_are_none(wave):
    d = wave.image_distance
    toward = math.copysign(1.0, d)
    for limits in ((1e-3, 1e-3), (1e-3, -1e-3), tuple(sorted((-d, toward * 1e-3)))):
        with pytest.raises(SceneError, match="must increase and keep the image plane at"):
            psf.best_focus(wave, limits=limits)
    for limits in (1e-3, (1e-3,), (1e-3, 2e-3, 3e-3), ("a", "b")):
        with pytest.raises(SceneError, match="limits"):
            psf.best_focus(wave, limits=limits)


@pytest.mark.parametrize("layout", ["grid", "scattered", "ring"])
def test_mtf_of_any_pupil_is_that_of_its_image(layout):
    """For one shape of the pupil each: by a transform of the layout's own kind."""
    options = {"grid": {"nodes": "grid", "samples": 64}, "ring": {"obscuration": 0.3}}
    wave = psf.Wavefront.from_zernike(
        {4: 6e-8, 7: 5e-8},
        image_distance=0.1,
        **options.get(layout, {"nodes": "grid", "samples": 64}),
        **SYSTEM,
    )
    if layout == "scattered":
        lit = wave.weights > 0
        wave = replace(
            wave,
            layout="scattered",
            **{n: getattr(wave, n)[lit] for n in ("u", "v", "aberration", "amplitude", "weights")},
        )
    cutoff = 2 * RADIUS / (WAVELENGTH * 0.1)
    whole = psf.Wavefront.from_zernike(
        {4: 6e-8, 7: 5e-8},
        image_distance=0.1,
        obscuration=0.3 if layout == "ring" else 0.0,
        **SYSTEM,
    )
    for share, azimuth in ((0.2, 0.4), (0.5, -1.1)):
        found = focus._mtf(wave, share * cutoff, azimuth)
        # light outside the window, and squares at the rim
        assert found == approx(psf.mtf(whole, share * cutoff, azimuth=azimuth), abs=1.5e-2)
