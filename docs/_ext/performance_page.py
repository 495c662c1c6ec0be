"""The performance page: every file of ``benchmarks/results`` as a table, some as a figure."""

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tables
from matplotlib.axes import Axes
from tables import COLOURS, MARKERS, figure, number, rows, seconds, table

from nlosoptics import views

Row = dict[str, Any]


@dataclass(frozen=True)
class Section:
    """One results file on the page.

    Parameters
    ----------
    file : str
        Name in ``benchmarks/results``.
    title, text : str
        Heading, and the paragraph below it.
    command : str
        Command that wrote the file.
    body : callable
        Function of the content of the file that returns Markdown.
    draw : callable, optional
        Function of the content of the file that returns a figure.
    alternative : str
        Description of the figure for readers who cannot see it.
    """

    file: str
    title: str
    text: str
    command: str
    body: Callable[[Any], str]
    draw: Callable[[Any], Any] | None = None
    alternative: str = ""


def pages(target: Path) -> None:
    """Write the tables and figures into a folder.

    Raises
    ------
    LookupError
        If a results file has no section or a section no file.
    """
    there = {path.name for path in tables.RESULTS.iterdir()}
    if there != {section.file for section in SECTIONS}:
        differ = sorted(there ^ {section.file for section in SECTIONS})
        raise LookupError(
            f"docs/_ext/performance_page.py and benchmarks/results differ in {differ}"
        )
    text = []
    for section in SECTIONS:
        found = rows(section.file)
        text += [f"## {section.title}\n", section.text + "\n", section.body(found)]
        if section.draw is not None:
            picture = f"{Path(section.file).stem}.svg"
            views.save(section.draw(found), target / picture)
            text.append(f"![{section.alternative}](_generated/{picture})\n")
        text.append(f"```console\n$ {section.command}\n```\n")
    tables.write(target / "performance.md", "\n".join(text))


def grouped(found: Sequence[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some keys, in the order in which they come."""
    groups = defaultdict(list)
    for row in found:
        groups[tuple(row[key] for key in keys)].append(row)
    return dict(groups)


def errors_against_seconds(
    axes: Axes, series: dict[str, list[tuple[float, float]]], label: str
) -> None:
    """Draw seconds across and error up, both logarithmic, a line for each name."""
    for i, (name, points) in enumerate(series.items()):
        style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
        axes.loglog(*zip(*sorted(points), strict=True), label=name, markersize=4, **style)
    axes.set(xlabel="run time (s)", ylabel=label)
    axes.xaxis.set_minor_formatter("")
    axes.yaxis.set_minor_formatter("")
    # a decade has its number; panels that share an axis keep what the others need
    low, high = axes.dataLim.intervalx
    old = axes.get_xlim() if axes.get_shared_x_axes().get_siblings(axes)[1:] else (low, high)
    axes.set_xlim(
        10 ** math.floor(math.log10(min(low, old[0]))),
        10 ** math.ceil(math.log10(max(high, old[1]))),
    )
    axes.grid(alpha=0.3)


PROGRAMS = ("nlosoptics", "prysm", "HCIPy", "POPPY", "Optiland")


def fastest(found: Sequence[Row], most: float) -> dict[str, Row]:
    """The quickest row of each program whose error is no larger, by its name's first word."""
    best: dict[str, Row] = {}
    for row in found:
        name = row["name"].split(",")[0]
        if row["error"] <= most and row["seconds"] < best.get(name, {"seconds": 1e99})["seconds"]:
            best[name] = row
    return best


def psf_peers(found: Sequence[Row]) -> str:
    """Return what each program takes to two errors."""
    body = []
    for (case,), part in grouped(found, "case").items():
        for most in (1e-3, 1e-6):
            best = fastest(part, most)
            cells = [
                f"{seconds(best[name]['seconds'])} ({number(best[name]['error'], 2)})"
                if name in best
                else "not reached"
                for name in PROGRAMS
            ]
            body.append([f"{case}, to {most:g}", *cells])
    return table(["run time (error)", *PROGRAMS], body)


def draw_psf_peers(found: Sequence[Row]) -> Any:
    """Draw the least seconds to any error, a panel a case."""
    cases = grouped(found, "case")
    lines = (len(cases) + 1) // 2
    drawn = figure(9, 1 + 2.7 * lines)
    panels = drawn.subplots(lines, 2, sharex=True, sharey=True, squeeze=False).flat
    for axes, ((case,), part) in zip(panels, cases.items(), strict=False):
        series = {}
        for name in PROGRAMS:
            own = [row for row in part if row["name"].startswith(name) and row["error"] > 0]
            # only what no other setting of the same program beats in both
            front = [
                (row["seconds"], row["error"])
                for row in own
                if not any(
                    other["seconds"] <= row["seconds"] and other["error"] < row["error"]
                    for other in own
                )
            ]
            if front:
                series[name] = front
        errors_against_seconds(axes, series, "largest error / peak")
        axes.set_title(f"{case} of aberration" if "wave" in case else case, fontsize="medium")
    handles, labels = axes.figure.axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=5)
    for axes in drawn.axes:
        axes.label_outer()
    return drawn


def psf_study(found: Row) -> str:
    """Return how often choice and estimate of ``auto`` were right."""
    body = [
        ["random waves", found["cases"]],
        ["compared with a reference", found["compared"]],
        ["of these: error within `tol`", f"{found['within_tol']:.1%}"],
        ["error below the error estimate", f"{found['bounded']:.1%}"],
        ["error estimate divided by error, median", number(found["median_overstatement"])],
        ["refused", f"{found['refused']:.1%}"],
        ["refusals that name no remedy", found["refusals_without_remedy"]],
        [
            "remedies tried, and of these failed",
            f"{found['remedies_tried']}, {found['remedies_failed']}",
        ],
        [
            "run time divided by the predicted one, median",
            number(found["median_seconds_over_predicted"]),
        ],
        ["run time predicted within a factor of three", f"{found['seconds_within_three']:.1%}"],
        ["longest run time", f"{found['longest_seconds']:g} s"],
    ]
    return table(["quantity", "value"], body)


def draw_psf_study(found: Row) -> Any:
    """Draw each wave's error and estimate over what was asked for, against its seconds."""
    drawn = figure(5.2, 4.2)
    axes = drawn.subplots()
    # where the reference is known well enough to tell
    run = [row for row in found["rows"] if row.get("error") and 3 * row["doubt"] < row["asked"]]
    for key, style in (
        ("estimate", {"marker": "o", "facecolors": "none", "edgecolors": COLOURS[1]}),
        ("error", {"marker": ".", "color": COLOURS[0]}),
    ):
        over = [row[key] / row["asked"] for row in run]
        axes.scatter([row["seconds"] for row in run], over, label=key, s=18, **style)
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="run time (s)",
        ylabel="error / requested error",
        title="random waves: estimated and true errors",
    )
    drawn.legend(loc="outside lower center", ncols=2)
    axes.grid(alpha=0.3)
    return drawn


