"""The search's way through its steps, with a free energy that is a plain distance."""

from __future__ import annotations

import copy
import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import inverse
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.inverse.blind.evidence_search import Search
from nlosoptics.inverse.blind.free_energy import OutOfTime, Starts

MODES = tuple(range(4, 12))
TRUTH = np.array([0.3, -0.2, 0.15, 0.1, -0.25, 0.05, 0.2, -0.1])


class Valley:
    """Free energy 1000 |c - truth|^2, which a descent of a free wall takes half way.

    A mode beyond the given ones lowers it by ``gain``, a call by ``drop``.
    """

    known = False

    def __init__(self, padding, modes, log, gain=0.0, drop=0.0):
        self.padding, self.modes, self.log, self.gain = padding, modes, log, gain
        self.size, self.drop = len(modes), drop
        self.twin = -np.ones(self.size)
        self.truth = np.pad(TRUTH, (0, self.size - len(TRUTH)))

    def made(self, walls, radius):
        count, square = len(walls), ((walls - self.truth) ** 2).sum(axis=1)
        lower = self.gain * (self.size - len(MODES)) + self.drop * len(self.log)
        return Starts(
            coefficients=walls,
            free=np.zeros((count, 2, 3)),
            gains=np.ones((count, 1)),
            variances=np.ones((count, 2)),
            energy=1000.0 * square - lower,
            chi_square=square[:, None] + 4.0,
            radius=radius,
        )

    def starts(self, walls, noise, radius=np.inf):
        self.log.append(("starts", self.padding, len(walls), noise, walls.copy()))
        return self.made(np.array(walls, dtype=float), np.full(len(walls), radius))

    def descend(self, starts, stage):
        self.log.append(("descend", self.padding, len(starts), stage))
        share = np.where(np.isinf(starts.radius), 0.5, 0.0)[:, None]
        walls = starts.coefficients + share * (self.truth - starts.coefficients)
        return self.made(walls, starts.radius)

    def about(self, first, error):
        return SimpleNamespace(
            starts=self.starts,
            descend=self.descend,
            held=lambda walls: ((walls - first) ** 2).sum(axis=1) / (2 * error**2),
        )

    def apart(self, starts, walls):
        return np.linalg.norm(starts.coefficients - walls, axis=1)

    def objects(self, starts):
        return starts.coefficients[:, :8].reshape(-1, 2, 4)

    def sharpness(self, walls):
        return 1.0 / (1e-9 + np.linalg.norm(walls, axis=1))


def searched(several, faults=("faulty",), **options):
    """The texts of a search, its calls of the energy, and the search itself."""
    log, told = [], []
    gain, drop = options.pop("gain", 0.0), options.pop("drop", 0.0)
    left = iter(faults) if isinstance(faults, list) else None
    verdict = SimpleNamespace(
        several=several,
        modes=MODES,
        pixels=1000,
        faults=lambda *_, **__: next(left) if left else faults,
        well=options.pop("well", lambda pool: False),
        structured=options.pop("structured", lambda best: False),
        alone=options.pop("alone", lambda rival: False),
        vague=options.pop("vague", False),
        doubts=options.pop("doubts", lambda modes, met: ()),
    )
    usual = {"first": np.zeros(8), "start_error": None, "strength": None, "proposals": None}
    usual |= {"rounds": None, "seed": 3, "state": None}
    found = Search(
        lambda padding, modes: Valley(padding, modes, log, gain, drop), verdict, **usual | options
    )
    found.run(lambda text, done: told.append((text, done)) or False)
    return found, told, log


def sizes(log, name="descend"):
    return [entry[2] for entry in log if entry[0] == name]


def test_several_images_take_two_rounds_of_random_walls():
    found, told, log = searched(True)
    one = ["random walls", "best walls", "near the best walls"]
    near = [text for text, _ in told].count("near the best walls")
    texts = [text for text, _ in told if text != "near the best walls"]
    assert texts == ["no blur", *["random walls", "best walls", "best walls", "more modes"] * 2]
    assert 2 <= near <= 10
    assert one == [text for text, _ in told][1:4]
    starts = [entry for entry in log if entry[0] == "starts"]
    gathered = [entry for entry in starts if entry[2] == 32]
    assert [entry[3] for entry in gathered] == [30.0, 60.0]
    for entry, factor in zip(gathered, (1.0, 1.3), strict=True):
        lengths = np.linalg.norm(entry[4], axis=1)
        assert lengths == approx(factor * np.resize([0.3, 0.6, 1.0], 32))
    assert {entry[2] for entry in starts} == {1, 12, 32}  # an empty one, children, random walls
    assert {*sizes(log)} == {32, 8, 12, 2}
    assert {entry[1] for entry in log} == {1.5}
    assert found.place.turn == 2
    assert found.place.rival != found.place.rival  # NaN: none is searched for


