"""HTML report of a design study: its design, figures of merit, extreme points and failures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import counted
from .._html import Column, Html, joined, png, table, tag
from ..errors import NlosError, SceneError
from .elements import facts, figure, number, quantity, seconds, section
from .pages import assembled
from .sections import Part, colophon

if TYPE_CHECKING:
    from ..study import Results
    from ..study.design.figures import Figure

MOST_ROWS = 12  # of a table of steps or sensitivities
PENDING = "{} of {} are pending. Ranges and pictures show the finished ones only."


def study_page(path: str | Path, *, gallery: bool = True) -> str:
    """Make an HTML report of a design study as a single file.

    The page shows what was varied, each figure of merit with its extreme points, and failures.

    Parameters
    ----------
    path : str or Path
        Folder with the results of the study (the store), complete or not.
    gallery : bool
        Whether to show the point spread functions (PSFs) of three points of the study: the worst,
        the median and the best. The points are ranked by the study's first figure of merit that is
        computed from a PSF. The three PSFs are computed again for the page.

    Returns
    -------
    str
        Text of an HTML file, which needs no other file and no network.

    Raises
    ------
    SceneError
        If the folder has no results of a study.
    MissingExtraError
        If matplotlib is not installed.

    See Also
    --------
    page : Report of a run.
    nlosoptics.study.Results : Results of a study.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import report
    >>> from nlosoptics.study import Study, run_study
    >>> study = Study.from_tables(
    ...     {
    ...         "scene": "examples/scenes/letter_flat.toml",
    ...         "figures": ["aberration_rms"],
    ...         "axes": {"camera.focus_distance": ["2 m", "1.9 m"]},
    ...     }
    ... )
    >>> with TemporaryDirectory() as folder:
    ...     results = run_study(study, folder + "/focus.zarr", workers=0)
    ...     text = report.study_page(folder + "/focus.zarr", gallery=False)
    >>> text.startswith("<!DOCTYPE html>")
    True
    """
    from ..study import Results

    results = Results.load(path)
    made: tuple[tuple[str, str, Iterator[Html]], ...] = (
        ("design", "Design", _design(results)),
        *(
            (f"figure-{index}", merit.name, _merit(results, merit))
            for index, merit in enumerate(results.study.figures)
        ),
        ("spreads", "Worst, median and best", _gallery(results) if gallery else iter(())),
        ("failures", "Failures", _failures(results)),
        ("provenance", "Provenance", _provenance(results)),
    )
    parts: list[Part] = [
        (anchor, title, section(anchor, title, *contents))
        for anchor, title, contents in ((a, t, list(c)) for a, t, c in made)
        if contents
    ]
    return assembled(f"{results.path.name}, nlosoptics study", _head(results), parts, colophon())


def _head(results: Results) -> Html:
    """Header: name of the store, what was varied, and key figures."""
    study, counts = results.study, results.counts
    names = ", ".join(d.name for d in study.dimensions)
    lead = f"{counted(len(study.figures), 'figure')} of merit at {counted(len(study), 'point')}"
    spent = np.asarray(results.dataset["seconds"].values, dtype=np.float64)
    spent = spent[np.isfinite(spent)]
    tiles: list[tuple[object, object]] = [
        (f"Points {status}", str(count)) for status, count in counts.items() if count
    ]
    if len(spent):
        each = tag("small", f"{seconds(float(spent.mean()))} a point")
        tiles.append(("Time of all points", joined([seconds(float(spent.sum())), each])))
    notice = None
    if counts["pending"]:
        told = PENDING.format(counted(counts["pending"], "point"), len(study))
        notice = tag("p", told, class_="notice")
    return joined(
        [
            tag("p", "nlosoptics, design study", class_="kind"),
            tag("h1", results.path.name),
            tag("p", f"{lead}, over {names}.", class_="lead"),
            tag("p", f"tol {number(study.tol)}, seed {study.seed}", class_="when"),
            notice,
            facts(tiles, class_="tiles"),
        ]
    )


def _design(results: Results) -> Iterator[Html]:
    from ..study.design.values import label

    rows: list[tuple[object, ...]] = []
    for dimension in results.study.dimensions:
        steps = len(dimension.deltas)
        if dimension.name == "case":
            shown = dimension.labels()[:MOST_ROWS]
            more = f", and {steps - len(shown)} more" if steps > len(shown) else ""
            rows.append(("one at a time", str(steps), "; ".join(shown) + more))
            continue
        for address in dimension.addresses:
            values = [delta[address] for delta in dimension.deltas]
            texts = list(dict.fromkeys(map(label, values)))
            if len(texts) > MOST_ROWS:
                ordered = _sorted(values)
                texts = [f"{label(ordered[0])} to {label(ordered[-1])}"]
            rows.append((address, str(steps), ", ".join(texts)))
    columns = (Column("Value"), Column("Steps", "number"), Column("Values"))
    yield _wide(table("What was varied", columns, rows), "What was varied")
    changes = results.study.definition.get("set", {})
    if changes:
        named = [(name, label(value)) for name, value in changes.items()]
        yield table("Changes of the base scene", (Column("Value"), Column("")), named)


def _sorted(values: list[Any]) -> list[Any]:
    """Return values in ascending order if they are numbers, else as they are."""
    from ..study.design.values import number as as_number

    numbers = [as_number(value) for value in values]
    if None in numbers:
        return values
    return [values[i] for i in np.argsort([one[0] for one in numbers if one is not None])]


def _merit(results: Results, merit: Figure) -> Iterator[Html]:
    """Range, pictures and extreme points of one figure of merit."""
    from ..study.answers import smallest_is_best
    from ..study.design.values import label
    from ..views.run_overview import ranked

    unit = f" ({merit.unit})" if merit.unit else ""
    options = ", ".join(f"{key} = {value}" for key, value in merit.options.items())
    yield tag("p", f"{merit.meaning}{unit}." + (f" With {options}." if options else ""))
    values = results.values(merit.name, incomplete=True)
    try:
        chosen = ranked(results, merit.name, smallest_is_best=smallest_is_best(merit))
    except SceneError as error:
        yield tag("p", str(error), class_="notice")
        return
    rows = []
    for rank, index in chosen.items():
        delta = results.study.delta(index)
        told = ", ".join(f"{address} = {label(value)}" for address, value in delta.items())
        rows.append((rank, _amount(values[index], merit), str(index), told or "nominal"))
    columns = (
        Column(""),
        Column("Figure", "number"),
        Column("Point", "number"),
        Column("Values of the scene"),
    )
    yield _wide(table("Points", columns, rows), f"Points of {merit.name}")
    shown: list[Html] = []
    for captions, draw in _pictures(results, merit, f"{merit.name}{unit}"):
        try:
            drawn = draw()
        except NlosError as error:
            yield tag("p", f"{captions[0]}: left out, because {error}.", class_="notice")
            continue
        panels = drawn if isinstance(drawn, tuple) else (drawn,)
        shown += [_plot(axes, told) for axes, told in zip(panels, captions, strict=True)]
    if shown:
        yield tag("div", *shown, class_="figures")
    if [d.name for d in results.study.dimensions] == ["case"]:
        yield from _sensitivities(results, merit)


def _amount(value: float, merit: Figure) -> str:
    return quantity(value, merit.unit) if merit.unit in ("m", "s", "W") else number(value, 4)


def _pictures(
    results: Results, merit: Figure, label: str
) -> Iterator[tuple[list[str], Callable[[], Any]]]:
    """Yield the captions of the pictures of a figure of merit, and a function that draws them."""
    from .. import study, views
    from ..views.studies import slice_names

    name, dims = merit.name, [d.name for d in results.study.dimensions]
    if dims == ["case"]:
        height = 1.4 + 0.5 * len({address for address in results.study.dimensions[0].addresses})
        yield (
            [f"Changes of {name}, one value at a time"],
            lambda: views.tornado(
                study.sensitivities(results, name, incomplete=True),
                label=label,
                axes=_panel(height),
            ),
        )
        return
    if dims == ["draw"] and results.study.definition["draws"].get("method") == "saltelli":
        yield (
            [f"Shares of the variance of {name}, with 95 % intervals"],
            lambda: views.sobol_bars(
                study.sobol_indices(results, name), label=name, axes=_panel(3.6)
            ),
        )
    elif dims == ["draw"]:
        yield [f"Yield against the limit of {name}"], lambda: _yield(results, merit, label)
    else:
        yield [f"Map of {name}"], lambda: views.study_map(results, name, axes=_panel(4.2))
    if len([size for size in results.study.shape if size > 1]) > 1 or dims == ["draw"]:
        try:
            panels = slice_names(results)
        except SceneError:  # draws together with other dimensions
            return
        yield (
            [f"Response of {name} to {panel}" for panel in panels],
            lambda: views.study_slices(results, name, axes=[_panel(3.6) for _ in panels]),
        )


def _panel(height: float) -> Any:
    """Return the axes of a new figure that is readable at the width of a phone."""
    from ..views.canvas import new_axes

    return new_axes(1, width=5.0, height=height)[0]


def _yield(results: Results, merit: Figure, label: str) -> Any:
    from .. import views
    from ..study.answers import yields

    limits, found = yields(results, merit.name)
    return views.yield_curve(limits, found, label=label, axes=_panel(3.6))


def _sensitivities(results: Results, merit: Figure) -> Iterator[Html]:
    from ..study import sensitivities

    try:
        bars = sensitivities(results, merit.name, incomplete=True)
    except NlosError:  # the tornado has said why
        return
    rows = [
        (bar.case, _amount(bar.value, merit), _signed(bar.change), "yes" if bar.resolved else "no")
        for bar in bars[:MOST_ROWS]
        if np.isfinite(bar.value)
    ]
    columns = (
        Column("Change of the scene"),
        Column("Figure", "number"),
        Column("Change", "number"),
        Column("Above its error"),
    )
    yield _wide(table("Largest changes", columns, rows), f"Largest changes of {merit.name}")


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + number(value)


def _gallery(results: Results) -> Iterator[Html]:
    """Point spreads of the extreme points of the first figure of merit that needs them."""
    from .. import views
    from ..study.answers import smallest_is_best

    for merit in results.study.figures:
        if merit.stage == "point spread":
            break
    else:
        return
    panels = [_panel(4.8) for _ in range(3)]
    try:
        drawn = views.study_gallery(
            results, merit.name, smallest_is_best=smallest_is_best(merit), axes=panels
        )
    except NlosError as error:
        yield tag("p", f"The point spreads are left out: {error}.", class_="notice")
        return
    told = "Point spread of the {} point by " + merit.name
    shown = [
        _plot(axes, told.format(rank))
        for rank, axes in zip(("worst", "median", "best"), drawn, strict=True)
    ]
    yield tag("p", "Computed again for this page, on one scale of lengths.")
    yield tag("div", *shown, class_="figures")


def _failures(results: Results) -> Iterator[Html]:
    found = sorted(results.failures().items(), key=lambda item: -item[1])
    if found:
        rows = [(text, str(count)) for text, count in found[:MOST_ROWS]]
        columns = (Column("Message"), Column("Points", "number"))
        yield _wide(table("Points that failed", columns, rows), "Points that failed")
        if len(found) > MOST_ROWS:
            yield tag("p", f"{len(found) - MOST_ROWS} more messages are left out.")


def _provenance(results: Results) -> Iterator[Html]:
    from ..study.store import Store

    store = Store.open(results.path)
    about = {} if store is None else store.about
    yield facts(
        [
            ("Store", tag("code", str(results.path))),
            ("Base scene", tag("code", results.study.base.source)),
        ]
    )
    versions = list(about.get("versions", {}).items())
    if versions:
        columns = (Column("Package"), Column("Version", "number"))
        yield table("Versions of the latest run", columns, versions)
    yield tag("h3", "Tables of the study file")
    text = json.dumps(results.study.definition, indent=2, ensure_ascii=False)
    yield tag("pre", text, tabindex=0)


def _plot(axes: Any, told: str) -> Html:
    """Return the figure of some axes with a caption, which is its alternative text too."""
    data = BytesIO()
    axes.get_figure().savefig(data, format="png")
    return figure(tag("img", src=png(data.getvalue()), alt=told), tag("b", told), class_="plot")


def _wide(inner: Html, label: str) -> Html:
    """Return a table in a box that scrolls sideways in a narrow window."""
    return tag("div", inner, class_="wide", tabindex=0, role="group", aria_label=label)