def tolerances(found: Sequence[Row]) -> str:
    """Return one row a stage and tolerance."""
    head = ["stage", "tol", "run time", "error estimate", "error", "work"]
    return table(
        head,
        (
            [
                row["stage"],
                number(row["tol"]),
                seconds(row["seconds"]),
                number(row["estimate"], 2),
                number(row["error"], 2),
                row["work"],
            ]
            for row in found
        ),
    )


def coverage(found: Sequence[Row]) -> str:
    """Return one row for each scene: how often the intervals of its flux hold."""
    head = ["scene", "standard error of the flux", "within 1 standard error", "within 2"]
    head += ["called uncertain", "least reliable reflection", "within 2 for this one"]
    return table(
        head,
        (
            [
                row["scene"],
                _percent(row["relative_error"]),
                _percent(row["within_68"]),
                _percent(row["within_95"]),
                _percent(row["flux_uncertain"]),
                str(row["worst_bounce"]),
                _percent(row["worst_95"]),
            ]
            for row in found
        ),
    )


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def fast_tier(found: Sequence[Row]) -> str:
    """Return yields in full, fast and corrected, and what they cost."""
    (cost,) = (row for row in found if row["kind"] == "cost")
    head = ["figure of merit", "limit", "in full", "fast", "draws that differ"]
    head += ["corrected yield", "95 % interval"]
    body = table(
        head,
        (
            [
                row["kind"],
                number(row["limit"], 2),
                *(f"{100 * row[key]:.2f} %" for key in ("full", "fast")),
                str(row["disagree"]),
                f"{100 * row['value']:.2f} %",
                f"{100 * row['low']:.2f} to {100 * row['high']:.2f} %",
            ]
            for row in found
            if row["kind"] != "cost"
        ),
    )
    return (
        f"{body}\nA draw in full takes {seconds(cost['in full, of a draw'])} of CPU time, all "
        f"{cost['draws']:,} fast ones together {seconds(cost['fast, of all draws'])}. The whole "
        f"study takes {seconds(cost['whole study'])}, most of it for the draws in full.\n"
    )


def studies(found: Sequence[Row]) -> str:
    """Return one row for each number of workers, and what limits them."""
    head = [
        "kind",
        "workers",
        "time for one block",
        "client's CPU time for one point",
        "cores used by the client",
        "blocks per second",
        "share",
    ]
    body = table(
        head,
        (
            [
                row["kind"],
                str(row["workers"]),
                seconds(row["point"] * row["block"]),
                seconds(row["client"]),
                number(row.get("busy"), 2),
                number(row.get("blocks"), 2),
                number(row.get("share"), 2),
            ]
            for row in found
        ),
    )
    full = [row for row in found if row.get("share", 1.0) < 0.7]
    cpu = median(row["client"] * row["block"] for row in full)
    cores, blocks = (median(row[key] for row in full) for key in ("busy", "blocks"))
    real = next(row for row in found if row["kind"] == "measured")
    return (
        f"{body}\nThe client is the bottleneck. It writes a block of results with {seconds(cpu)} "
        f"of CPU time, which allows {number(1 / cpu, 2)} blocks a second on a core of its own. In "
        f"these runs other work left it {number(cores, 2)} of a core, and it wrote "
        f"{number(blocks, 2)} blocks a second, with a store in memory as with one on disk. A "
        "worker makes a block in about one second, so that more workers than blocks a second wait "
        f"for the client. On 1,000 cores a block must therefore take at least {seconds(1000 * cpu)}"
        ", by heavier points; the last row of each store has such blocks for 300 workers. A real "
        f"worker process costs the client {seconds(real['client'] * real['block'])} a block, so "
        "that its messages are the smaller part.\n"
    )


def whole_runs(found: Sequence[Row]) -> str:
    """Return wall and processor time, memory and the longest stages of whole commands."""
    lines = []
    for row in found:
        stages = {k: v for k, v in row.get("stages", {}).items() if k not in ("total", "outside")}
        longest = sorted(stages, key=lambda name: -stages[name])[:3]
        told = ", ".join(f"{name} {stages[name]:.2g} s" for name in longest)
        memory = f"{row['peak_mib']:.0f} MiB" if "peak_mib" in row else ""
        lines.append([row["case"], seconds(row["wall"]), seconds(row["cpu"]), memory, told])
    return table(["command", "wall time", "processor time", "memory", "longest stages"], lines)


