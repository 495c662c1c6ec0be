"""Point spreads: other programs, choice of method, batches of waves and rough walls."""

from collections.abc import Iterator, Sequence
from operator import itemgetter

from matplotlib.figure import Figure
from tables import figure, table

from .cells import Cell, Row, by, fill, listed
from .figures import Series, errors_against_seconds, legend
from .page import Section

PROGRAMS = ("nlosoptics", "prysm", "HCIPy", "POPPY", "Optiland")


def fastest(found: Sequence[Row], most: float) -> dict[str, Row]:
    """The quickest row of each program whose error is no larger, by its name's first word."""
    best: dict[str, Row] = {}
    for row in sorted(found, key=lambda row: row["seconds"]):
        if row["error"] <= most:
            best.setdefault(row["name"].split(",")[0], row)
    return best


def psf_peers(found: Sequence[Row]) -> str:
    """Return what each program takes to two errors."""
    body = []
    for case in by("case")(found):
        for most in (1e-3, 1e-6):
            best = fastest(case["rows"], most)
            cells = [
                fill("{seconds:time} ({error:n2})", best[name]) if name in best else "not reached"
                for name in PROGRAMS
            ]
            body.append([f"{case['case']}, to {most:g}", *cells])
    return table(["run time (error)", *PROGRAMS], body)


def front(found: Sequence[Row], name: str) -> Iterator[tuple[float, float]]:
    """Yield seconds and error of a program's settings that no other of its settings beats."""
    own = [row for row in found if row["name"].startswith(name) and row["error"] > 0]
    for row in own:
        if not any(o["seconds"] <= row["seconds"] and o["error"] < row["error"] for o in own):
            yield row["seconds"], row["error"]


def draw_psf_peers(found: Sequence[Row]) -> Figure:
    """Draw the least seconds to any error, a panel a case."""
    cases = by("case")(found)
    lines = (len(cases) + 1) // 2
    drawn = figure(9, 1 + 2.7 * lines)
    panels = drawn.subplots(lines, 2, sharex=True, sharey=True, squeeze=False).flat
    for axes, case in zip(panels, cases, strict=False):
        fronts = {name: list(front(case["rows"], name)) for name in PROGRAMS}
        series: Series = {name: points for name, points in fronts.items() if points}
        errors_against_seconds(axes, series, "largest error / peak")
        name = case["case"]
        axes.set_title(f"{name} of aberration" if "wave" in name else name, fontsize="medium")
    legend(drawn, 5)
    for axes in drawn.axes:
        axes.label_outer()
    return drawn


#: Rows of the study of ``method="auto"``.
PSF_STUDY: dict[str, Cell] = {
    "random waves": "{cases}",
    "compared with a reference": "{compared}",
    "of these: error within `tol`": "{within_tol:.1%}",
    "error below the error estimate": "{bounded:.1%}",
    "error estimate divided by error, median": "{median_overstatement:n}",
    "refused": "{refused:.1%}",
    "refusals that name no remedy": "{refusals_without_remedy}",
    "remedies that failed when they were tried": "{remedies_failed} of {remedies_tried}",
    "run time divided by the predicted one, median": "{median_seconds_over_predicted:n}",
    "run time predicted within a factor of three": "{seconds_within_three:.1%}",
    "longest run time": "{longest_seconds:g} s",
}


SECTIONS = (
    Section(
        "psf_peers.json",
        "Point spreads compared with other programs",
        "Run time of each program for one point spread of 256 x 256 samples, on one thread. Each "
        "program has its fastest setting that keeps the error below the value in the first "
        "column; its set-up is not timed. The error that it reaches is in parentheses: the "
        "largest difference of any sample from an accurate reference, relative to the peak.",
        "python benchmarks/psf_peers.py --json {file}",
        table=psf_peers,
        figure=draw_psf_peers,
        alternative="Seconds against error of point spreads by five programs, for 0, 1, 10 and "
        "100 waves",
    ),
    Section(
        "psf_pupils.json",
        "Point spreads of vaned and segmented pupils",
        "As in the previous table, for one wave of aberration on two other pupils: a ring with "
        "four vanes (spider), as of a reflecting telescope, and a mirror of 19 hexagonal "
        "segments. The other programs store a pupil as the fraction of each sample that is "
        "inside. Optiland is not compared.",
        "python benchmarks/psf_peers.py --case spider --case '19 hexagons' --samples 1024 --json "
        "{file}",
        table=psf_peers,
        figure=draw_psf_peers,
        alternative="Seconds against error of point spreads of a spider and of 19 hexagons by "
        "three programs",
    ),
    Section(
        "psf_study.json",
        "Choice and error estimate of `point_spread`",
        'How often does `method="auto"` keep the requested error `tol`, and how good are its '
        "error estimate and its predicted run time? Random waves, pupils, samplings and "
        "tolerances were compared with a reference that shares no code with the transforms. A "
        "refusal is an error message in place of a result; it names a remedy, such as another "
        "argument.",
        "python benchmarks/psf_study.py --max-seconds 20 --json {file}",
        table=lambda found: listed(PSF_STUDY, found),
    ),
    Section(
        "rough_walls.json",
        "Rough walls: the mean against random walls",
        "The point spread of a rough wall, averaged over all walls, has a closed form. Here it is "
        "compared with the average of 2048 random walls, in rings that contain equal light. The "
        "table has the run time of the mean and of one wall, and the largest difference of a ring "
        "next to that expected by chance. The last column states how the difference falls with "
        "the number n of walls; chance alone gives n^-0.5.",
        "python benchmarks/rough_walls.py",
        table={
            "angle of incidence, phase rms": "{angle}°, {s:g} rad",
            "time of the mean": "{mean_ms:milli time}",
            "time of one wall": "{one_ms:milli time}",
            "largest difference": "{worst_percent:.2g} %",
            "by chance": "{chance_percent:.2g} %",
            "falls with walls as": "n^{slope:.2f}",
        },
        rows=itemgetter("drawn"),
    ),
)