def test_noise_that_hides_residuals_makes_rounds_meet_at_one_object(monkeypatch):
    """The rounds meet at once here. More modes wait until then, or for the last of four rounds."""
    met = []

    def doubts(modes, count):
        met.append(count)
        return () if count >= 2 else ("once",)

    found, told, log = searched(True, (), vague=True, doubts=doubts)
    texts = [text for text, _ in told if text != "near the best walls"]
    one = ["random walls", "best walls", "best walls"]
    assert texts == ["no blur", *one, *one, "more modes"]
    assert set(met) == {1, 2}
    assert found.place.met == 2
    assert {entry[3] for entry in log if entry[0] == "starts" and entry[2] == 32} == {12.0}
    noise = np.random.default_rng(1)
    monkeypatch.setattr(Valley, "objects", lambda self, starts: noise.normal(size=(1, 16, 16)))
    found, told, _ = searched(True, (), vague=True, doubts=doubts)
    texts = [text for text, _ in told if text != "near the best walls"]
    assert texts == ["no blur", *one * 4, "more modes"]
    assert found.place.met == 1
    # rounds with a known object agree if their walls do
    monkeypatch.setattr(Valley, "known", True)
    assert searched(True, (), vague=True, doubts=doubts)[0].place.met == 2
    monkeypatch.setattr(Valley, "apart", lambda self, starts, walls: np.ones(len(starts)))
    assert searched(True, (), vague=True, doubts=doubts)[0].place.met == 1
    # a start with a known error is not searched for
    found, told, _ = searched(True, (), vague=True, doubts=doubts, start_error=0.1)
    assert "random walls" not in [text for text, _ in told]


def test_noise_that_hides_residuals_gives_no_shortcut():
    """More generations than usual, and no end at a small residual."""
    for vague, count in ((False, 4), (True, 12)):
        _, _, log = searched(True, rounds=1, drop=100.0, vague=vague)
        assert sizes(log, "starts").count(12) == count
    _, _, log = searched(True, (), rounds=1, well=lambda pool: True, vague=True)
    assert 12 in sizes(log, "starts")


def test_fractions_grow_from_nothing_by_round_and_step():
    _, told, _ = searched(True)
    done = [share for _, share in told]
    assert all(a < b for a, b in pairwise(done))
    assert done[0] == 0.0
    # of 2.1 rounds, the tenth of one before the first: gathering is the fourth of ten steps
    assert done[1] == approx((0.1 + 0.3) / 2.1)
    assert done[2] == approx((0.1 + 0.4) / 2.1)
    last = [share for text, share in told if text == "random walls"][-1]
    assert last == approx((1.1 + 0.3) / 2.1)
    assert done[-1] == approx((1.1 + 0.7) / 2.1)


@pytest.mark.parametrize(
    ("several", "faults", "rounds"),
    [(True, (), 1), (False, (), 0), (False, [("x",), ()], 1), (False, [("x",), ("x",), ()], 2)],
)
def test_a_search_ends_with_the_first_answer_without_faults(several, faults, rounds):
    """For one image, the fit without blur is one."""
    found, told, _ = searched(several, faults)
    assert [text for text, _ in told].count("random walls") == rounds
    assert found.place.step == "end"


@pytest.mark.parametrize(("alone", "rounds"), [(True, 2), (False, 5)])
def test_one_image_ends_after_two_rounds_without_another_wall(alone, rounds):
    found, told, log = searched(False, alone=lambda rival: alone)
    assert [text for text, _ in told].count("random walls") == rounds
    noises = [entry[3] for entry in log if entry[0] == "starts" and entry[2] == 32]
    assert noises == [30.0, 10.0, 60.0, 20.0, 30.0][:rounds]
    # random walls are fitted on the narrow grid, and answers on the wide one
    assert {entry[1] for entry in log if entry[2] in (32, 20, 24)} == {1.125}
    assert {entry[1] for entry in log if entry[2] == 2} >= {1.5}
    assert {*sizes(log)} >= {32, 20, 24, 4, 1, 2}
    assert found.place.best.energy[0] < 1.0


def test_rounds_may_be_told():
    found, told, _ = searched(True, rounds=3)
    assert [text for text, _ in told].count("random walls") == 3
    assert max(share for _, share in told) < 1.0
    assert found.place.turn == 3


