"""Maps and pictures: values, positions, orientation and units."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import limits, psf, views
from nlosoptics.errors import SceneError
from nlosoptics.psf.wave.wavefront import Wavefront
from nlosoptics.scene import Scene
from nlosoptics.views.canvas import SERIES

pytest.importorskip("matplotlib")

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3


def one_wave_of_tilt(nodes: Literal["polar", "grid"]) -> Wavefront:
    """W = one wave times u/RADIUS: the long side is at positive u."""
    # Noll's second polynomial is 2 rho cos(theta)
    return Wavefront.from_zernike(
        {2: WAVELENGTH / 2},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=0.05,
        nodes=nodes,
        samples=64 if nodes == "grid" else None,
    )


def spread(intensity: Any) -> Any:
    """A stand-in with the fields that the picture reads."""
    return psf.PointSpread(
        intensity=np.asarray(intensity),
        pitch=2e-6,
        method="mdft",
        normalisation="unit-sum",
        error_estimate=1e-4,
        wavelength=5e-7,
        f_number=4.0,
        pixel_integrated=False,
        enclosed_energy=1.0,
        regime="wave",
        reason="",
    )


def letter() -> np.ndarray:
    """An L as the eye reads it, row 0 on top."""
    picture = np.zeros((8, 8))
    picture[1:7, 2] = picture[6, 2:6] = 1.0
    return picture


def shown(axes: Any) -> np.ndarray:
    """The picture on axes as the eye sees it, top row first, left column first."""
    (drawn,) = axes.images
    picture = np.asarray(drawn.get_array())
    left, right, bottom, top = drawn.get_extent()
    if (bottom > top) != (drawn.origin == "upper"):
        picture = picture[::-1]
    if (right < left) != axes.xaxis_inverted():
        picture = picture[:, ::-1]
    return picture[::-1] if not axes.yaxis_inverted() else picture


@pytest.mark.parametrize("layout", ["grid", "polar"])
def test_wavefront_is_drawn_in_waves_and_mm(layout: Literal["polar", "grid"]) -> None:
    """Colours are symmetric about zero, positions in mm, values in waves."""
    axes = views.wavefront(one_wave_of_tilt(layout))
    assert axes.get_xlabel() == "u (mm)"
    (drawn,) = axes.collections
    low, high = drawn.get_clim()
    assert low == -high
    # the outermost node lies within one node spacing of the rim
    assert 0.95 < high < 1.05
    assert axes.get_xlim()[1] == pytest.approx(12.5, rel=0.1)


def test_wavefront_of_cells_is_drawn_patch_by_patch() -> None:
    """Colours are shared, and nothing is drawn across the gap."""
    pair = psf.Aperture.union(
        psf.Aperture.polygon([(-3e-3, -1e-3), (-1e-3, -1e-3), (-1e-3, 1e-3), (-3e-3, 1e-3)]),
        psf.Aperture.polygon([(1e-3, -1e-3), (3e-3, -1e-3), (3e-3, 1e-3), (1e-3, 1e-3)]),
    )
    wave = psf.Wavefront.from_function(
        aperture=pair, pistons=[-1e-6, 2e-6], wavelength=1e-6, image_distance=0.05
    )
    left, right = views.wavefront(wave).collections
    assert left.get_clim() == right.get_clim() == (-2.0, 2.0)
    assert left.get_array().min() == left.get_array().max() == -1.0
    assert left.get_coordinates()[..., 0].max() < -0.9


def test_dark_nodes_are_blank() -> None:
    """Nodes outside the pupil carry no value, whatever their aberration says."""
    wave = one_wave_of_tilt("grid")
    (drawn,) = views.wavefront(wave).collections
    blank = np.ma.getmaskarray(drawn.get_array()).reshape(wave.u.shape)
    np.testing.assert_array_equal(blank, wave.weights == 0)
    assert blank.any()


def test_point_spread_centre_is_at_zero() -> None:
    """The peak sample [ny//2, nx//2] is drawn at x = y = 0, for even and odd counts."""
    for shape in ((6, 6), (5, 7)):
        intensity = np.zeros(shape)
        intensity[shape[0] // 2, shape[1] // 2] = 1.0
        axes = views.point_spread(spread(intensity))
        (drawn,) = axes.images
        left, right, bottom, top = drawn.get_extent()
        columns = np.linspace(left, right, shape[1] + 1)
        rows = np.linspace(top, bottom, shape[0] + 1)
        j, i = shape[1] // 2, shape[0] // 2
        # rounding of a few um
        assert (columns[j] + columns[j + 1]) / 2 == pytest.approx(0, abs=1e-12)
        assert (rows[i] + rows[i + 1]) / 2 == pytest.approx(0, abs=1e-12)
        assert bottom < top  # -y, which points up


def test_log_scale_spans_its_decades() -> None:
    """Zero intensity is drawn like the faintest, without a warning of log(0)."""
    axes = views.point_spread(spread([[0.0, 1e-9], [1e-3, 1.0]]), decades=4, half_width=3e-6)
    (drawn,) = axes.images
    assert drawn.get_clim() == (1e-4, 1.0)
    assert drawn.get_array().min() == 1e-4
    assert axes.get_ylim() == (-3.0, 3.0)


def test_image_has_row_zero_on_top() -> None:
    """Drawn as the camera shows it, in mm about the axis."""
    axes = views.image(SimpleNamespace(electrons=letter(), pitch=72e-6))  # type: ignore[arg-type]
    np.testing.assert_array_equal(shown(axes), letter())
    # eight pixels of 72 um straddle the axis; -y points up
    np.testing.assert_allclose(axes.images[0].get_extent(), (-0.288, 0.288, -0.288, 0.288))


def test_scale_bar_has_a_round_length_on_the_object() -> None:
    """At 25 m on the object per m on the detector, 2 mm there are 0.08 mm here."""
    seen = SimpleNamespace(electrons=letter(), pitch=72e-6)
    axes = views.image(seen, object_scale=25.0)  # type: ignore[arg-type]
    (bar,) = axes.lines
    assert np.ptp(bar.get_xdata()) == pytest.approx(0.08)
    assert axes.texts[0].get_text() == "2 mm on the object"
    with pytest.raises(SceneError, match="object_scale = 0 is out of range"):
        views.image(seen, object_scale=0.0)  # type: ignore[arg-type]


def test_reconstruction_reads() -> None:
    """The wall's mirror is undone: a mirror-reversed object is drawn the right way round."""
    seen = letter()[:, ::-1]
    for mirrored, values in ((True, seen), (False, letter())):
        found = SimpleNamespace(object=values, status="converged")
        for pitch in (None, 1e-3):
            drawn: Any = views.reconstruction(found, values, pitch=pitch, mirrored=mirrored)  # type: ignore[arg-type]
            for axes in drawn:
                np.testing.assert_array_equal(shown(axes), letter())


def test_reconstruction_names_its_scale() -> None:
    """Each picture its own: only what has the largest value 1 is relative."""
    found = SimpleNamespace(object=np.diag([3.0, 0.5]), status="converged")
    axes = views.reconstruction(found, np.eye(2))  # type: ignore[arg-type]
    told = [axis.child_axes[0].get_ylabel() for axis in axes]
    assert told == ["relative brightness", "object units"]


def test_sketch_shows_each_part(flat_scene: Scene) -> None:
    """Two views in m, with wall, laser, object, its mirror image, camera and chief path."""
    top, side = views.scene_sketch(flat_scene)
    assert top.get_xlabel() == "x (m)"
    assert side.get_ylabel() == "y, up (m)"
    lines = {line.get_label(): np.array(line.get_data()) for line in top.lines}
    assert {"relay wall", "laser beam", "hidden object", "mirrored object", "chief path"} <= set(
        lines
    )
    # z of the mirrored object is that of the object, behind the wall
    np.testing.assert_allclose(lines["mirrored object"][1], -lines["hidden object"][1])
    # mirror law on the flat wall: equal angles before and after the third point
    _, hidden, wall, lens = lines["chief path"].T
    before, after = hidden - wall, lens - wall
    # rounding of coordinates near 1 m
    assert before[0] / before[1] == pytest.approx(-after[0] / after[1], rel=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("suffix", "begins"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")]
)
def test_save_writes_equal_bytes(tmp_path: Path, suffix: str, begins: bytes) -> None:
    """The same picture twice is the same file; any of figure, axes and axes' tuple will do."""
    files = [tmp_path / f"{name}{suffix}" for name in "abc"]
    for file in files[:2]:
        views.save((views.wavefront(one_wave_of_tilt("grid")),), file)
    views.save(views.wavefront(one_wave_of_tilt("grid")).get_figure(), files[2])  # type: ignore[arg-type]
    contents = {file.read_bytes() for file in files}
    assert len(contents) == 1
    assert contents.pop().startswith(begins)


def test_feasibility_draws_both_ways_and_their_noise() -> None:
    """Curves are the modulation, dashed lines what noise hides, and the strokes are marked."""
    from nlosoptics.limits import Feasibility

    frequency = np.linspace(0.0, 10.0, 5)
    modulation, relay = np.exp(-frequency), np.exp(-4.0 * frequency)
    found = Feasibility(
        recoverable=True,
        verdict="recoverable",
        score=0.97,
        score_spread=0.03,
        relay_score=0.4,
        photons=1e6,
        electrons={},
        brightest=10.0,
        veil=0.5,
        saturated=0.0,
        noise={},
        stroke=0.1,
        frequency=frequency,
        modulation=modulation,
        relay_modulation=relay,
        signal_to_noise=modulation * 50.0,
        relay_signal_to_noise=relay * 20.0,
        limit=3.9,
        modes=40,
        diffuse_modes=6,
        wave_bounds={},
        two_frame_bounds={},
        one_frame_fits=0.6,
        two_frame_fits=1.0,
        blind="",
    )
    axes = views.feasibility(found)
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert np.allclose(lines["specular image"].get_ydata(), np.maximum(modulation, 1e-5))
    levels = sorted(float(line.get_ydata()[0]) for name, line in lines.items() if "noise" in name)
    assert levels == pytest.approx([1 / 50, 1 / 20])
    assert float(lines["stroke frequency"].get_xdata()[0]) == pytest.approx(5.0)
    assert "40 modes" in axes.get_title()


def test_axes_of_several_figures_are_not_written_to_one_file(tmp_path):
    first, second = (views.wavefront(one_wave_of_tilt("grid")) for _ in range(2))
    with pytest.raises(SceneError, match="axes of 2 figures"):
        views.save([first, second], tmp_path / "both.png")
    assert not list(tmp_path.iterdir())
    views.save([first, first], tmp_path / "one.png")
    assert (tmp_path / "one.png").exists()


def test_through_focus_marks_the_best_plane_and_the_depth_of_focus():
    wave = one_wave_of_tilt("polar")
    found = psf.through_focus(wave, np.linspace(-20e-6, 30e-6, 11))
    axes = views.through_focus(found)
    x, y = axes.lines[0].get_data()
    np.testing.assert_allclose(x, 1e3 * found.shifts)
    np.testing.assert_allclose(y, found.values)
    assert axes.lines[1].get_xdata()[0] == pytest.approx(1e3 * found.shifts[found.best])
    width = axes.patches[0].get_width()  # 2 lambda N^2 to each side
    assert width == pytest.approx(4e3 * WAVELENGTH * wave.f_number**2)
    spots = views.through_focus(psf.through_focus(wave, found.shifts, criterion="spot"))
    assert spots.get_ylabel() == "spot (µm)"


def test_the_style_sheet_has_the_colours_of_the_views():
    import matplotlib.style
    from matplotlib.colors import to_hex

    with matplotlib.style.context("nlosoptics.views.palette"):
        cycle = matplotlib.rcParams["axes.prop_cycle"].by_key()["color"]
    assert [to_hex(colour).upper() for colour in cycle] == list(SERIES)


@pytest.mark.thorough
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


@pytest.mark.thorough
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


NO_MATPLOTLIB = """
import sys
sys.modules["matplotlib"] = None
import numpy as np
from nlosoptics import psf, views
from nlosoptics.errors import MissingExtraError

wave = psf.Wavefront.from_zernike({}, wavelength=6e-7, pupil_radius=5e-3, image_distance=0.05)
for draw in (
    lambda: views.wavefront(wave),
    lambda: views.point_spread(psf.point_spread(wave, shape=16)),
    lambda: views.spot_diagram(psf.spot_diagram(wave)),
):
    try:
        draw()
    except MissingExtraError as error:
        assert "pip install 'nlosoptics[views]'" in str(error)
    else:
        raise AssertionError("drawn without matplotlib")
"""


@pytest.mark.thorough
def test_without_matplotlib_every_picture_names_the_extra():
    answer = subprocess.run([sys.executable, "-c", NO_MATPLOTLIB], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr


def test_phase_of_a_field_is_cut_to_its_lit_part():
    """Dark samples are blank; the first index is v, which points up."""
    values = np.zeros((8, 8), complex)
    values[3:5, 3:5] = [[1.0, 1j], [-1.0, -1j]]
    axes = views.wavefront(psf.PupilField(values=values, pitch=1e-3))
    (drawn,) = axes.images
    assert np.asarray(drawn.get_array()) == pytest.approx(np.angle(values[3:5, 3:5]))
    assert drawn.get_extent() == pytest.approx([-1.5, 0.5, -1.5, 0.5])
    assert drawn.origin == "lower"


def test_wrong_options_of_a_point_spread_are_refused():
    light = spread(np.eye(4))
    for options, message in (
        ({"scale": "cubic"}, "scale = 'cubic' is unknown, must be one of log, linear"),
        ({"decades": 0.0}, "decades = 0 is out of range"),
        ({"half_width": -1e-6}, "half_width = -1e-06 m is out of range"),
    ):
        with pytest.raises(SceneError, match=message):
            views.point_spread(light, **options)


@pytest.mark.thorough
def test_pyplot_is_never_loaded(tmp_path: Path) -> None:
    """pyplot would pick a window system and keep figures alive."""
    code = (
        "import sys\nfrom types import SimpleNamespace\nimport numpy as np\n"
        "from nlosoptics import views\n"
        "axes = views.image(SimpleNamespace(electrons=np.eye(4), pitch=1e-6))\n"
        f"views.save(axes, {str(tmp_path / 'eye.png')!r})\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_one_firefly_does_not_blacken_a_traced_image() -> None:
    """The grey scale covers 99.5 % of the pixels and says so; the drawn values are unchanged."""
    scene = nlos.example("letter_flat").resized(16)
    image = nlos.raytrace.trace_image(scene, n_rays=4096, max_bounces=3, seed=0)
    values = image.expected.copy()
    values[3, 4] = 1e6 * values.max()
    drawn = views.traced_image(replace(image, expected=values))[0]
    assert drawn.images[0].get_clim()[1] <= 2.0 * np.sort(values, axis=None)[-2]
    np.testing.assert_array_equal(drawn.images[0].get_array(), values)
    labels = [axes.get_ylabel() for axes in drawn.figure.axes + drawn.child_axes]
    assert "electrons per pixel, white above percentile 99.5" in labels
    whole = views.traced_image(replace(image, expected=values), percentile=100.0)[0]
    assert whole.images[0].get_clim()[1] == values.max()
    with pytest.raises(SceneError, match="percentile = 0 is out of range"):
        views.traced_image(image, percentile=0.0)