def psf_batches(found: Sequence[Row]) -> str:
    """Return one row for each batch: milliseconds per wave, and errors."""
    head = [
        "rms aberration, waves",
        "tol",
        "threads",
        "waves",
        "batch (error)",
        "gradient",
        "point_spread (error)",
        "numpy (error)",
    ]
    return table(
        head,
        (
            [
                number(row["rms"], 2),
                number(row["tol"]),
                str(row["threads"]),
                str(row["waves"]),
                f"{seconds(row['cpu'])} ({number(row['error'], 2)})",
                seconds(row["gradient_cpu"]),
                f"{seconds(row['loop_cpu'])} ({number(row['loop_error'], 2)})",
                f"{seconds(row['numpy_cpu'])} ({number(row['numpy_error'], 2)})",
            ]
            for row in found
        ),
    )


def growth(found: Sequence[Row]) -> str:
    """Return one row for each stage: its range, its times and memory, and their exponents."""
    head = ["stage", "number n", "processor time", "grows as", "memory", "grows as"]
    return table(
        head,
        (
            [
                row["stage"],
                f"{row['numbers'][0]} to {row['numbers'][-1]} {row['against']}",
                f"{seconds(row['seconds'][0])} to {seconds(row['seconds'][-1])}",
                f"n^{row['seconds_exponent']:.2f}",
                f"{row['bytes'][0] / 2**20:.3g} to {row['bytes'][-1] / 2**20:.3g} MiB",
                f"n^{row['bytes_exponent']:.2f}",
            ]
            for row in found
        ),
    )


def rough_walls(found: Row) -> str:
    """Return the closed-form mean against drawn walls."""
    head = ["angle of incidence, phase rms", "time of the mean", "time of one wall"]
    head += ["largest difference", "by chance", "falls with walls as"]
    return table(
        head,
        (
            [
                f"{row['angle']}°, {row['s']:g} rad",
                seconds(row["mean_ms"] / 1e3),
                seconds(row["one_ms"] / 1e3),
                f"{row['worst_percent']:.2g} %",
                f"{row['chance_percent']:.2g} %",
                f"n^{row['slope']:.2f}",
            ]
            for row in found["drawn"]
        ),
    )


def rough_facets(found: Sequence[Row]) -> str:
    """Return the closed-form mean of facet walls against drawn walls."""
    head = ["angle of incidence, phase rms", "CPU time of the mean", "CPU time of one wall"]
    head += ["standard error", "largest deviation"]
    return table(
        head,
        (
            [
                f"{row['degrees']:.0f}°, {row['s']:g} rad",
                seconds(row["mean_cpu_seconds"]),
                seconds(row["wall_cpu_seconds"]),
                f"{100 * row['standard_error']:.2g} %",
                f"{row['largest_deviation']:.2g} errors",
            ]
            for row in found
        ),
    )


def known_psf(found: Sequence[Row]) -> str:
    """Return correlation and seconds of each solver, by noise."""
    methods = [key for key in found[0] if key not in ("case", "image")]
    body = []
    for noise in ("0.01", "0.05"):
        part = [row for row in found if row["case"].split()[-2] == noise]
        middle, least = (f([row["image"] for row in part]) for f in (median, min))
        body.append([f"the image itself, {float(noise):.0%}", number(middle), number(least), ""])
        for method in methods:
            scores = [row[method]["correlation"] for row in part if method in row]
            times = [row[method]["seconds"] for row in part if method in row]
            name = method.replace("skimage_", "scikit-image, ")
            body.append(
                [
                    f"{name}, {float(noise):.0%}",
                    number(median(scores)),
                    number(min(scores)),
                    seconds(median(times)),
                ]
            )
    return table(["method, noise", "median correlation", "lowest", "median run time"], body)


def fits(found: Sequence[Row], *keys: str) -> list[list[object]]:
    """Rows of a table of blind fits: cases, found, wrong and called right, score, seconds."""
    body = []
    for values, part in grouped(found, *keys).items():
        scores = [row["correlation"] for row in part]
        sure = [row["correlation"] for row in part if row["status"] == "converged"]
        body.append(
            [
                ", ".join(str(value) for value in values),
                len(part),
                sum(score > 0.9 for score in scores),
                sum(score <= 0.9 for score in sure),
                number(median(scores)),
                seconds(median(row["seconds"] for row in part)),
            ]
        )
    return body


def mismatches(found: Sequence[Row]) -> str:
    """Return how often each kind of mismatch is called converged, by the answer's correlation."""
    body = []
    for (kind,), part in grouped(found, "kind").items():
        cells: list[object] = [str(kind).replace("_", " "), len(part)]
        for low, high in ((-1.0, 0.85), (0.85, 0.93), (0.93, 1.0)):
            held = [row for row in part if low < row["correlation"] <= high]
            sure = sum(row["status"] == "converged" for row in held)
            cells.append(f"{sure} of {len(held)}" if held else "")
        body.append(cells)
    head = ["mismatch", "cases", "below 0.85", "0.85 to 0.93", "above 0.93"]
    return table(head, body)


FITS = ["fits", "above 0.9", "converged, not above 0.9", "median correlation", "median run time"]


def evidence(found: Sequence[Row]) -> str:
    """Return success by the wall's strength."""
    return table(["rms aberration, waves", *FITS], sorted(fits(found, "rms")))


def pictures(found: Row) -> str:
    """Return seconds, sizes and frame rate of the rooms."""
    png, files, frames = found["png_seconds"], found["files"], found["frames"]
    drawn = png["trial_of_rendering"] + png["picture_with_pyvista"]
    renderer = f"{frames['renderer'].split(' (')[0]}, {found['cores']} cores"
    return table(
        ["what", "value"],
        [
            ["PNG, with the import of pyvista and the trial of rendering", seconds(drawn)],
            ["HTML page", f"{number(files['html_megabytes'])} MB"],
            ["glTF", f"{number(files['glb_megabytes'])} MB"],
            [
                f"{frames['segments']} segments, {renderer}",
                f"{number(frames['frames_per_second'])} frames per second",
            ],
        ],
    )


