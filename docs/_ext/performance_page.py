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
        In ``benchmarks/results``.
    title, text : str
    command : str
        That wrote the file.
    body : callable
        Takes what the file holds, returns Markdown.
    draw : callable, optional
        Takes the same, returns a figure.
    alternative : str
        What the figure shows, for who cannot see it.
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


TRACE_GOALS = (0.01, 0.001)
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
    return table(["seconds (error)", *PROGRAMS], body)


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
        ["of these: error within tol", f"{found['within_tol']:.1%}"],
        ["estimate bounds the error", f"{found['bounded']:.1%}"],
        ["estimate over error, median", number(found["median_overstatement"])],
        ["refused", f"{found['refused']:.1%}"],
        ["refused without a remedy", found["refusals_without_remedy"]],
        ["remedies tried, failed", f"{found['remedies_tried']}, {found['remedies_failed']}"],
        ["seconds over predicted, median", number(found["median_seconds_over_predicted"])],
        ["predicted within a factor of three", f"{found['seconds_within_three']:.1%}"],
        ["longest", f"{found['longest_seconds']:g} s"],
    ]
    return table(["figure", "found"], body)


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
    head = ["stage", "tol", "seconds", "estimate", "error", "work"]
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
    head = ["scene", "error", "68 % holds", "95 % holds", "uncertain", "worst bounce", "95 % holds"]
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
    head = ["figure", "limit", "in full", "fast", "draws that differ", "corrected", "interval"]
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
        "a block",
        "client's CPU, a point",
        "client's cores",
        "blocks a second",
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
        "rms, waves",
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
    head = ["stage", "number n", "seconds", "grow as", "memory", "grows as"]
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
    head = ["angle, phase rms", "mean", "one wall", "differ", "by chance", "falls with walls as"]
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
    head = ["angle, phase rms", "mean", "one wall", "standard error", "largest deviation"]
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
    return table(["method, noise", "median correlation", "least", "median seconds"], body)


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


FITS = ["cases", "above 0.9", "converged, not above 0.9", "median correlation", "median seconds"]


def evidence(found: Sequence[Row]) -> str:
    """Return success by the wall's strength."""
    return table(["wall, waves rms", *FITS], sorted(fits(found, "rms")))


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
    head = ["method", "cases", "median correlation", "least", "halves agree", "median seconds"]
    return table(head, body)


def real_speckle(found: Row) -> str:
    """Return whether two halves of the restarts find the same picture."""
    head = ["measured data, method", "halves agree", "status", "seconds"]
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
    head = ["predicted", "fit above 0.9", "fit below", "seconds of the verdict", "of the fit"]
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
        "within 0.05, fits of 0.3 to 0.95",
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
    head = ["occluder", "scenes", "modes", "largest difference", "CPU s", "of brute force"]
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
    head = ["wall, noise", "fits", "median correlation", "least", "least, guide", "median seconds"]
    return table(head, body)


def peer_prior(found: Sequence[Row]) -> str:
    """Return one row a run."""
    body = ([r["method"], number(r["correlation"], 4), seconds(r["seconds"])] for r in found)
    return table(["method", "correlation", "seconds"], body)


def wu2024(found: Sequence[Row]) -> str:
    """Return one row a run."""
    head = ["case", "correlation", "of the image itself", "status", "iterations", "seconds"]
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
    head += ["iterations", "seconds"]
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
    return table(["pairs, mesh", "one pair of points", "relative L1 error, mean"], body)


def phasor(found: Sequence[Row]) -> str:
    """Return overlap with the letter and seconds."""
    body = (
        [f"{r['wall']} x {r['wall']}, {r['method']}", number(r["iou"]), seconds(r["seconds"])]
        for r in found
    )
    return table(["sensors, method", "overlap with the letter", "seconds"], body)


def measured_charts(found: Sequence[Row]) -> str:
    """Return error of depth and seconds, by chart and method."""
    head = ["chart, method", "mean error of depth", "over", "seconds", "seconds, whole volume"]
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
    head = ["program, bounces, samples", "seconds", "error, median", "at worst", "to 1 %, median"]
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


def traces(found: Sequence[Row]) -> str:
    """Return what each program and setting takes to two errors."""
    head = ["seconds", *(f"to {100 * goal:g} %" for goal in TRACE_GOALS)]
    body = []
    three = [row for row in found if row.get("reflections", 3) == 3]
    for (name,), part in grouped(three, "name").items():
        cells = []
        for goal in TRACE_GOALS:
            times = [row.get("seconds_to", {}).get(str(goal)) for row in part]
            times += [row["seconds"] for row in part if row.get("relative_error", 1.0) <= goal]
            known = [time for time in times if time is not None]
            cells.append(seconds(min(known)) if known else "not reached")
        body.append([name, *cells])
    return table(head, body)


