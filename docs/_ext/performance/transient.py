"""Time-resolved light: rendering, phasor fields and measured captures."""

from collections.abc import Sequence

from matplotlib.figure import Figure
from tables import figure

from .cells import Row, by
from .figures import curves, errors_against_seconds, legend
from .page import Section


def draw_measured_charts(found: Sequence[Row]) -> Figure:
    """Draw a point for each method, a panel a chart."""
    drawn = figure(8.5, 3.6)
    panels = drawn.subplots(1, 2, sharex=True, sharey=True)
    for axes, chart in zip(panels, by("chart")(found), strict=True):
        points = {row["method"]: [(row["seconds"], row["mae_m"] * 1e3)] for row in chart["rows"]}
        errors_against_seconds(axes, points, "mean error of depth (mm)")
        axes.set(title=chart["chart"].replace("_", " "), yscale="linear")
        axes.set_ylim(bottom=0)
        axes.label_outer()
    legend(drawn, 3)
    return drawn


SECTIONS = (
    Section(
        "bounces.jsonl",
        "Four and five bounces compared with mitransient",
        "Time-resolved light with four and five reflections, from a letter in a corridor, at 32 x "
        "32 or 12 x 12 sensor points in bins of 1 cm. The error of a sensor point is the sum of "
        "absolute differences between two runs with different seeds, relative to the light, "
        "divided by the square root of 2. The last column is the time to an error of 1 %. It is "
        "computed from time and error, which falls with the square root of the samples. Times of "
        "nlosoptics are processor time, those of mitransient wall time.",
        "python benchmarks/transient/bounces.py --peer-python PEER/bin/python --json {file}",
        table={
            "program, sensor points, reflections, samples": "{name}, {size} x {size}, {bounces}, "
            "{samples}",
            "run time": "{seconds:time}",
            "median error": "{l1_median:.1%}",
            "largest error": "{l1_max:.1%}",
            "median time to 1 %": "{seconds_to_goal_median:time}",
        },
        figure=curves(
            "{name}, {size} x {size}, {bounces} bounces",
            lambda row: row["l1_median"],
            "relative L1 error of a sensor, median",
        ),
        alternative="Seconds against the error of a sensor point: nlosoptics lies far below "
        "mitransient",
    ),
    Section(
        "phasor.json",
        "Phasor fields compared with y-tal",
        "Images of a letter 1 m from the wall, with one laser point. The overlap with the letter "
        "is intersection over union (1: perfect), at the best threshold of brightness. Times are "
        "those of one call, including its set-up; the next capture of the same points finds the "
        "transforms of the volume kept. Times of nlosoptics are processor time, those of y-tal are "
        "wall time. Images of 64 x 64 points have 64 planes.",
        "python benchmarks/transient/phasor.py --peer-python PEER/bin/python --json {file}",
        table={
            "sensor points, method": "{wall} x {wall}, {method}",
            "overlap with the letter": "{iou:n}",
            "run time": "{seconds:time}",
        },
    ),
    Section(
        "measured_charts.json",
        "Measured charts at known depths",
        "Depths from measured confocal captures of O'Toole 2018. The objects are flat charts 40 "
        "and 65 cm from the wall. A column is a line of voxels along the depth. The outlines of "
        "the charts are not published; the error is therefore the mean over the columns with the "
        "most confident depths, at least 10 % of all. The first run time is for the voxels within "
        "15 cm of the chart, the second for all depths of the capture. In the rows named light, "
        '`fk_migration` runs with `amplitude="light"`; blurred means that y-tal received the same '
        "blurred bins as the other methods.",
        "python benchmarks/transient/measured.py --data DIR --peer-python PEER/bin/python --json "
        "{file}",
        table={
            "chart, method": lambda row: f"{row['chart'].replace('_', ' ')}, {row['method']}",
            "mean error of depth": "{mae_m:mm .2f} mm",
            "columns found": "{coverage:.0%} of columns",
            "run time": "{seconds:time}",
            "run time, whole volume": "{seconds_full?:time}",
        },
        figure=draw_measured_charts,
        alternative="Seconds against mean error of depth of six methods on two measured charts",
    ),
)