def known_start(found: Sequence[Row]) -> str:
    """Return success by what is known."""
    return table(
        ["group, pixels a side", *FITS], fits([r for r in found if "size" in r], "group", "size")
    )


def diffusers(found: Sequence[Row]) -> str:
    """Return correlation and agreement of halves, by method."""
    body = []
    for method in ("alternating", "hio", "raar"):
        own = [row[method] for row in found]
        scores = [row["correlation"] for row in own]
        body.append(
            [
                method,
                len(own),
                number(median(scores)),
                number(min(scores)),
                number(median(row["halves"] for row in own)),
                seconds(median(row["seconds"] for row in own)),
            ]
        )
    head = ["method", "fits", "median correlation", "lowest", "halves agree", "median run time"]
    return table(head, body)


def real_speckle(found: Row) -> str:
    """Return whether two halves of the restarts find the same picture."""
    head = ["measured data, method", "halves agree", "status", "run time"]
    return table(
        head,
        (
            [
                f"{row['object']}, {row['method']}",
                number(row["halves"]),
                row["status"],
                seconds(row["seconds"]),
            ]
            for row in found["retrieved"]
        ),
    )


def feasibility(found: Sequence[Row]) -> str:
    """Return what was predicted against what the fits reached."""
    body = []
    for said in (True, False):
        part = [row for row in found if row["predicted"] == said]
        reached = sum(row["correlation"] > 0.9 for row in part)
        body.append(
            [
                "recoverable" if said else "not recoverable",
                reached,
                len(part) - reached,
                seconds(median(row["feasibility_seconds"] for row in part)),
                seconds(median(row["seconds"] for row in part)),
            ]
        )
    head = ["predicted", "correlation of the fit above 0.9", "below 0.9"]
    head += ["median time of the verdict", "of the fit"]
    return table(head, body) + "\n" + forecast(found)


def forecast(found: Sequence[Row]) -> str:
    """Return how near the predicted correlations are, by their predicted spread."""
    body = []
    told = [row for row in found if row["correlation"] != 0.0]
    for name, low, high in (
        ("below 0.05", 0.0, 0.05),
        ("0.05 to 0.1", 0.05, 0.1),
        ("above 0.1", 0.1, 1.0),
    ):
        part = [row for row in told if low <= row["spread"] < high]
        if not part:
            continue
        off = [abs(row["score"] - row["correlation"]) for row in part]
        within = sum(d < row["spread"] for d, row in zip(off, part, strict=True))
        between = [d for d, row in zip(off, part, strict=True) if 0.3 < row["correlation"] < 0.95]
        body.append(
            [
                name,
                len(part),
                number(median(off)),
                f"{sum(d < 0.05 for d in between)} of {len(between)}",
                f"{within / len(part):.0%}",
            ]
        )
    body.append(["no object found", len(found) - len(told), "", "", ""])
    head = [
        "predicted spread",
        "fits",
        "median difference",
        "within 0.05, of fits with correlations of 0.3 to 0.95",
        "within the spread",
    ]
    return table(head, body)


def relay_modes(found: Sequence[Row]) -> str:
    """Return counts of modes next to those of brute force, by kind of occluder."""
    body = []
    for (kind,), part in grouped(found, "kind").items():
        off = [abs(row["modes"] - row["brute_force"]) / max(row["brute_force"], 1) for row in part]
        body.append(
            [
                kind,
                len(part),
                f"{min(row['brute_force'] for row in part)} to "
                f"{max(row['brute_force'] for row in part)}",
                f"{max(off):.0%}",
                seconds(median(row["cpu_seconds"] for row in part)),
                seconds(median(row["brute_force_cpu_seconds"] for row in part)),
            ]
        )
    head = ["occluder", "scenes", "modes", "largest difference", "CPU time", "of brute force"]
    return table(head, body)


def image_prior(found: Sequence[Row]) -> str:
    """Return correlation and seconds by wall and noise."""
    body = []
    for (wall, noise), part in grouped(found, "wall", "noise").items():
        scores = [row["deep_image_prior"] for row in part]
        body.append(
            [
                f"{wall}, {noise:.0%}",
                len(part),
                number(median(scores), 4),
                number(min(scores), 4),
                number(min(row["tv_deconvolve"] for row in part), 4),
                seconds(median(row["seconds"] for row in part)),
            ]
        )
    head = ["wall, noise", "fits", "median correlation", "lowest", "lowest of the guide"]
    head += ["median run time"]
    return table(head, body)


def peer_prior(found: Sequence[Row]) -> str:
    """Return one row a run."""
    body = ([r["method"], number(r["correlation"], 4), seconds(r["seconds"])] for r in found)
    return table(["method", "correlation", "run time"], body)


def wu2024(found: Sequence[Row]) -> str:
    """Return one row a run."""
    head = ["case", "correlation", "of the image itself", "status", "iterations", "run time"]
    return table(
        head,
        (
            [
                f"{row['object']}, wall of {row['rms']:g} waves rms, {row['size']} x {row['size']}",
                number(row["correlation"]),
                number(row["image"]),
                row["status"],
                row["iterations"],
                seconds(row["seconds"]),
            ]
            for row in found
        ),
    )


