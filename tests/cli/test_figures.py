"""Figures drawn by two processes."""

from __future__ import annotations

import os
import time

import pytest

from nlosoptics.cli import figures


def drawn_by(tmp_path, monkeypatch, here, beside):
    """Draw fake figures, which write the process that drew them; return what the files hold."""

    def draw(jobs, folder):
        for name, job in jobs.items():
            job()
            (folder / name).write_text(str(os.getpid()))

    monkeypatch.setattr(figures, "_draw", draw)
    figures._draw_both(here, beside, tmp_path)
    return {path.name: int(path.read_text()) for path in tmp_path.iterdir()}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_half_of_the_figures_are_drawn_beside(tmp_path, monkeypatch):
    monkeypatch.setattr(figures.os, "cpu_count", lambda: 2)
    found = drawn_by(tmp_path, monkeypatch, {"a": lambda: 0}, {"b": lambda: 0})
    assert found["a"] == os.getpid() != found["b"]


def test_one_core_draws_all(tmp_path, monkeypatch):
    monkeypatch.setattr(figures.os, "cpu_count", lambda: 1)
    found = drawn_by(tmp_path, monkeypatch, {"a": lambda: 0}, {"b": lambda: 0})
    assert set(found.values()) == {os.getpid()}


def test_figures_of_a_child_that_fails_are_drawn_again(tmp_path, monkeypatch):
    monkeypatch.setattr(figures.os, "cpu_count", lambda: 2)
    parent = os.getpid()

    def only_here():
        if os.getpid() != parent:
            raise MemoryError

    found = drawn_by(tmp_path, monkeypatch, {"a": lambda: 0}, {"b": only_here})
    assert found == {"a": parent, "b": parent}


def test_an_error_reaches_the_caller(tmp_path, monkeypatch):
    def broken():
        raise ValueError("no such colour")

    monkeypatch.setattr(figures.os, "cpu_count", lambda: 2)
    with pytest.raises(ValueError, match="no such colour"):
        drawn_by(tmp_path, monkeypatch, {"a": lambda: 0}, {"b": broken})


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_child_that_hangs_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(figures.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(figures, "LEAST_WAIT", 0.2)
    parent = os.getpid()

    def hangs_there():
        if os.getpid() != parent:
            time.sleep(60)

    found = drawn_by(tmp_path, monkeypatch, {"a": lambda: 0}, {"b": hangs_there})
    assert found == {"a": parent, "b": parent}