def test_history_holds_the_best_energy_after_each_offer():
    found, *_ = searched(False)
    history = found.place.history
    count = len(history["objective"])
    assert count == 6
    energies = [math.inf, *history["objective"]]
    assert all(a >= b for a, b in pairwise(energies))
    assert history["change"][0] == 1.0
    for k in range(1, count):
        drop = energies[k] - energies[k + 1]
        assert history["change"][k] == approx(drop / max(abs(energies[k + 1]), 1.0))
    best = found.place.best
    assert history["residual"][-1] == approx(math.sqrt(best.chi_square.mean()))
    assert history["objective"][-1] == best.energy[0]


def test_margins_are_those_to_the_fits_without_blur():
    found, *_ = searched(False, ())
    energy = found.place.best.energy[0]
    assert found.margins == (energy - found.place.floor, energy - found.place.sharp)
    # the fit that stays sharp keeps its small wall; the other goes half way many times
    assert found.place.sharp == approx(1000 * ((TRUTH**2).sum()), rel=0.05)
    assert 0.0 < found.place.floor < 0.01 * found.place.sharp


def test_before_an_answer_there_is_a_wall_without_blur():
    found = searched(True, rounds=1)[0]
    found.place.best = found.place.best[:0]
    assert all(math.isnan(margin) for margin in found.margins)
    assert not found.best().coefficients.any()
    assert len(found.best()) == 1
    found.finished()
    assert len(found.place.best) == 1
    before = found.place.best
    found.finished()
    assert found.place.best is before


def test_a_start_of_known_error_is_fitted_alone():
    first, error = TRUTH + 0.02, 0.1
    found, told, log = searched(False, first=first, start_error=error)
    assert [text for text, _ in told] == ["no blur", *["about the given wall"] * 3]
    walls = next(entry[4] for entry in log if entry[0] == "starts" and entry[2] == 4)
    assert walls[0] == approx(first)
    assert np.linalg.norm(walls[1:] - first, axis=1) == approx([error] * 3)
    assert sizes(log) == [1, 1, 4, 4, 1]
    flat = [entry for entry in log if entry[0] == "starts" and entry[2] == 1][-1]
    assert not flat[4].any()
    # without blur, two descents go three quarters of the way to the truth
    left = 0.25 * TRUTH
    assert found.place.floor == approx(1000 * (left**2).sum())
    away = 0.75 * TRUTH - first
    assert found.place.held == approx((away**2).sum() / (2 * error**2))
    assert found.place.step == "end"


def test_several_images_about_a_start_may_need_more_modes():
    found, told, _ = searched(True, (), first=TRUTH + 0.02, start_error=0.1)
    assert [text for text, _ in told][-1] == "more modes"
    assert found.place.step == "end"


@pytest.mark.parametrize(("several", "kept"), [(True, 2), (False, 1)])
def test_a_start_of_unknown_error_is_one_more(several, kept):
    found, told, log = searched(several, first=TRUTH + 0.2, rounds=1)
    texts = [text for text, _ in told]
    assert texts[:2] == ["no blur", "about the given wall"]
    assert "random walls" in texts
    given = [entry for entry in log if entry[0] == "starts" and entry[2] == 1 and entry[4].any()]
    assert any(entry[4][0] == approx(TRUTH + 0.2) for entry in given)
    assert len(found.place.history["objective"]) >= kept


@pytest.mark.parametrize(("gain", "kept"), [(0.0, 8), (3.4, 8), (3.5, 42)])
def test_modes_are_added_if_each_pays_for_itself(gain, kept):
    """Complete orders up to Noll's 21, 36 and 45; half the logarithm of 1000 data is 3.45."""
    found, told, _ = searched(True, (), structured=lambda best: True, gain=gain)
    assert len(found.place.modes) == kept
    assert found.place.modes == tuple(range(4, 4 + kept))
    assert [text for text, _ in told].count("more modes") == 4
    assert found.energy().modes == found.place.modes


def test_a_well_fitted_pool_needs_no_children():
    _, told, log = searched(True, (), well=lambda pool: True)
    assert [text for text, _ in told].count("near the best walls") == 1
    assert 12 not in sizes(log, "starts")


def test_generations_go_on_while_they_lower_the_energy_and_are_counted():
    """There are at most four of several images, and twelve of one."""
    for several, most in ((True, 4), (False, 12)):
        for drop, count in ((100.0, most), (-100.0, 1)):
            found, told, log = searched(several, rounds=1, drop=drop)
            assert sizes(log, "starts").count(12 if several else 24) == count
            near = [text for text, _ in told].count("near the best walls")
            assert near == count + (count == most)
            assert found.place.step == "end"