def draw_traces(found: Sequence[Row]) -> Any:
    """Draw a line for each program and setting that was measured."""
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in found:
        if row.get("reflections") == 3 and "seconds" in row:
            series[row["name"]].append((row["seconds"], row["relative_error"]))
    return draw_series(dict(series), "relative standard deviation of the flux")


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
        "Point spreads beside their peers",
        "Each program with its fastest setting that reaches the error in the first column. Its "
        "set-up is not timed; 256 x 256 image samples, error as max |dI|/max I, one thread.",
        f"{RUN}/psf_peers.py --json benchmarks/results/psf_peers.json",
        psf_peers,
        draw_psf_peers,
        "Seconds against error of point spreads by five programs, for 0, 1, 10 and 100 waves",
    ),
    Section(
        "psf_pupils.json",
        "Point spreads of vaned and segmented pupils",
        "Each program with its fastest setting that reaches an error, for one wave of aberration "
        "on a ring with four vanes and on 19 hexagons. The other programs store the pupil as the "
        "fraction of each sample inside it. Optiland is not compared.",
        f"{RUN}/psf_peers.py --case spider --case '19 hexagons' --samples 1024 "
        "--json benchmarks/results/psf_pupils.json",
        psf_peers,
        draw_psf_peers,
        "Seconds against error of point spreads of a spider and of 19 hexagons by three programs",
    ),
    Section(
        "psf_study.json",
        "Choice and error estimate of `point_spread`",
        "Random waves, apertures, nodes and tolerances, each judged against a reference that "
        "shares no code with the transforms.",
        f"{RUN}/psf_study.py --max-seconds 20 --json benchmarks/results/psf_study.json",
        psf_study,
        draw_psf_study,
        "Error and estimate over the requested error, against seconds: errors all lie below one",
    ),
    Section(
        "trace_coverage.jsonl",
        "Intervals of traced light",
        "How often the flux of 300 traces with 1,024 rays lies within its intervals about that of "
        "a trace with 262,144 rays, and how often a trace calls it uncertain; then the number of "
        "reflections whose interval holds least. The standard error of a share is 1.3 % at 95 %.",
        f"{RUN}/trace_coverage.py --json benchmarks/results/trace_coverage.jsonl",
        coverage,
    ),
    Section(
        "whole_run.json",
        "Whole commands",
        "Commands from start to exit, on two idle cores. The first case starts with an empty cache "
        "of compiled kernels; the others find it filled. The last case is one call in a process "
        "that is already running.",
        f"{RUN}/whole_run.py --repeats 5 --json benchmarks/results/whole_run.json",
        whole_runs,
    ),
    Section(
        "traces.json",
        "Traces beside Mitsuba 3 and Optiland",
        "Light from a letter that reaches the lens by a matt wall, with different numbers of rays "
        "or samples; the error is the relative standard deviation of the detected flux. All "
        "programs ran with two threads, except Optiland, which uses one core; its time is "
        "extrapolated from its rate of rays. Values have two digits: they were read off a figure.",
        f"{RUN}/traces.py --peers-python PEER/bin/python --json benchmarks/results/traces.json",
        traces,
        draw_traces,
        "Seconds against error of traced flux: nlosoptics has the least error at any time",
    ),
    Section(
        "tolerances.json",
        "What a tolerance costs",
        "Fields of point spreads and traced light at two tolerances.",
        f"{RUN}/tolerances.py --json benchmarks/results/tolerances.json",
        tolerances,
        draw_tolerances,
        "Seconds against error of fields of point spreads and of traces at two tolerances",
    ),
    Section(
        "psf_batches.json",
        "Many waves on one pupil",
        "`psf.point_spreads` with 256 x 256 samples at lambda N/4: processor time per wave, with "
        "the set-up of the call, and that of the gradient; a loop of `psf.point_spread`; and a "
        "loop of matrix products of numpy on a pupil of 256 x 256 samples, 1024 x 1024 for the "
        "smaller tol. A batch bounds its error for any wave. Two threads share the waves.",
        f"{RUN}/psf_batches.py --json benchmarks/results/psf_batches.json",
        psf_batches,
    ),
    Section(
        "growth.json",
        "Growth with pixels and field points",
        "Processor time of all threads and memory of numpy's arrays, of one call after a first one "
        "that compiles. Exponents are fitted to four sizes; below 1, a part of the work does not "
        "depend on the size.",
        f"{RUN}/growth.py --json benchmarks/results/growth.json",
        growth,
    ),
    Section(
        "rough_walls.json",
        "Rough walls: the mean against drawn walls",
        "Closed-form mean and the average of 2048 drawn walls, in rings of equal light; the last "
        "column is how their difference falls with the number n of walls, by chance n^-0.5.",
        f"{RUN}/rough_walls.py",
        rough_walls,
    ),
    Section(
        "rough_facets.json",
        "Walls of facets: the mean against drawn walls",
        "Closed-form mean and the average of 1,000 drawn walls in 8 rings of equal width. The last "
        "columns are the largest standard error of a ring and the largest deviation in standard "
        "errors. By chance the largest of all 64 exceeds 2.5 in half of such runs.",
        f"{RUN}/rough_facets.py --json benchmarks/results/rough_facets.json",
        rough_facets,
    ),
    Section(
        "known_psf.jsonl",
        "Reconstruction, point spread known",
        "Images of objects blurred by smooth and by speckled point spreads, 128 x 128 pixels. The "
        "images are not computed by the model that is inverted. scikit-image's solvers run with "
        "the best of the settings tried.",
        f"{RUN}/inverse/known_psf.py --json benchmarks/results/known_psf.jsonl",
        known_psf,
    ),
    Section(
        "mismatches.jsonl",
        "Status, point spread known",
        "How many answers of `tv_deconvolve` have the status converged, of those with the "
        "correlation in the heading; 64 x 64 pixels, noise of 0.5 to 10 %. The seeds are not those "
        "with which the limits of the tests were set. Some images show nothing of the scene.",
        f"{RUN}/inverse/mismatches.py --json benchmarks/results/mismatches.jsonl --first 500000 "
        f"--cases 220; {RUN}/inverse/mismatches.py --json benchmarks/results/mismatches.jsonl "
        "--first 600000 --cases 200 --kinds white_noise exponential_noise photon_noise "
        "unblurred_picture blobs other_speckle other_wall",
        mismatches,
    ),
    Section(
        "image_prior.jsonl",
        "Untrained networks, point spread known",
        "`deep_image_prior` on images like those of `tv_deconvolve` above. The guide is the answer "
        "by total variation, which is the input of the network.",
        f"{RUN}/inverse/image_prior.py --json benchmarks/results/image_prior.jsonl",
        image_prior,
    ),
    Section(
        "peer_prior.jsonl",
        "Untrained networks beside deepinv",
        "A letter by a smooth wall, 1 % noise, both on our operator.",
        f"PEER/bin/{RUN}/inverse/peer_prior.py --json benchmarks/results/peer_prior.jsonl",
        peer_prior,
        draw_peer_prior,
        "Seconds against one minus correlation: ours, and deepinv after 250, 1000 and 2500 steps",
    ),
    Section(
        "evidence_two_frames.jsonl",
        "Wall unknown, two frames",
        "`evidence_fit` from random starts, the second frame with a known defocus, 64 x 64 pixels, "
        "walls that were not used in tuning.",
        f"{RUN}/inverse/evidence.py --frames 2 --rms 0.25 0.5 1.0 "
        "--json benchmarks/results/evidence_two_frames.jsonl",
        evidence,
    ),
    Section(
        "evidence_one_frame.jsonl",
        "Wall unknown, one frame",
        "`evidence_fit` for a single frame, otherwise as for two frames.",
        f"{RUN}/inverse/evidence.py --frames 1 --rms 0.25 0.5 --jobs 2 "
        "--json benchmarks/results/evidence_one_frame.jsonl",
        evidence,
    ),
    Section(
        "known_start.jsonl",
        "Wall roughly known, or several walls",
        "near10, near25: one image, start 0.10, 0.25 waves off; support: near10 with a known dark "
        "surround; diversity3: nothing known, three defoci; walls4: nothing known, four walls; "
        "calibrate: the wall from a known object first; noise5: near10 at 5 % noise.",
        f"{RUN}/inverse/known_start.py --json benchmarks/results/known_start.jsonl --sizes 64 "
        "--walls 1 --groups near10 near25 support diversity3 walls4 calibrate noise5",
        known_start,
    ),
    Section(
        "diffusers.jsonl",
        "Phase retrieval behind diffusers",
        "Objects from the autocorrelation of one speckled frame of 512 x 512 pixels.",
        f"{RUN}/inverse/diffusers.py --walls 2 --json benchmarks/results/diffusers.jsonl",
        diffusers,
    ),
    Section(
        "real_speckle.json",
        "Phase retrieval from measured speckle",
        "Exposures of Metzler 2020; there is no ground truth, only whether two independent halves "
        "of the restarts find one picture.",
        f"{RUN}/inverse/real_speckle.py --json benchmarks/results/real_speckle.json",
        real_speckle,
    ),
    Section(
        "feasibility.jsonl",
        "Verdicts before the fit",
        "Random scenes of 64 x 64 pixels, none of them used in setting the constants of the "
        "forecast. The fit is `tv_deconvolve` with the point spread known. Differences are those "
        "between the predicted and the reached correlation.",
        f"{RUN}/inverse/feasibility.py --json benchmarks/results/feasibility.jsonl",
        feasibility,
    ),
    Section(
        "relay_modes.jsonl",
        "Modes of diffuse light past occluders",
        "Random scenes with a matt wall, every third with a wide mirror-like lobe too. The number "
        "of modes by `limits.feasibility` is compared with singular values of the whole matrix.",
        f"{RUN}/relay_modes.py --scenes 6 --json benchmarks/results/relay_modes.jsonl",
        relay_modes,
    ),
    Section(
        "wu2024.jsonl",
        "PCIN as published",
        "From random angles and one image: the fit ends at the image itself, as its status says.",
        f"{RUN}/inverse/wu2024.py --walls 1 --rms 0.25 --objects F --size 512 "
        "--json benchmarks/results/wu2024.jsonl",
        wu2024,
    ),
    Section(
        "wu2024_facets.jsonl",
        "PCIN as published, with facets",
        "The paper's geometry (F/2, pixels of 72 um, 40 ms, 512 x 512) and a wall of facets. The "
        "simulator makes the image. The fit has a pair of exit angles for each facet that the lens "
        "sees, and starts from random angles as strong as the wall's blur. For comparison, total "
        "variation with the wall's point spread. The image itself is the letter with noise, and "
        "the fit ends there.",
        f"{RUN}/inverse/wu2024.py --scene examples/scenes/letter_rough.toml --size 512 "
        "--json benchmarks/results/wu2024_facets.jsonl",
        wu2024_facets,
    ),
    Section(
        "dense_meshes.jsonl",
        "Three bounces off dense meshes",
        "A dragon in a corridor, tolerance 1 %, one thread. The reference of the error is a run "
        "with a thirtieth of this tolerance.",
        f"{RUN}/transient/dense_meshes.py --json benchmarks/results/dense_meshes.jsonl",
        dense_meshes,
    ),
    Section(
        "bounces.jsonl",
        "Four and five bounces beside mitransient",
        "A letter in a corridor, 32 x 32 sensors, bins of 1 cm; error is the relative L1 "
        "difference of independent seeds over the root of 2. The last column follows from seconds "
        "and error, which falls as the root of the samples.",
        f"{RUN}/transient/bounces.py --peer-python PEER/bin/python "
        "--json benchmarks/results/bounces.jsonl",
        bounces,
        draw_bounces,
        "Seconds against the error of a sensor: nlosoptics lies far below mitransient",
    ),
    Section(
        "phasor.json",
        "Phasor fields beside y-tal",
        "A letter at 1 m, one laser point; overlap is the intersection over union at its best "
        "threshold, seconds are those of a call including its set-up.",
        f"{RUN}/transient/phasor.py --peer-python PEER/bin/python "
        "--json benchmarks/results/phasor.json",
        phasor,
    ),
    Section(
        "measured_charts.json",
        "Measured charts at known depths",
        "Confocal captures of O'Toole 2018, charts 40 and 65 cm from the wall.",
        f"{RUN}/transient/measured.py --data DIR --peer-python PEER/bin/python "
        "--json benchmarks/results/measured_charts.json",
        measured_charts,
        draw_measured_charts,
        "Seconds against mean error of depth of six methods on two measured charts",
    ),
    Section(
        "studies.json",
        "Design studies on up to 1,000 workers",
        "A real worker process, then workers that wait as long as a point would take, with the "
        "client, its store and the messages real. The share is the throughput over that of workers "
        "that never wait.",
        f"{RUN}/studies.py --memory /dev/shm --json benchmarks/results/studies.json",
        studies,
    ),
    Section(
        "fast_tier.json",
        "Tolerance draws by expanded waves",
        "Yields of 10,000 draws from waves expanded to second order, corrected by 400 draws in "
        "full. Yields in full and fast are of the same 2,000 draws; the last columns are the "
        "corrected yield of all draws and its interval of 95 %.",
        f"{RUN}/studies.py --fast --json benchmarks/results/fast_tier.json",
        fast_tier,
    ),
    Section(
        "views.json",
        "Pictures in three dimensions",
        "A wavy wall's room with 500 light paths, rendered in software where no graphics card is "
        "named; pages and models are written without rendering.",
        f"{RUN}/views.py",
        pictures,
    ),
)
