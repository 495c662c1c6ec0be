"""What ``nlosoptics verify`` says: about this machine, about a fault, about a user's table."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from nlosoptics import psf
from nlosoptics.cli import main
from nlosoptics.errors import SceneError
from nlosoptics.verification import checks, verify


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Replace all checks by functions."""
    return lambda *functions: monkeypatch.setattr(checks, "_all", lambda: iter(functions))


def right() -> tuple[float, float]:
    """Right answer, in metres: itself."""
    return 0.1, 0.2


def wrong() -> tuple[float, float]:
    """Wrong answer, in metres: another one."""
    return 0.3, 0.2


def undefined() -> tuple[float, float]:
    """No answer, in metres: nothing."""
    return math.nan, 0.2


def broken() -> tuple[float, float]:
    """Broken check, in metres: its error."""
    raise RuntimeError("no such thing")


@pytest.mark.thorough
def test_everything_is_right_here():
    found = verify()
    assert [check for check in found if not check.passed] == []
    assert len(found) > 20


def test_a_fault_does_not_hide_the_checks_after_it(only):
    only(wrong, undefined, broken, right)
    found = verify()
    assert [check.passed for check in found] == [False, False, False, True]
    assert found[0].name == "Wrong answer, in metres"
    assert found[2].reason == "RuntimeError: no such thing"


@pytest.mark.parametrize(("functions", "code"), [((right,), 0), ((right, broken), 1)])
def test_command(only, capsys, functions, code):
    only(*functions)
    with pytest.raises(SystemExit) as end:
        main(["verify"])
    assert end.value.code == code
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "passed  1.0e-01 of 2.0e-01  Right answer, in metres: itself"
    assert f"1 of {len(functions)} checks passed" in out[-3]
    assert "numba" in out[-2]


def test_table_of_a_design_program(only, tmp_path):
    """Defocus of 0.06 waves and coma of 0.08 have 0.1 waves rms."""
    only(right)
    table = tmp_path / "wave.txt"
    psf.write_zernikes(table, {4: 0.06 * 5e-7, 8: 0.08 * 5e-7}, wavelength=5e-7)
    assert [check.passed for check in verify(zernikes=table, rms=0.1)] == [True, True]
    assert [check.passed for check in verify(zernikes=table, rms=0.107)] == [True, False]
    with pytest.raises(SceneError, match="belong together; give both or none"):
        verify(zernikes=table)
    with pytest.raises(SceneError, match="rms = nan"):
        verify(zernikes=table, rms=math.nan)
