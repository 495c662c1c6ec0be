"""Fast tier: expansions against closed forms, yields against known answers, honest intervals."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest import approx
from scipy import stats

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.walls.lobe_psf import lobe_transfer, lobes_of
from nlosoptics.scene import SpecularMicrofacet
from nlosoptics.study import Results, Study, fast, fraction_within, plan_study, run_study
from nlosoptics.study.answers import controlled_fraction, interval
from nlosoptics.study.expansion import PRECISE, Expansion
from nlosoptics.study.fast import fast_values
from nlosoptics.study.fast_figures import MtfFigure, fast_figure

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "examples" / "scenes"
STOP = {"camera.f_number": 16, "camera.binning": 4}
RADIUS = {"wall.radius": {"sigma": "30 cm"}}
FOCUS = {"camera.focus_distance": {"mean": "2.6 m", "sigma": "10 cm"}}


def made(
    *figures, scene: str = "letter_concave", of=RADIUS | FOCUS, changes=STOP, **draws
) -> Study:
    given = {"count": 64, "method": "random", "tier": "fast", "check": 8, "of": of}
    tables = {
        "scene": str(SCENES / f"{scene}.toml"),
        "figures": list(figures),
        "set": changes,
        "draws": given | draws,
    }
    return Study.from_tables(tables)


def in_full(study: Study, name: str, folder: Path) -> np.ndarray:
    """The same draws, computed in full."""
    draws = {k: study.definition["draws"][k] for k in ("count", "method", "of")}
    plain = Study.from_tables(study.definition | {"draws": draws})
    return run_study(plain, folder, workers=0).values(name)


def test_a_quadratic_is_its_own_expansion() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(4, 3)), rng.normal(size=(4, 3, 3))

    def fields(place):
        z = np.array(place)
        return {"a": first @ z + np.einsum("kij,i,j->k", second, z, z), "b": np.array([[1.0]])}

    points = rng.normal(size=(5, 3))
    found = Expansion.of(fields, 3).at(points)
    exact = np.array([fields(point)["a"] for point in points])
    # second differences at a step of 1/2 amplify rounding by 16
    assert found["a"] == approx(exact, abs=1e-13)
    assert found["b"].shape == (5, 1, 1)


def test_derivatives_are_those_of_smooth_fields() -> None:
    def fields(place):
        x, y = place
        return {"a": np.array([math.exp(x / 2) * math.sin(1 + y)])}

    terms = Expansion.of(fields, 2).terms[:, 0]
    s, c = math.sin(1), math.cos(1)
    # value, d/dx, d/dy, then halves of the second derivatives, and d2/dxdy
    assert terms == approx([s, s / 2, c, s / 8, -s / 2, c / 2], abs=PRECISE)


def test_fields_with_a_kink_are_refused() -> None:
    with pytest.raises(SceneError, match=r"change by .* waves when steps are halved, limit 1e-06"):
        Expansion.of(lambda place: {"a": np.array([abs(place[0])])}, 1)


def test_the_derivative_of_a_path_is_that_along_the_fixed_ray() -> None:
    """Fermat: a wall point that moves by dz changes the path by dz times the sum of cosines."""
    study = made("strehl", of=RADIUS)
    waves = fast._Waves(study)
    seen = waves.seen((0.0,))
    figure = fast_figure("strehl", {}, [seen])
    found = Expansion.of(lambda place: figure.fields(waves.seen(place), 24), 1)
    wave, aimed = seen.first.wave, seen.first
    hits, lens = aimed.rays.points[1:], aimed.on_lens[1:]
    step = 0.01
    low, high = (
        study.base.scene({"wall.radius": f"{5 + s} m"}).wall.height(hits[:, 0], hits[:, 1])
        for s in (-step, step)
    )
    legs = [hits - seen.object_point, hits - lens]
    rise = sum(leg[:, 2] / np.linalg.norm(leg, axis=1) for leg in legs)
    explicit = 0.3 * rise * (high - low) / (2 * step) / wave.wavelength
    plane = np.stack([np.ones(wave.u.size), wave.u.ravel(), wave.v.ravel()], axis=1)

    def level(values):
        return values - plane @ np.linalg.lstsq(plane, values, rcond=None)[0]

    mine = found.terms[1][: wave.u.size]
    assert np.ptp(level(explicit)) > 0.02
    # the difference of heights has a relative error of (step/radius)^2, 4e-6
    assert level(mine) == approx(level(explicit), abs=PRECISE + 4e-6 * np.ptp(explicit))


def test_defocus_of_a_flat_wall_has_its_closed_form() -> None:
    """Strehl ratio sinc^2 of the defocus at the rim, in waves."""
    of = {"camera.focus_distance": {"from": "1.9 m", "to": "2.2 m"}}
    study = made("strehl", scene="letter_flat", changes={"camera.f_number": 8}, of=of)
    found = fast_values(study, study.figures)["strehl"]
    focus = np.array([float(d["camera.focus_distance"][:-2]) for d in study.dimensions[0].deltas])
    scene = study.base.scene({})
    line = scene.mirrored_object_point - np.array(scene.camera.position)
    depth, radius = float(line @ scene.camera.axis), scene.camera.stop_diameter / 2
    rim = radius**2 / 2 * (1 / depth - 1 / focus) / scene.laser.wavelength
    exact = np.sinc(rim) ** 2
    assert exact.min() < 0.8
    # W is expanded in the distance, not in its inverse: relative error (0.15/2.05)^2 = 0.0054 at
    # the ends, twice that of 1 minus the Strehl ratio. The object lies on the axis, and the fourth
    # order of the sphere is (radius/depth)^2 of the defocus.
    assert found == approx(exact, abs=0.011 * (1 - exact.min()))


@pytest.mark.parametrize("figure", ["strehl", "spot_rms"])
def test_errors_fall_with_the_third_power_of_the_spread(figure: str, tmp_path: Path) -> None:
    errors = []
    for i, sigma in enumerate(("60 cm", "30 cm")):
        study = made(figure, of={"wall.radius": {"sigma": sigma, "from": "3 m", "to": "7 m"}},
                     count=8, check=2)  # fmt: skip
        mine = fast_values(study, study.figures)[figure]
        exact = in_full(study, figure, tmp_path / f"{i}")
        errors.append(np.abs(mine - exact).max() / np.ptp(exact))
    # relative to the figure's own range, which changes as the first or second power
    assert errors[1] < errors[0] / 3
    assert errors[1] < 0.02


def test_modulation_has_lobes_pixels_and_aliases() -> None:
    """Against a wide window, in which the point spread lacks little energy."""
    changes = STOP | {"wall.material[1].slope_rms": "0.2 mrad"}
    study = made({"figure": "mtf", "frequency": 300.0}, changes=changes)
    seen = psf.SceneOptics(study.base.scene({})).reference
    found = psf.scene_point_spread(seen.scene, shape=65).point_spread
    missing = 1.0 - found.enclosed_energy
    assert missing < 5e-3
    for azimuth in (0.0, 0.5):
        mine = MtfFigure([seen], 300.0, azimuth)
        assert len(mine._aliases) > 5
        fields = {name: field[None] for name, field in mine.fields(seen, 16).items()}
        on_detector = float(np.hypot(*mine._frequency_of(seen)))
        exact = psf.mtf(found, on_detector, azimuth=azimuth)
        assert 0.3 < exact < 0.8
        # energy outside the window is missing at frequency 0; the error of the point spread is 1e-3
        assert mine.values(fields)[0] == approx(exact * (1.0 - missing), abs=1e-3)
        without_aliases = dict(fields)
        without_aliases["sharp"] = np.where(mine._aliases.any(axis=1), 0.0, fields["sharp"])
        assert abs(mine.values(without_aliases)[0] - exact) > 5e-3


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_lobes_have_the_transfer_of_their_slopes(distribution: str) -> None:
    scene = made("strehl").base.scene({"wall.material[1].slope_rms": "0.3 mrad"})
    lobe = SpecularMicrofacet(reflectance=0.05, slope_rms=3e-4, distribution=distribution)
    seen = psf.SceneOptics(replace(scene, wall_material=lobe)).reference
    lobes = lobes_of(seen.scene, lambda: seen.view)
    (view,) = lobes.views(seen.first.residual)
    du, dv = np.linspace(0.0, 1e-3, 7), np.linspace(0.0, -2e-3, 7)
    lag = np.hypot(*(seen.view.footprint @ np.stack([du, dv])))
    phase = seen.first.residual.wavenumber * seen.view.cos_sum * lag * 3e-4
    # heights of 1000 rad represent the slopes with a relative error of 1e-6
    assert lobe_transfer(distribution, phase) == approx(view.scattered_transfer(du, dv), abs=1e-5)
    assert phase[-1] > 1.0


def test_yield_of_a_known_limit(tmp_path: Path) -> None:
    """The share of radii above one at which the figure meets its limit, to the sampling error."""
    of = {"wall.radius": {"from": "4 m", "to": "6 m"}}
    figures = ["strehl", {"figure": "value", "address": "wall.radius"}]
    study = made(*figures, of=of, count=1024, check=16, method="sobol")
    results = run_study(study, tmp_path / "store", workers=0)
    found = fraction_within(results, "wall_radius", at_least=4.5)
    assert (found.value, found.gained, found.lost, found.checked) == (0.75, 0, 0, 16)
    # the Strehl ratio falls with the curvature here, so that a limit of one is a limit of the other
    base = {"wall.radius": "4.5 m"}
    seen = psf.SceneOptics(study.base.scene(base)).reference
    limit = psf.strehl(seen.first.wave, remove=("piston", "tilt"))
    found = fraction_within(results, "strehl", at_least=limit)
    assert found.value == approx(0.75, abs=0.005)
    assert found.low < 0.75 < found.high
    assert "disagree at 0 of 16 checked draws" in found.note


def test_results_hold_both_tiers_and_resume(tmp_path: Path, monkeypatch) -> None:
    study = made("strehl", "aberration_rms", check=6)
    plan = plan_study(study)
    assert (plan.fast_draws, plan.points, plan.waves) == (64, 6, 19)
    assert "fast draws     64, from about 19 waves" in str(plan)
    results = run_study(study, tmp_path / "store", workers=0)
    assert {k: n for k, n in results.counts.items() if n} == {"done": 6, "fast": 58}
    full = results.dataset["strehl_full"].values
    checked = np.flatnonzero(np.isfinite(full))
    assert tuple(checked) == study.in_full
    wave = results.point_spread(int(checked[0])).wavefront
    assert full[checked[0]] == psf.strehl(wave, remove=("piston", "tilt"))
    error = results.fast_errors("strehl")
    assert len(error) == 6
    assert 0.0 < np.abs(error).max() < 3e-3  # the range of the figure is 0.1
    assert "at 6 checked draws" in str(results)
    monkeypatch.setattr(fast, "fast_values", None)  # nothing is computed again
    again = run_study(study, tmp_path / "store", workers=0)
    assert again.dataset.identical(results.dataset)
    monkeypatch.undo()
    more = made("strehl", "aberration_rms", check=9, count=80)
    grown = run_study(more, tmp_path / "store", workers=0)
    assert (grown.counts["done"], grown.counts["fast"]) == (9, 71)
    # a draw farther out may need more nodes
    assert grown.values("strehl")[:64] == approx(results.values("strehl"), abs=1e-12)


def test_a_fast_study_becomes_one_in_full(tmp_path: Path) -> None:
    study = made("strehl", count=12, check=3)
    run_study(study, tmp_path / "store", workers=0)
    draws = {"count": 12, "method": "random", "of": RADIUS | FOCUS}
    plain = Study.from_tables(study.definition | {"draws": draws})
    results = run_study(plain, tmp_path / "store", workers=0)
    assert results.counts["done"] == 12
    assert "strehl_full" not in results.dataset
    with pytest.raises(SceneError, match="not of the fast tier; set draws.tier = 'fast'"):
        results.fast_errors("strehl")


def test_checks_see_what_the_expansion_cannot(tmp_path: Path) -> None:
    """Draws of a power below 0, which the scene refuses, do not change the wave."""
    of = {"laser.power": {"mean": "1 mW", "sigma": "0.8 mW"}}
    results = run_study(made("strehl", of=of, check=40), tmp_path / "store", workers=0)
    found = fraction_within(results, "strehl", at_least=0.5)
    assert found.met == 64
    assert 0 < found.failed == found.lost == results.counts["failed"]
    assert "the yield is that of the checked draws alone" in found.note
    assert found.value == 1.0 - found.failed / 40
    # a tenth of the powers is refused
    assert found.low < 1.0 - 0.106 < found.high


def test_intervals_cover_the_true_yield() -> None:
    """Over many studies, for good and poor fast tiers."""
    rng = np.random.default_rng(3)
    studies, count, check = 500, 2000, 100
    for share, gained, lost in (
        (0.8, 0.0, 0.01),
        (0.95, 0.02, 0.0),
        (0.5, 0.1, 0.05),
        (0.9, 0.0, 0.3),
    ):
        cells = np.array([share - lost, lost, gained, 1.0 - share - gained])
        covered = 0
        for _ in range(studies):
            kind = rng.choice(4, count, p=cells)
            met, passed = kind <= 1, (kind == 0) | (kind == 2)
            found = controlled_fraction(met, met[:check], passed[:check], failed=0, confidence=0.95)
            covered += found.low <= share - lost + gained <= found.high
        # 0.95, less three standard errors of a share of 500
        assert covered >= studies * (0.95 - 3 * math.sqrt(0.95 * 0.05 / studies))


def _ball(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (z**2).sum(axis=1) < 2.366  # 0.5 of three normal values


def _waves(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.sin(30.0 * z.sum(axis=1)) > 0.0  # even draws do not help


@pytest.mark.parametrize(("good", "narrow"), [(_ball, 0.5), (_waves, 1.5)])
def test_intervals_of_sobol_draws_cover_the_true_yield_and_are_narrow(good, narrow) -> None:
    """Against independent draws, for yields that an even filling helps and does not help."""
    studies, count, covered = 300, 2048, 0
    halves = []
    for seed in range(studies):
        draws = stats.qmc.Sobol(3, rng=np.random.default_rng(seed)).random(count)
        low, high = interval(good(stats.norm.ppf(draws)), 0.95, sobol=True)
        covered += low <= 0.5 <= high
        halves.append((high - low) / 2)
    assert covered >= studies * (0.95 - 3 * math.sqrt(0.95 * 0.05 / studies))
    assert np.mean(halves) < narrow * 1.96 * 0.5 / math.sqrt(count)


def test_few_sobol_draws_have_the_interval_of_independent_ones() -> None:
    good = np.arange(4096) < 79
    assert interval(good, 0.9, sobol=True) == interval(good, 0.9)
    assert interval(~good, 0.9, sobol=True) == interval(~good, 0.9)
    # all in the first run: its share differs from the others', which are 0
    low, high = interval(np.arange(4096) < 80, 0.9, sobol=True)
    share = 80 / 4096
    assert (low, high) == (0.0, approx(share + share * stats.t.ppf(0.95, 15), rel=1e-12))


@pytest.mark.parametrize(
    ("draws", "tables", "told"),
    [
        ({"tier": "full"}, {}, "draws.check = 8 goes with tier = 'fast' alone"),
        ({"check": 65}, {}, "draws.check = 65 is above draws.count = 64"),
        ({"method": "saltelli"}, {}, "saltelli does not go with tier = 'fast'"),
        ({"tier": "quick"}, {}, "tier"),
        ({"of": {"wall.radius": ["4 m", "5 m"]}}, {}, "lists values, but tier = 'fast' needs"),
        ({}, {"figures": ["photons"]}, "photons is not among those of tier = 'fast', strehl,"),
        ({}, {"axes": {"laser.power": ["1 mW"]}}, "tier = 'fast' does not go with axes; remove"),
    ],
)
def test_what_the_fast_tier_cannot_do_is_one_line(draws, tables, told: str) -> None:
    study = made("strehl")
    given = study.definition | {"draws": study.definition["draws"] | draws} | tables
    with pytest.raises(SceneError, match=told) as caught:
        Study.from_tables(given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("figure", "changes", "of", "told"),
    [
        ("strehl", {"wall.size": ["1.2 mm", "1.2 mm"]}, FOCUS, "the wall's edge cuts the cone"),
        ("strehl", {"camera.f_number": 2}, {"wall.radius": {"mean": "2 m", "sigma": "1.9 m"}},
         "tier = 'fast' needs the wave at wall.radius = "),
        ({"figure": "mtf", "frequency": 2000.0}, {}, FOCUS, "the pixels' Nyquist frequency"),
        ({"figure": "mtf", "frequency": 5.0}, {"camera.binning": 64, "camera.f_number": 2}, FOCUS,
         "frequency aliases more than 64 times"),
    ],
)  # fmt: skip
def test_waves_that_cannot_be_expanded_are_named(figure, changes, of, told: str) -> None:
    study = made(figure, changes=STOP | changes, of=of)
    with pytest.raises(SceneError, match=told) as caught:
        fast_values(study, study.figures)
    assert "\n" not in str(caught.value)


def test_a_damaged_expansion_is_computed_again(tmp_path: Path) -> None:
    study = made("strehl", count=16, check=2)
    results = run_study(study, tmp_path / "store", workers=0)
    (chunk,) = (tmp_path / "store" / "fast" / "strehl" / "c").iterdir()
    chunk.write_bytes(b"broken")
    assert Results.load(tmp_path / "store").counts["pending"] == 16
    again = run_study(study, tmp_path / "store", workers=0)
    assert again.dataset.identical(results.dataset)