def wu2024_facets(found: Sequence[Row]) -> str:
    """Return one row a run."""
    head = ["case", "correlation", "with the true wall", "of the image itself", "status"]
    head += ["iterations", "run time"]
    body = (
        [
            f"{row['scene']}, {row['size']} x {row['size']}, blur of {row['blur']:.1f} pixels rms",
            number(row["correlation"]),
            number(row["known_wall"]),
            number(row["image"]),
            row["status"],
            row["iterations"],
            seconds(row["seconds"]),
        ]
        for row in found
    )
    return table(head, body)


def dense_meshes(found: Sequence[Row]) -> str:
    """Return milliseconds a pair of points and error, by mesh."""
    body = (
        [
            f"{row['pairing']}, {row['triangles']} triangles",
            f"{row['milliseconds_a_pair']:.0f} ms",
            number(row["l1_mean"], 2),
        ]
        for row in found
    )
    return table(["pairing of points, mesh", "time for one pair", "mean relative error"], body)


def phasor(found: Sequence[Row]) -> str:
    """Return overlap with the letter and seconds."""
    body = (
        [f"{r['wall']} x {r['wall']}, {r['method']}", number(r["iou"]), seconds(r["seconds"])]
        for r in found
    )
    return table(["sensor points, method", "overlap with the letter", "run time"], body)


def measured_charts(found: Sequence[Row]) -> str:
    """Return error of depth and seconds, by chart and method."""
    head = ["chart, method", "mean error of depth", "columns found"]
    head += ["run time", "run time, whole volume"]
    return table(
        head,
        (
            [
                f"{row['chart'].replace('_', ' ')}, {row['method']}",
                f"{row['mae_m'] * 1e3:.2f} mm",
                f"{row['coverage']:.0%} of columns",
                seconds(row["seconds"]),
                seconds(row.get("seconds_full")),
            ]
            for row in found
        ),
    )


def bounces(found: Sequence[Row]) -> str:
    """Return seconds and error, and the seconds to 1 % that they make."""
    head = ["program, reflections, samples", "run time", "median error", "largest error"]
    head += ["median time to 1 %"]
    return table(
        head,
        (
            [
                f"{row['name']}, {row['bounces']}, {row['samples']}",
                seconds(row["seconds"]),
                f"{row['l1_median']:.1%}",
                f"{row['l1_max']:.1%}",
                seconds(row["seconds_to_goal_median"]),
            ]
            for row in found
        ),
    )


def draw_series(series: dict[str, list[tuple[float, float]]], label: str) -> Any:
    """Draw seconds against error, a colour for each name."""
    drawn = figure(5.2, 4.4)
    axes = drawn.subplots()
    errors_against_seconds(axes, series, label)
    drawn.legend(loc="outside lower center", ncols=2)
    return drawn


def traces(found: Row) -> str:
    """Return what each program takes to each error, scene by scene, and what the ratios are."""
    scenes = found["scenes"]
    goals = [f"{100 * goal:g} %" for goal in scenes[0]["goals"]]
    head = ["scene", "program", *(f"time to {goal}" for goal in goals)]
    body = [
        [scene["scene"], name, *map(seconds, times)]
        for scene in scenes
        for name, times in scene["seconds_to"].items()
    ]
    spans = []
    for goal, ratios in zip(
        goals, zip(*(scene["ratios"] for scene in scenes), strict=True), strict=True
    ):
        least, most = number(min(ratios)), number(max(ratios))
        spans.append(f"{least} to {most} times the time to {goal}")
    apart = max(abs(a) for scene in scenes for a in scene["standard_errors_apart"].values())
    return (
        f"{table(head, body)}\nMitsuba in its better way takes {' and '.join(spans)}. The mean "
        f"fluxes of the two programs differ by at most {number(apart, 2)} standard errors.\n"
    )


def draw_traces(found: Row) -> Any:
    """Draw a line for each program, a panel a scene."""
    drawn = figure(8.5, 7.0)
    panels = drawn.subplots(2, 2, sharex=True, sharey=True)
    for axes, ((scene,), part) in zip(
        panels.flat, grouped(found["rows"], "scene").items(), strict=True
    ):
        series = {
            name: [(row["seconds"], row["relative_error"]) for row in rows_of]
            for (name,), rows_of in grouped(part, "name").items()
        }
        errors_against_seconds(axes, series, "relative standard deviation")
        axes.set(title=scene, xlabel="processor time (s)")
        axes.label_outer()
    drawn.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return drawn


def draw_tolerances(found: Sequence[Row]) -> Any:
    """Draw a line for each stage."""
    groups = grouped(found, "stage").items()
    return draw_series(
        {name: [(row["seconds"], row["error"]) for row in part] for (name,), part in groups},
        "relative error",
    )


def draw_peer_prior(found: Sequence[Row]) -> Any:
    """Draw a point for ours and a line for deepinv's numbers of steps."""
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in found:
        series[row["method"].split()[0]].append((row["seconds"], 1 - row["correlation"]))
    return draw_series(dict(series), "1 - correlation")


def draw_bounces(found: Sequence[Row]) -> Any:
    """Draw each program's median error."""
    series = {
        f"{name}, {count} bounces": [(row["seconds"], row["l1_median"]) for row in part]
        for (name, count), part in grouped(found, "name", "bounces").items()
    }
    return draw_series(series, "relative L1 error of a sensor, median")


def draw_measured_charts(found: Sequence[Row]) -> Any:
    """Draw a point for each method, a panel a chart."""
    drawn = figure(8.5, 3.6)
    panels = drawn.subplots(1, 2, sharex=True, sharey=True)
    for axes, ((chart,), part) in zip(panels, grouped(found, "chart").items(), strict=True):
        errors_against_seconds(
            axes,
            {row["method"]: [(row["seconds"], row["mae_m"] * 1e3)] for row in part},
            "mean error of depth (mm)",
        )
        axes.set(title=chart.replace("_", " "), yscale="linear")
        axes.set_ylim(bottom=0)
        axes.label_outer()
    drawn.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return drawn


