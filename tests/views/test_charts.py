"""Charts of transforms, rays and plans, and surfaces: data, labels, orientation."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import limits, psf, views
from nlosoptics.errors import SceneError
from nlosoptics.runs.plan import Plan, Stage
from nlosoptics.views.canvas import SERIES

pytest.importorskip("matplotlib")


def spread(intensity):
    """A stand-in with the fields that the picture reads."""
    light = np.asarray(intensity, dtype=np.float64)
    ny, nx = light.shape
    return SimpleNamespace(
        intensity=light,
        x=2e-6 * (np.arange(nx) - nx // 2),
        y=2e-6 * (np.arange(ny) - ny // 2),
        method="mdft",
        normalisation="unit-sum",
    )


def test_the_style_sheet_has_the_colours_of_the_views():
    import matplotlib.style
    from matplotlib.colors import to_hex

    with matplotlib.style.context("nlosoptics.views.palette"):
        cycle = matplotlib.rcParams["axes.prop_cycle"].by_key()["color"]
    assert [to_hex(colour).upper() for colour in cycle] == list(SERIES)


def test_rays_land_where_they_do_about_the_dark_ring(assert_drawn):
    wave = psf.Wavefront.from_zernike(
        {2: 2e-6, 8: 3e-7}, wavelength=6e-7, pupil_radius=5e-3, image_distance=0.05
    )
    spots = psf.spot_diagram(wave)
    axes = views.spot_diagram(spots)
    (dots,) = axes.collections
    np.testing.assert_allclose(dots.get_offsets().T, [1e6 * spots.x, 1e6 * spots.y])
    (ring,) = axes.patches
    np.testing.assert_allclose(ring.center, 1e6 * np.array(spots.centroid))
    assert ring.radius == pytest.approx(1e6 * spots.airy_radius)
    low, high = axes.get_ylim()
    assert low > high  # y grows downward, as on the camera
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (µm)", "y (µm)")
    assert f"rms radius {1e6 * spots.radius:.3g} µm" in axes.get_legend().get_texts()[0].get_text()
    assert_drawn(axes)
    (few,) = views.spot_diagram(spots, most=10).collections
    assert len(few.get_offsets()) <= 10
    with pytest.raises(SceneError, match="most = 0"):
        views.spot_diagram(spots, most=0)


def test_a_plan_is_a_bar_for_each_stage(assert_drawn):
    stages = (
        Stage(name="point spread", runs=True, reason="needed", seconds=0.5, error="1e-3"),
        Stage(name="image", runs=True, reason="wanted", seconds=2.0),
    )
    skipped = (Stage(name="shadow rays", runs=False, reason="no occluders"),)
    made = Plan(stages=stages, skipped=skipped, tol=1e-3, waves=1.0, exit_pupil=None, budget=None)
    axes = views.plan(made)
    assert [bar.get_width() for bar in axes.patches] == [0.5, 2.0, 0.0]
    assert [t.get_text() for t in axes.get_yticklabels()] == [
        "point spread",
        "image",
        "shadow rays",
    ]
    assert [t.get_text() for t in axes.texts] == ["0.5 s, 1e-3", "2 s", "skipped: no occluders"]
    first, last = axes.get_ylim()
    assert first > last  # the first stage is on top
    assert axes.get_xlabel() == "predicted time on one core (s)"
    assert axes.get_title() == "total 2.5 s, tolerance 0.001 of the peak"
    assert_drawn(axes)
    assert views.plan(made, axes=axes) is axes


def test_surface_stands_at_its_samples_and_leans_as_the_map(assert_drawn):
    """The peak at high x and low y stands there; y grows toward the viewer."""
    light = np.full((9, 11), 1e-4)
    light[2, 8] = 1.0
    axes = views.point_spread(spread(light), scale="surface", decades=4.0)
    (surface,) = axes.collections
    corners = np.concatenate([np.asarray(face) for face in surface._faces])
    top = corners[np.argmax(corners[:, 2])]
    # rounding of um
    assert top == pytest.approx([6.0, -4.0, 1.0], abs=1e-9)
    low, high = axes.get_ylim()
    assert low > high
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (µm)", "y (µm)")
    assert axes.get_zlabel() == "energy per sample (image plane total 1)"
    assert axes.figure.axes[1].get_ylabel() == "logarithmic colour scale"
    assert_drawn(axes)
    assert views.point_spread(spread(light), scale="surface", axes=axes) is axes


def test_surface_of_many_samples_keeps_its_peak_and_its_place():
    light = np.zeros((401, 401))
    light[300, 123] = 1.0
    axes = views.point_spread(spread(light), scale="surface")
    corners = np.concatenate([np.asarray(face) for face in axes.collections[0]._faces])
    top = corners[np.argmax(corners[:, 2])]
    assert top[2] == 1.0
    # a patch is three samples of 2 um wide
    assert top[:2] == pytest.approx([2.0 * (123 - 200), 2.0 * (300 - 200)], abs=3.0)
    part = views.point_spread(spread(light), scale="surface", half_width=20e-6)
    shown = np.concatenate([np.asarray(face) for face in part.collections[0]._faces])
    assert np.abs(shown[:, :2]).max() == pytest.approx(20.0)


def test_wrong_options_of_a_point_spread_are_refused():
    light = spread(np.eye(4))
    light.pitch = 2e-6
    flat = views.point_spread(light)
    for options, message in (
        ({"scale": "cubic"}, "scale = 'cubic' is unknown, must be one of log, linear, surface"),
        ({"decades": 0.0}, "decades = 0 is out of range"),
        ({"half_width": -1e-6}, "half_width = -1e-06 m is out of range"),
        ({"scale": "surface", "axes": flat}, "axes are 2-D axes"),
    ):
        with pytest.raises(SceneError, match=message):
            views.point_spread(light, **options)


def test_colour_bars_are_as_high_as_their_map():
    """Of a wide picture, whose axes are lower than the figure leaves room for."""
    axes = views.image(SimpleNamespace(electrons=np.ones((8, 32)), pitch=1e-5))
    axes.figure.canvas.draw()
    (bar,) = axes.child_axes
    ours, theirs = axes.get_window_extent(), bar.get_window_extent()
    assert (theirs.y0, theirs.y1) == pytest.approx((ours.y0, ours.y1), abs=1.0)  # a pixel
    assert bar.get_ylabel() == "electrons per pixel"


def test_reconstructions_may_be_tensors_with_gradients():
    torch = pytest.importorskip("torch")
    values = torch.arange(6.0, requires_grad=True).reshape(2, 3)
    (axes,) = views.reconstruction(SimpleNamespace(object=values, status="too_few_photons"))
    np.testing.assert_array_equal(axes.images[0].get_array(), [[0, 1, 2], [3, 4, 5]])
    assert axes.get_title() == "reconstruction, too few photons"


NO_MATPLOTLIB = """
import sys
sys.modules["matplotlib"] = None
import numpy as np
from types import SimpleNamespace
import nlosoptics as nlos
from nlosoptics import limits, psf, views
from nlosoptics.errors import MissingExtraError
from nlosoptics.runs.plan import Plan
from nlosoptics.transient import TransientCapture, wall_grid

