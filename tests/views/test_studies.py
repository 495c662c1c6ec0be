"""Pictures of design studies show what the results hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nlosoptics import psf, views
from nlosoptics.errors import SceneError

xr = pytest.importorskip("xarray")  # of the extra "study"
from nlosoptics.study import Fraction, Optimum, Results, Study  # noqa: E402
from nlosoptics.study.answers import Sensitivity  # noqa: E402
from nlosoptics.views.studies import step_of, study_gallery  # noqa: E402

SCENE = Path(__file__).parents[2] / "examples" / "scenes" / "letter_concave.toml"


def results() -> Results:
    """Two dimensions with a failed point, and a third of which one step is shown."""
    values = np.arange(24.0).reshape(4, 2, 3)
    values[2, 1, 0] = np.nan
    dims = ("wall.radius", "hidden.image", "laser.power")
    study = Study.from_tables(
        {
            "scene": str(SCENE),
            "figures": ["strehl"],
            "axes": {
                "wall.radius": ["1 m", "2 m", "3 m", "4 m"],
                "hidden.image": ["../objects/F.png", "../objects/R.png"],
                "laser.power": ["1 mW", "5 mW", "20 mW"],
            },
        }
    )
    dataset = xr.Dataset(
        {
            "strehl": (dims, values),
            "strehl_error": (dims, np.full((4, 2, 3), 0.5)),
            "status": (dims, np.where(np.isfinite(values), "done", "failed")),
        },
        {
            "wall.radius": ("wall.radius", [1.0, 2.0, 3.0, 4.0], {"units": "m"}),
            "hidden.image": ("hidden.image", ["F.png", "R.png"]),
            "laser.power": ("laser.power", [1e-3, 5e-3, 2e-2], {"units": "W"}),
        },
    )
    return Results(path=Path("store"), study=study, dataset=dataset)


def labels(axis) -> list[str]:
    return [text.get_text() for text in axis.get_ticklabels()]


def test_map_shows_the_last_two_dimensions_at_the_middle_of_the_others() -> None:
    axes = views.study_map(results(), "strehl", boundary=14.0)
    (shown,) = axes.get_images()
    assert np.array_equal(shown.get_array().filled(np.nan)[0], [12.0, 13.0, 14.0])
    assert labels(axes.xaxis) == ["1 mW", "5 mW", "20 mW"]
    assert labels(axes.yaxis) == ["F.png", "R.png"]
    assert axes.get_title() == "wall.radius = 3 m"
    told = [text.get_text() for text in axes.texts]
    assert told == ["12", "13", "14", "failed", "16", "17"]
    # cells above 14: the upper row but for the failed one, and the last of the lower row
    edges = {(tuple(line.get_xdata()), tuple(line.get_ydata())) for line in axes.lines}
    assert edges == {
        ((1.5, 1.5), (-0.5, 0.5)),
        ((0.5, 0.5), (0.5, 1.5)),
        ((0.5, 1.5), (0.5, 0.5)),
    }


def test_curve_shows_errors_and_chosen_steps() -> None:
    axes = views.study_map(results(), "strehl", at={"hidden.image": 0, "laser.power": 2})
    line = axes.lines[0]
    assert line.get_xdata().tolist() == [1.0, 2.0, 3.0, 4.0]
    assert line.get_ydata().tolist() == [2.0, 8.0, 14.0, 20.0]
    assert axes.get_xlabel() == "wall.radius (m)"
    (bars,) = axes.containers
    segments = bars[2][0].get_segments()
    assert [np.ptp(segment[:, 1]) for segment in segments] == [1.0] * 4
    with pytest.raises(SceneError, match="laser.power = 3 is no step"):
        views.study_map(results(), "strehl", at={"laser.power": 3})
    with pytest.raises(SceneError, match="figure = 'mtf' is unknown"):
        views.study_map(results(), "mtf")


def test_axes_of_a_map_are_chosen_and_categories_are_bars() -> None:
    stored = results()
    axes = views.study_map(stored, "strehl", x="wall.radius", y="laser.power")
    assert axes.get_images()[0].get_array().tolist()[2] == [5.0, 11.0, 17.0, 23.0]
    assert (axes.get_xlabel(), axes.get_title()) == ("wall.radius", "hidden.image = R.png")
    at = {"laser.power": step_of(stored, "laser.power", "20mW"), "wall.radius": 0}
    bars = views.study_map(stored, "strehl", x="hidden.image", at=at)
    assert [bar.get_height() for bar in bars.patches] == [2.0, 5.0]
    assert labels(bars.xaxis) == ["F.png", "R.png"]
    with pytest.raises(SceneError, match="give one of: 1 mW, 5 mW, 20 mW"):
        step_of(stored, "laser.power", "2 mW")
    with pytest.raises(SceneError, match="camera.f_number is not one of two .* out of wall.radius"):
        views.study_map(stored, "strehl", x="camera.f_number")


def test_tornado_has_a_row_for_each_address() -> None:
    bars = [
        Sensitivity(case="wall.radius = 4 m", value=0.5, change=-0.3, resolved=True),
        Sensitivity(case="wall.radius = 6 m", value=0.9, change=0.1, resolved=False),
        Sensitivity(case="laser.power = 0 W", value=np.nan, change=np.nan, resolved=False),
    ]
    axes = views.tornado(bars, label="strehl")
    assert labels(axes.yaxis) == ["wall.radius", "laser.power"]
    widths = [patch.get_width() for patch in axes.patches]
    assert widths == [-0.3, 0.1, 0.0]
    assert [patch.get_alpha() for patch in axes.patches] == [1.0, 0.3, 0.3]
    assert [text.get_text() for text in axes.texts] == ["4 m", "6 m", "0 W failed"]
    assert axes.get_xlabel() == "change of strehl"


def test_yield_is_drawn_in_percent_with_its_interval() -> None:
    shares = [
        Fraction(value=v, low=v - 0.1, high=v + 0.05, met=int(20 * v), points=20, failed=2)
        for v in (0.9, 0.5, 0.2)
    ]
    axes = views.yield_curve([0.1, 0.2, 0.3], shares, label="strehl")
    (band,) = axes.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((10.0, 95.0))
    assert axes.lines[0].get_ydata().tolist() == pytest.approx([90.0, 50.0, 20.0])
    assert "20 draws, 2 failed" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_contours_are_lines_between_cells_and_cells_below_the_boundary_are_hatched() -> None:
    axes = views.study_map(results(), "strehl", at={"wall.radius": 0}, boundary=2.0, contours=[1.5])
    # values are 0 1 2 / 3 4 5, so that 1.5 lies on a straight line of slope -1/3
    (lines,) = [c for c in axes.collections if type(c).__name__ == "QuadContourSet"]
    vertices = np.concatenate([path.vertices for path in lines.get_paths()])
    assert vertices[:, 0] + 3 * vertices[:, 1] == pytest.approx(np.full(len(vertices), 1.5))
    assert [patch.get_xy() for patch in axes.patches if patch.get_hatch()] == [
        (-0.5, -0.5),
        (0.5, -0.5),
    ]
    assert {t.get_text() for t in axes.texts} <= {"1.5"}


def test_panels_share_their_colours() -> None:
    panels = views.study_panels(results(), "strehl", boundary=14.0)
    shown = [panel.get_images()[0] for panel in panels]
    for step, image in enumerate(shown):
        expected = results().dataset["strehl"].values[step]
        assert np.array_equal(image.get_array().filled(np.nan), expected, equal_nan=True)
        assert image.get_clim() == (0.0, 23.0)
    assert [panel.get_title() for panel in panels] == [f"wall.radius\n{r} m" for r in range(1, 5)]
    with pytest.raises(SceneError, match="not hidden.image, laser.power; draw a map"):
        views.study_panels(results(), "strehl", at={"wall.radius": 0})


def test_slices_hold_the_others_and_share_a_scale() -> None:
    panels = views.study_slices(results(), "strehl", at={"wall.radius": 1, "laser.power": 0})
    radius, image, power = panels
    found = pytest.approx([3.0, 9.0, np.nan, 21.0], nan_ok=True)
    assert radius.lines[0].get_ydata().tolist() == found
    assert [bar.get_height() for bar in image.patches] == [6.0, 9.0]
    assert power.lines[0].get_ydata().tolist() == [9.0, 10.0, 11.0]
    assert [p.get_title() for p in panels][1] == "wall.radius = 2 m\nlaser.power = 1 mW"
    assert len({panel.get_ylim() for panel in panels}) == 1


def drawn_results() -> Results:
    """Four draws of two values, of which one failed and one is pending."""
    of = {
        "wall.radius": {"from": "4 m", "to": "6 m"},
        "laser.power": {"from": "1 mW", "to": "2 mW"},
    }
    study = Study.from_tables(
        {"scene": str(SCENE), "figures": ["strehl"], "draws": {"count": 4, "of": of}}
    )
    dataset = xr.Dataset(
        {
            "strehl": ("draw", [0.1, np.nan, 0.3, np.nan]),
            "status": ("draw", ["done", "failed", "done", "pending"]),
        },
        {
            "wall.radius": ("draw", [4.0, 5.0, 5.5, 6.0], {"units": "m"}),
            "laser.power": ("draw", [1e-3, 1.2e-3, 1.4e-3, 2e-3], {"units": "W"}),
        },
    )
    return Results(path=Path("store"), study=study, dataset=dataset)


def test_slices_of_draws_are_dots_and_failures_are_marked() -> None:
    panels = views.study_slices(drawn_results(), "strehl")
    assert [panel.get_xlabel() for panel in panels] == ["wall.radius (m)", "laser.power (W)"]
    dots, marks = panels[0].lines
    assert (dots.get_xdata().tolist(), dots.get_ydata().tolist()) == ([4.0, 5.5], [0.1, 0.3])
    assert marks.get_xdata().tolist() == [5.0]
    assert panels[0].get_legend().get_texts()[0].get_text() == "1 failed"


def test_sobol_bars_are_sorted_and_have_their_intervals() -> None:
    found = {
        "first": [0.1, 0.6], "first_low": [0.05, 0.5], "first_high": [0.2, 0.7],
        "total": [0.2, 0.9], "total_low": [0.1, 0.8], "total_high": [0.3, 0.85],
    }  # fmt: skip
    indices = xr.Dataset(
        {name: ("address", values) for name, values in found.items()},
        {"address": ["laser.power", "wall.radius"]},
    )
    axes = views.tornado(indices, label="strehl")
    assert labels(axes.yaxis) == ["wall.radius", "laser.power"]
    first, total = axes.containers[1], axes.containers[3]
    assert [bar.get_width() for bar in first] == [0.6, 0.1]
    assert [bar.get_width() for bar in total] == [0.9, 0.2]
    ends = [
        [end for segment in bars.errorbar.lines[2][0].get_segments() for end in segment[:, 0]]
        for bars in (first, total)
    ]
    # the first total lies above its percentile interval, which is drawn to the bar's end
    assert ends[0] == pytest.approx([0.5, 0.7, 0.05, 0.2])
    assert ends[1] == pytest.approx([0.8, 0.9, 0.1, 0.3])


@pytest.mark.parametrize("smallest", [False, True])
def test_gallery_opens_the_extreme_points_again(smallest: bool) -> None:
    figures = ["strehl", "spot_rms"]
    study = Study.from_tables(
        {
            "scene": str(SCENE),
            "figures": figures,
            "set": {"camera.f_number": 16, "camera.binning": 64},
            "axes": {"camera.focus_distance": ["2.1 m", "1.9 m", "2 m", "2.05 m"]},
        }
    )
    values = [0.4, np.nan, 0.9, 0.1]
    dataset = xr.Dataset(
        {name: ("camera.focus_distance", values) for name in figures}
        | {"status": ("camera.focus_distance", ["done", "failed", "done", "done"])}
    )
    held = Results(path=Path("store"), study=study, dataset=dataset)
    panels = study_gallery(held, figures[smallest], smallest_is_best=smallest)
    order = [2, 0, 3] if smallest else [3, 0, 2]
    focus = {0: "2.1 m", 2: "2 m", 3: "2.05 m"}
    for panel, rank, index in zip(panels, ("worst", "median", "best"), order, strict=True):
        assert panel.get_title() == (
            f"{rank}: {figures[smallest]} = {values[index]}\ncamera.focus_distance = {focus[index]}"
        )
        spread = psf.scene_point_spread(study.scene(index), study.tol).point_spread
        shown = np.asarray(panel.get_images()[0].get_array())
        assert np.isin(spread.intensity.max(), shown)
    assert len({panel.get_xlim() for panel in panels}) == 1
    dataset["strehl"][:] = np.nan
    with pytest.raises(SceneError, match="strehl is known at no point"):
        study_gallery(held, "strehl")


def searched(objectives: list[list[float]], goals: tuple[str, ...]) -> Optimum:
    """An optimisation of which trial 2 failed and trial 3 is outside the constraints."""
    values = np.array(objectives)
    signs = np.where(np.array(goals) == "minimise", 1.0, -1.0)
    feasible = np.array([True, True, False, False, True])
    costs = np.where(feasible[:, None], signs * values, np.inf)
    worse = (costs[:, None] >= costs).all(-1) & (costs[:, None] > costs).any(-1)
    return Optimum(
        results=results(),
        labels=tuple(f"objective {i} (m)" for i in range(len(goals))),
        goals=goals,
        objectives=values,
        feasible=feasible,
        failed=np.isnan(values[:, 0]),
        front=tuple(np.flatnonzero(feasible & ~worse.any(axis=1)).tolist()),
    )


@pytest.mark.parametrize(
    ("goals", "corner"),
    [
        (("minimise", "minimise"), (2.0, 3.0)),  # right of the first point, above the second
        (("maximise", "maximise"), (1.0, 1.0)),
    ],
)
def test_front_runs_through_what_its_points_dominate(goals, corner) -> None:
    nan = np.nan
    worst = [9.0, 9.0] if goals[0] == "minimise" else [0.0, 0.0]
    found = searched([[2.0, 1.0], [1.0, 3.0], [nan, nan], [0.5, 0.5], worst], goals)
    axes = views.search(found)
    front = next(line for line in axes.lines if str(line.get_label()).startswith("front"))
    assert front.get_xydata().tolist() == [[1.0, 3.0], [2.0, 1.0]]
    # between its two points a step has one corner
    drawn = {"steps-post": (2.0, 3.0), "steps-pre": (1.0, 1.0)}[front.get_drawstyle()]
    assert drawn == corner
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    told = ["feasible: 3 trials", "outside constraints: 1 trials", "failed: 1 trials"]
    assert texts == [*told, "front: 2 trials"]
    assert axes.get_xlabel() == f"objective 0 (m), to {goals[0]}"
    with pytest.raises(SceneError, match="objectives 0 and 2 are not two of 2"):
        views.search(found, second=2)


def test_history_shows_the_best_feasible_trial_so_far() -> None:
    nan = np.nan
    found = searched([[3.0], [2.0], [nan], [1.0], [2.5]], ("minimise",))
    axes = views.search(found)
    best = next(line for line in axes.lines if line.get_label() == "best so far")
    assert best.get_ydata().tolist() == [3.0, 2.0, 2.0, 2.0, 2.0]
    failed = searched([[nan]] * 5, ("minimise",))
    with pytest.raises(SceneError, match="no trial with values"):
        views.search(failed)