RUN = "python benchmarks"
SECTIONS = (
    Section(
        "psf_peers.json",
        "Point spreads compared with other programs",
        "Run time of each program for one point spread of 256 x 256 samples, on one thread. Each "
        "program has its fastest setting that keeps the error below the value in the first "
        "column; its set-up is not timed. The error that it reaches is in parentheses: the "
        "largest difference of any sample from an accurate reference, relative to the peak.",
        f"{RUN}/psf_peers.py --json benchmarks/results/psf_peers.json",
        psf_peers,
        draw_psf_peers,
        "Seconds against error of point spreads by five programs, for 0, 1, 10 and 100 waves",
    ),
    Section(
        "psf_pupils.json",
        "Point spreads of vaned and segmented pupils",
        "As in the previous table, for one wave of aberration on two other pupils: a ring with "
        "four vanes (spider), as of a reflecting telescope, and a mirror of 19 hexagonal segments. "
        "The other programs store a pupil as the fraction of each sample that is inside. Optiland "
        "is not compared.",
        f"{RUN}/psf_peers.py --case spider --case '19 hexagons' --samples 1024 "
        "--json benchmarks/results/psf_pupils.json",
        psf_peers,
        draw_psf_peers,
        "Seconds against error of point spreads of a spider and of 19 hexagons by three programs",
    ),
    Section(
        "psf_study.json",
        "Choice and error estimate of `point_spread`",
        'How often does `method="auto"` keep the requested error `tol`, and how good are its '
        "error estimate and its predicted run time? Random waves, pupils, samplings and tolerances "
        "were compared with a reference that shares no code with the transforms. A refusal is an "
        "error message in place of a result.",
        f"{RUN}/psf_study.py --max-seconds 20 --json benchmarks/results/psf_study.json",
        psf_study,
        draw_psf_study,
        "Error and estimate over the requested error, against seconds: errors all lie below one",
    ),
    Section(
        "trace_coverage.jsonl",
        "Intervals of traced light",
        "Are the standard errors of traced light right? Each scene was traced 300 times with "
        "1,024 rays. The table states how often the true flux lies within one and two standard "
        "errors, which should be 68 % and 95 % of the traces; the true flux is that of a trace "
        "with 262,144 rays. It also states how often a trace calls its own error uncertain. The "
        "last two columns name the number of reflections whose light has the least reliable "
        "error, and how often this light lies within two standard errors. A share of 95 % is "
        "itself known to 1.3 %.",
        f"{RUN}/trace_coverage.py --json benchmarks/results/trace_coverage.jsonl",
        coverage,
    ),
    Section(
        "whole_run.json",
        "Whole commands",
        "Run time of commands from start to exit, on two idle cores. In the first case all "
        "functions must be compiled; in the others, their compiled code is on the disk. The last "
        "case is one call in a Python process that is already running. Processor time is summed "
        "over all cores.",
        f"{RUN}/whole_run.py --repeats 3 --json benchmarks/results/whole_run.json",
        whole_runs,
    ),
    Section(
        "traces.json",
        "Ray tracing compared with Mitsuba 3",
        "Processor time to compute the light that reaches the lens from a hidden object by way of "
        "a wall, with three reflections. The error is the standard deviation of the detected flux "
        "over independent runs, relative to its mean; it falls with the number of rays. Both "
        "programs ran on one thread, in turns. Mitsuba has two ways: paths from the camera that "
        "are connected to the lit spot, and light from a projector that is aimed at the object. "
        "Times follow from a power law fitted to the runs; those beyond the longest run are "
        "extrapolated.",
        f"{RUN}/traces.py --peers-python PEER/bin/python --json benchmarks/results/traces.json",
        traces,
        draw_traces,
        "Processor time against error of traced flux by nlosoptics and Mitsuba, in four scenes",
    ),
    Section(
        "tolerances.json",
        "What a tolerance costs",
        "How much longer does a more accurate result take? Point spreads over the object (fields) "
        "and traced light were computed with two tolerances `tol`. The estimate is the error that "
        "the result states, the error its difference from an accurate reference.",
        f"{RUN}/tolerances.py --json benchmarks/results/tolerances.json",
        tolerances,
        draw_tolerances,
        "Seconds against error of fields of point spreads and of traces at two tolerances",
    ),
    Section(
        "psf_batches.json",
        "Many waves on one pupil",
        "Processor time per wave for point spreads of 256 x 256 samples with a pitch of lambda "
        "N/4. The batch is one call of `psf.point_spreads`, including its set-up; the gradient is "
        "the additional time for it. It is compared with a loop of `psf.point_spread`, and with a "
        "loop of matrix products in numpy on a pupil of 256 x 256 samples, or 1024 x 1024 for the "
        "smaller tolerance. Errors are relative to the peak. With two threads, each computes half "
        "of the waves.",
        f"{RUN}/psf_batches.py --json benchmarks/results/psf_batches.json",
        psf_batches,
    ),
    Section(
        "growth.json",
        "Growth with pixels and field points",
        "How do time and memory grow with the size of a task? The table has the processor time of "
        "all threads and the memory of numpy's arrays, for one call after all functions are "
        "compiled. The exponents are fitted to four sizes. If an exponent is below 1, a part of "
        "the work does not depend on the size.",
        f"{RUN}/growth.py --json benchmarks/results/growth.json",
        growth,
    ),
    Section(
        "rough_walls.json",
        "Rough walls: the mean against random walls",
        "The point spread of a rough wall, averaged over all walls, has a closed form. Here it is "
        "compared with the average of 2048 random walls, in rings that contain equal light. The "
        "table has the run time of the mean and of one wall, and the largest difference of a ring "
        "next to that expected by chance. The last column states how the difference falls with the "
        "number n of walls; chance alone gives n^-0.5.",
        f"{RUN}/rough_walls.py",
        rough_walls,
    ),
    Section(
        "rough_facets.json",
        "Walls of facets: the mean against random walls",
        "The same comparison for walls of flat facets: the closed-form mean, and the average of "
        "1,000 random walls in 8 rings of equal width. The last columns are the largest standard "
        "error of a ring, relative to its light, and the largest deviation, in standard errors. By "
        "chance alone, the largest of all 64 deviations exceeds 2.5 standard errors in half of "
        "such runs.",
        f"{RUN}/rough_facets.py --json benchmarks/results/rough_facets.json",
        rough_facets,
    ),
    Section(
        "known_psf.jsonl",
        "Reconstruction, point spread known",
        "How well do the solvers find the object if the wall is known? The images have 128 x 128 "
        "pixels, are blurred by smooth and by speckled point spreads, and have 1 % or 5 % noise. "
        "They are computed by another model than the one that the solvers invert. The correlation "
        "is that of the result with the true object. scikit-image's solvers run with the best of "
        "the settings tried.",
        f"{RUN}/inverse/known_psf.py --json benchmarks/results/known_psf.jsonl",
        known_psf,
    ),
    Section(
        "mismatches.jsonl",
        "Status, point spread known",
        "Does the status of a reconstruction show that the model is wrong? In each row, the "
        "image differs from the model of `tv_deconvolve` in another way (mismatch): the optics "
        "have another aberration or size of blur, the camera is not linear or saturates, there "
        "is stray light, or the noise is not that of independent pixels. Some images show "
        "nothing of the scene, but noise, speckle or another object. "
        "`benchmarks/inverse/mismatches.py` describes each row. The three columns on the right "
        "sort the results by their correlation with the true object, and state how many of them "
        'have the status "converged": few should on the left, most on the right. Images have 64 '
        "x 64 pixels and 0.5 to 10 % noise. None of them was used to set the limits of the tests.",
        f"{RUN}/inverse/mismatches.py --json benchmarks/results/mismatches.jsonl --first 700000 "
        f"--cases 220; {RUN}/inverse/mismatches.py --json benchmarks/results/mismatches.jsonl "
        "--first 800000 --cases 200 --kinds white_noise exponential_noise photon_noise "
        "unblurred_picture blobs other_speckle other_wall",
        mismatches,
    ),
    Section(
        "image_prior.jsonl",
        "Untrained networks, point spread known",
        "`deep_image_prior` on images like those of the table for known point spreads. The guide "
        "is the result of `tv_deconvolve`, which is the input of the network.",
        f"{RUN}/inverse/image_prior.py --json benchmarks/results/image_prior.jsonl",
        image_prior,
    ),
    Section(
        "peer_prior.jsonl",
        "Untrained networks compared with deepinv",
        "A letter by way of a smooth wall, with 1 % noise. Both programs use the image model of "
        "this library.",
        f"PEER/bin/{RUN}/inverse/peer_prior.py --json benchmarks/results/peer_prior.jsonl",
        peer_prior,
        draw_peer_prior,
        "Seconds against one minus correlation: nlosoptics, and deepinv after 250, 1000 and 2500 "
        "steps",
    ),
    Section(
        "evidence_two_frames.jsonl",
        "Wall unknown, two frames",
        "How often does `evidence_fit` find object and wall from two images (frames), of which the "
        "second has a known defocus? The fits start from random walls; images have 64 x 64 pixels. "
        "The columns count the fits, those whose object has a correlation above 0.9 with the true "
        'object, and those with a lower correlation that wrongly have the status "converged". '
        "None of the walls was used to tune the fit.",
        f"{RUN}/inverse/evidence.py --frames 2 --rms 0.25 0.5 1.0 "
        "--json benchmarks/results/evidence_two_frames.jsonl",
        evidence,
    ),
    Section(
        "evidence_one_frame.jsonl",
        "Wall unknown, one frame",
        "`evidence_fit` for a single image (frame), otherwise as for two; five walls and three "
        "objects for each strength. If a start without blur leads to the truth, a fit takes a "
        "second.",
        f"{RUN}/inverse/evidence.py --frames 1 --rms 0.25 0.5 --walls 113 117 "
        "--json benchmarks/results/evidence_one_frame.jsonl",
        evidence,
    ),
    Section(
        "known_start.jsonl",
        "Wall roughly known, or several walls",
        "`evidence_fit` with additional knowledge. The groups are: near10 and near25, one image, "
        "and a wave that is known to within 0.10 or 0.25 wavelengths rms; support, as near10, and "
        "the object is known to be dark outside a mask; noise5, as near10, with 5 % noise; "
        "diversity3, three images with different known defoci; walls4, images by way of four "
        "unknown walls; calibrate, the wall is first found from a known object.",
        f"{RUN}/inverse/known_start.py --json benchmarks/results/known_start.jsonl --sizes 64 "
        "--walls 1 --groups near10 near25 support diversity3 walls4 calibrate noise5",
        known_start,
    ),
    Section(
        "diffusers.jsonl",
        "Phase retrieval behind diffusers",
        "Objects from the autocorrelation of one simulated speckle image of 512 x 512 pixels. "
        '"Halves agree" is the correlation between the results of two halves of the random '
        "starts; it needs no knowledge of the object.",
        f"{RUN}/inverse/diffusers.py --walls 2 --json benchmarks/results/diffusers.jsonl",
        diffusers,
    ),
    Section(
        "real_speckle.json",
        "Phase retrieval from measured speckle",
        "Measured images of Metzler 2020. The true objects are not known. The only test is the "
        "correlation between the results of two independent halves of the random starts.",
        f"{RUN}/inverse/real_speckle.py --json benchmarks/results/real_speckle.json",
        real_speckle,
    ),
    Section(
        "feasibility.jsonl",
        "Verdicts before the fit",
        "Does `limits.feasibility` predict correctly whether an object can be reconstructed? "
        "Random scenes of 64 x 64 pixels, none of them used to set the constants of the forecast, "
        "were reconstructed by `tv_deconvolve` with the point spread known. The second table has "
        "the differences between the predicted correlation and that of the fit.",
        f"{RUN}/inverse/feasibility.py --json benchmarks/results/feasibility.jsonl",
        feasibility,
    ),
    Section(
        "relay_modes.jsonl",
        "Modes of diffuse light past occluders",
        "Shadows of an occluder add detail to diffuse light. Modes are the independent patterns of "
        "the object that exceed the noise. Their number by `limits.feasibility` is compared with a "
        "count of singular values of the full matrix from object to image (brute force). The "
        "random scenes have a matt wall, every third one with a wide mirror-like lobe too.",
        f"{RUN}/relay_modes.py --scenes 6 --json benchmarks/results/relay_modes.jsonl",
        relay_modes,
    ),
    Section(
        "wu2024.jsonl",
        "PCIN as published",
        "The physics-constrained inverse network (PCIN) of Wu 2024 fits object and wall to one "
        "image, from random angles of the wall. Here the fitted object is the blurred image "
        'itself, which the status "trivial" states.',
        f"{RUN}/inverse/wu2024.py --walls 1 --rms 0.25 --objects F --size 512 "
        "--json benchmarks/results/wu2024.jsonl",
        wu2024,
    ),
    Section(
        "wu2024_facets.jsonl",
        "PCIN as published, with facets",
        "As above, with a wall of facets and the geometry of the paper (F/2, pixels of 72 um, 40 "
        "ms, 512 x 512). The image is a simulated one. The fit has a pair of exit angles for each "
        "facet that the lens sees. It starts from random angles that blur as much as the wall "
        'does. "With the true wall" is the correlation of `tv_deconvolve` with the true point '
        "spread. The fitted object is the image itself.",
        f"{RUN}/inverse/wu2024.py --scene examples/scenes/letter_rough.toml --size 512 "
        "--json benchmarks/results/wu2024_facets.jsonl",
        wu2024_facets,
    ),
    Section(
        "dense_meshes.jsonl",
        "Three bounces with meshes of many triangles",
        "Time-resolved light from a mesh of a dragon in a corridor, for one pair of laser and "
        "sensor point, with a tolerance of 1 % and one thread. The error is the difference from a "
        "run with a thirtieth of this tolerance.",
        f"{RUN}/transient/dense_meshes.py --json benchmarks/results/dense_meshes.jsonl",
        dense_meshes,
    ),
    Section(
        "bounces.jsonl",
        "Four and five bounces compared with mitransient",
        "Time-resolved light with four and five reflections, from a letter in a corridor, at 32 x "
        "32 sensor points in bins of 1 cm. The error of a sensor point is the sum of absolute "
        "differences between two runs with different seeds, relative to the light, divided by the "
        "square root of 2. The last column is the time to an error of 1 %. It is computed from "
        "time and error, which falls with the square root of the samples.",
        f"{RUN}/transient/bounces.py --peer-python PEER/bin/python "
        "--json benchmarks/results/bounces.jsonl",
        bounces,
        draw_bounces,
        "Seconds against the error of a sensor point: nlosoptics lies far below mitransient",
    ),
    Section(
        "phasor.json",
        "Phasor fields compared with y-tal",
        "Images of a letter 1 m from the wall, with one laser point. The overlap with the letter "
        "is intersection over union (1: perfect), at the best threshold of brightness. Times are "
        "those of one call, including its set-up.",
        f"{RUN}/transient/phasor.py --peer-python PEER/bin/python "
        "--json benchmarks/results/phasor.json",
        phasor,
    ),
    Section(
        "measured_charts.json",
        "Measured charts at known depths",
        "Depths from measured confocal captures of O'Toole 2018. The objects are flat charts 40 "
        "and 65 cm from the wall.",
        f"{RUN}/transient/measured.py --data DIR --peer-python PEER/bin/python "
        "--json benchmarks/results/measured_charts.json",
        measured_charts,
        draw_measured_charts,
        "Seconds against mean error of depth of six methods on two measured charts",
    ),
    Section(
        "studies.json",
        "Design studies on up to 1,000 workers",
        "How many processes can compute a study at the same time? One client process sends "
        "blocks of points to the workers and writes their results to the store. The first row is "
        "measured with a real worker. In the others the workers only wait as long as a block "
        "would take; client, messages and store are real. The share is the throughput divided by "
        "that of workers that never wait for the client.",
        f"{RUN}/studies.py --memory /dev/shm --json benchmarks/results/studies.json",
        studies,
    ),
    Section(
        "fast_tier.json",
        "Tolerance draws by expanded waves",
        'The yield is the share of random draws that meet a limit. With `tier = "fast"`, each '
        "draw is computed from a Taylor series of second order, and the yield is corrected by 400 "
        'draws that are computed in full. The columns "in full" and "fast" are yields of the '
        "same 2,000 draws. The last columns are the corrected yield of all 10,000 draws and its 95 "
        "% interval.",
        f"{RUN}/studies.py --fast --json benchmarks/results/fast_tier.json",
        fast_tier,
    ),
    Section(
        "views.json",
        "Pictures in three dimensions",
        "A room with a wavy wall and 500 light paths. If the table names no graphics card, the "
        "pictures were rendered by the processor. HTML pages and glTF models are written without "
        "rendering.",
        f"{RUN}/views.py",
        pictures,
    ),
)