wave = psf.Wavefront.from_zernike({}, wavelength=6e-7, pupil_radius=5e-3, image_distance=0.05)
spread = psf.point_spread(wave, shape=16)
capture = TransientCapture(
    H=np.ones((3, 2, 2)), laser_points=(0, 0, 0), sensor_points=wall_grid(1.0, 2), delta_t=1.0
)
ramp = [0.0, 1.0]
for draw in (
    lambda: views.wavefront(wave),
    lambda: views.point_spread(spread),
    lambda: views.point_spread(spread, scale="surface"),
    lambda: views.hybrid_parts(spread),
    lambda: views.spot_diagram(psf.spot_diagram(wave)),
    lambda: views.mtf(ramp, ramp),
    lambda: views.encircled_energy(ramp, ramp),
    lambda: views.history(SimpleNamespace(history={"residual": np.ones(2)})),
    lambda: views.plan(
        Plan(stages=(), skipped=(), tol=0.1, waves=0.0, exit_pupil=None, budget=None)
    ),
    lambda: views.transient(capture),
    lambda: views.transient_film(capture),
):
    try:
        draw()
    except MissingExtraError as error:
        assert "pip install 'nlosoptics[views]'" in str(error)
    else:
        raise AssertionError("drawn without matplotlib")
"""


def test_without_matplotlib_every_picture_names_the_extra():
    answer = subprocess.run([sys.executable, "-c", NO_MATPLOTLIB], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr


def test_overview_shows_a_whole_run(flat_scene, assert_drawn):
    """Six maps with a reconstruction and four without; the scale is that of the camera image."""
    scene = flat_scene.resized(32)
    result = nlos.simulate(scene, seed=0, reconstruct=True)
    axes = views.overview(result)
    assert_drawn(axes)
    titles = [drawn.get_title().split(",")[0] for drawn in axes]
    assert titles == [
        "top view",
        "wave aberration",
        "point spread function",
        "camera image",
        "reconstruction",
        "ground truth",
    ]
    width = limits.object_scale(scene) * scene.camera.image_pitch * 32
    assert np.ptp(axes[4].get_xlim()) == pytest.approx(width)
    without = views.overview(replace(result, reconstruction=None))
    assert [drawn.get_title() for drawn in without][3:] == ["camera image"]