def test_known_strengths_scale_the_random_walls():
    for several in (True, False):
        _, _, log = searched(several, strength=0.2, rounds=1)
        walls = next(entry[4] for entry in log if entry[0] == "starts" and entry[2] == 32)
        lengths = np.linalg.norm(walls, axis=1) / 0.2
        if several:
            assert lengths == approx(np.resize([0.9, 1.1, 1.4], 32))
        else:
            assert 0.9 <= lengths.min() < 1.0
            assert 1.3 < lengths.max() <= 1.5


def test_a_stopped_search_is_resumed_where_it_was():
    whole, told, _ = searched(False, rounds=2)
    for stop in (1, 3, 4, 6):
        log, texts = [], []
        one, *_ = searched(False, rounds=1)
        usual = {"first": np.zeros(8), "start_error": None, "strength": None, "proposals": None}
        usual |= {"rounds": 2, "seed": 3}

        def energies(padding, modes, log=log):
            return Valley(padding, modes, log)

        first = Search(energies, one._verdict, **usual, state=None)
        first.run(lambda text, done, t=texts, n=stop: t.append(text) or len(t) > n)
        saved = {name: np.array(values) for name, values in first.place.saved().items()}
        again = Search(energies, one._verdict, **usual, state=saved)
        again.run(lambda text, done, t=texts: t.append(text) or False)
        del texts[stop]  # the step at which it was stopped
        assert texts == [text for text, _ in told]
        assert again.place.best.energy == approx(whole.place.best.energy)
        for name, values in whole.place.history.items():
            assert again.place.history[name] == approx(values)
        assert again.margins == approx(whole.margins)
        assert again.place.rival == approx(whole.place.rival, nan_ok=True)
        assert again.place.modes == MODES


@pytest.mark.parametrize("calls", range(0, 25, 2))
def test_a_step_without_time_leaves_the_search_as_it_was(calls):
    """Also a step that has offered an answer before its time is over."""

    class Late(Valley):
        def descend(self, starts, stage):
            if len(sizes(self.log)) == calls:
                raise OutOfTime
            return super().descend(starts, stage)

    log, seen = [], []
    usual = {"first": np.zeros(8), "start_error": None, "strength": None, "proposals": None}
    usual |= {"rounds": 2, "seed": 3, "state": None}
    verdict = searched(False, rounds=1)[0]._verdict
    found = Search(lambda padding, modes: Late(padding, modes, log), verdict, **usual)
    found.run(lambda text, done: seen.append(copy.deepcopy(found.place.saved())))
    assert len(sizes(log)) == calls
    for name, values in found.place.saved().items():
        np.testing.assert_array_equal(values, seen[-1][name])


def test_a_state_of_other_images_or_of_none_is_named():
    found = searched(True, rounds=1)[0]
    saved = {name: np.array(values) for name, values in found.place.saved().items()}
    like = found.best()
    for name in ("place", "modes", "history_change", "best_free", "pool_energy"):
        rest = {key: values for key, values in saved.items() if key != name}
        with pytest.raises(SceneError, match=f"start holds no {name}; give a state of"):
            found.place.of(rest, like, 8)
    for name, shape in (("pool_free", (12, 3, 3)), ("best_coefficients", (1, 9))):
        words = name.split("_")[1]
        with pytest.raises(SamplingError, match=rf"start's {words} have shape .*, this fit's"):
            found.place.of(saved | {name: np.zeros(shape)}, like, 8)
    with pytest.raises(SamplingError, match=r"start's place has shape \(7,\), must be \(8,\)"):
        found.place.of(saved | {"place": np.zeros(7)}, like, 8)


def test_a_fit_that_is_ended_at_once_has_an_answer():
    """Of the given wall, with an object for it."""
    optics = {"wavelength": 6e-7, "pupil_radius": 9e-4, "image_distance": 0.05, "pitch": 9e-6}
    pupil = inverse.PupilPSF.from_zernike((4, 5), shape=16, pixel_integrated=True, **optics)
    blob = np.exp(-(np.hypot(*np.mgrid[-8:8, -7:9]) ** 2) / 9.0)
    noise = 0.01 * np.random.default_rng(1).normal(size=(2, 16, 16))

    def progress(text, done):
        raise inverse.Stop

    found = inverse.evidence_fit(
        inverse.Measurement(blob + noise, noise_sigma=0.01),
        pupil,
        defocus=[0.0, 3e-7],
        progress=progress,
    )
    assert found.status == "unconverged"
    assert found.reasons == ("the progress callback ended the search; resume it",)
    assert [len(values) for values in found.history.values()] == [1, 1, 1]
    assert found.object.max() == 1.0
    assert 0.0 < found.score < math.inf
