"""The speed of the machine is measured once and stored."""

from __future__ import annotations

import json

import pytest
from pytest import approx

import nlosoptics as nlos
from nlosoptics import _cost_model


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """A folder that holds no measurement yet."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    _cost_model.factors.cache_clear()
    yield tmp_path / "cache"
    _cost_model.factors.cache_clear()


def probed(monkeypatch, seconds):
    """Let every probe take so many times what it took on the machine of the fits."""
    calls = []

    def least(probe):
        calls.append(probe)
        return seconds * _cost_model.REFERENCE[list(_cost_model.REFERENCE)[len(calls) - 1]]

    monkeypatch.setattr(_cost_model, "_least", least)
    return calls


def test_a_machine_is_measured_once_and_kept_beside_the_kernels(fresh, monkeypatch):
    calls = probed(monkeypatch, 2.0)
    assert _cost_model.seconds(calls=1.0, arrays=2.0, transforms=3.0) == approx(12.0)
    assert _cost_model.kept_at().parent == fresh
    assert set(json.loads(_cost_model.kept_at().read_text())) == set(_cost_model.REFERENCE)
    _cost_model.factors.cache_clear()
    assert _cost_model.seconds(calls=1.0) == approx(2.0)
    assert len(calls) == 3


def test_a_broken_file_is_measured_anew(fresh, monkeypatch):
    fresh.mkdir()
    _cost_model.kept_at().write_text('{"calls": "fast"')
    probed(monkeypatch, 3.0)
    assert _cost_model.seconds(arrays=1.0) == approx(3.0)
    assert json.loads(_cost_model.kept_at().read_text())["arrays"] == approx(3.0)


def test_an_absurd_measurement_is_not_believed(fresh, monkeypatch):
    probed(monkeypatch, 1e4)
    assert _cost_model.seconds(calls=1.0) == _cost_model.BELIEVED[1]


def test_without_a_place_the_constants_stand(fresh, monkeypatch):
    fresh.parent.joinpath("file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(fresh.parent / "file" / "below"))
    probed(monkeypatch, 2.0)
    assert _cost_model.seconds(calls=1.0, arrays=1.0, transforms=1.0) == 3.0


def test_the_probes_take_some_milliseconds(fresh):
    # the machine's speed may differ by the factor that is believed, not the work asked of it
    for name, probe in _cost_model._probes().items():
        low, high = (_cost_model.REFERENCE[name] * f for f in (0.02, 50.0))
        assert low < _cost_model._least(probe) < high


def test_predictions_scale_with_the_machine_and_transforms_do_not_change(
    flat_scene, fresh, monkeypatch
):
    probed(monkeypatch, 1.0)
    here = nlos.plan(flat_scene)
    _cost_model.factors.cache_clear()
    _cost_model.kept_at().unlink()
    probed(monkeypatch, 4.0)
    slow = nlos.plan(flat_scene)
    assert 3.5 < slow.seconds / here.seconds <= 4.0  # but for the mesh's and the pupil's constants
    assert [s.name for s in slow.stages] == [s.name for s in here.stages]
