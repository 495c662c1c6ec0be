"""Sections of the report of a design study."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import counted
from .._html import Html, joined, tag
from ..errors import NlosError, SceneError
from .elements import Part, facts, number, plot, quantity, seconds, sections, wide_table

if TYPE_CHECKING:
    from ..study import Results
    from ..study.design.figures import Figure


def contents(path: Path, computed: bool) -> tuple[str, Html, list[Part]]:
    """Return title, header and sections of the page about the store of a study."""
    from ..study import Results

    results = Results.load(path)
    made: list[tuple[str, str, Iterator[Html]]] = [("design", "Design", _design(results))]
    made += [
        (f"figure-{index}", merit.name, _merit(results, merit))
        for index, merit in enumerate(results.study.figures)
    ]
    if computed:
        made += [("spreads", "Worst, median and best", _gallery(results))]
    made += [
        ("failures", "Failures", _failures(results)),
        ("provenance", "Tables of the study file", _tables(results)),
    ]
    return f"{results.path.name}, nlosoptics study", _head(results), sections(made)


def _head(results: Results) -> Html:
    """Return the name of the store, what was varied, and key figures."""
    study, counts = results.study, results.counts
    names = ", ".join(dimension.name for dimension in study.dimensions)
    lead = f"{counted(len(study.figures), 'figure')} of merit at {counted(len(study), 'point')}"
    spent = np.asarray(results.dataset["seconds"].values, dtype=np.float64)
    spent = spent[np.isfinite(spent)]
    tiles: list[tuple[object, object]] = [
        (f"Points {status}", str(count)) for status, count in counts.items() if count
    ]
    if len(spent):
        tiles.append(("Time of all points", seconds(float(spent.sum()))))
    notice = None
    if counts["pending"]:
        pending = f"{counted(counts['pending'], 'point')} of {len(study)}"
        text = f"{pending} are pending. Ranges and pictures show the finished ones only."
        notice = tag("p", text, class_="notice")
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
    """Yield what was varied; of many values the first and the last in their order."""
    from ..study.design.values import label

    rows: list[tuple[object, ...]] = []
    for dimension in results.study.dimensions:
        steps = len(dimension.deltas)
        if dimension.name == "case":
            rows.append(("one at a time", str(steps), _few(list(dimension.labels()))))
            continue
        for address in dimension.addresses:
            texts = dict.fromkeys(label(delta[address]) for delta in dimension.deltas)
            rows.append((address, str(steps), _few(list(texts))))
    columns = {"Value": None, "Steps": "number", "Values": None}
    yield wide_table("What was varied", columns, rows)
    changes = results.study.definition.get("set", {})
    named = [(name, label(value)) for name, value in changes.items()]
    yield wide_table("Changes of the base scene", {"Value": None, "": None}, named)


def _few(texts: list[str], most: int = 12) -> str:
    """Join texts; of more than ``most``, the rest is counted."""
    more = f", and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


def _merit(results: Results, merit: Figure) -> Iterator[Html]:
    """Yield the extreme points and the pictures of one figure of merit."""
    from ..study.answers import smallest_is_best
    from ..study.design.values import label
    from ..views.studies import ranked, study_picture

    unit = f" ({merit.unit})" if merit.unit else ""
    yield tag("p", f"{merit.meaning}{unit}.")
    values = results.values(merit.name, incomplete=True)
    try:
        chosen = ranked(results, merit.name, smallest_is_best=smallest_is_best(merit))
    except SceneError as error:
        yield tag("p", str(error), class_="notice")
        return
    rows = []
    for rank, index in chosen.items():
        value = float(values[index])
        text = quantity(value, merit.unit) if merit.unit in ("m", "s", "W") else number(value, 4)
        changes = ", ".join(f"{k} = {label(v)}" for k, v in results.study.delta(index).items())
        rows.append((rank, text, str(index), changes or "nominal"))
    columns = {"": None, "Figure": "number", "Point": "number", "Values of the scene": None}
    yield wide_table(f"Points of {merit.name}", columns, rows)
    kinds = ["auto"] if results.study.dimensions[0].name == "case" else ["auto", "slices"]
    shown = []
    for kind in kinds:
        try:
            shown.append(_plot(study_picture(results, merit.name, kind), merit.name))
        except NlosError as error:
            yield tag("p", f"A picture is left out, because {error}.", class_="notice")
    yield tag("div", *shown, class_="figures") if shown else Html()


def _gallery(results: Results) -> Iterator[Html]:
    """Yield the point spreads of the extreme points of the first figure that needs them."""
    from ..views.studies import study_picture

    for merit in results.study.figures:
        if merit.stage == "point spread":
            try:
                panels = study_picture(results, merit.name, "gallery")
            except NlosError as error:
                yield tag("p", f"The point spreads are left out: {error}.", class_="notice")
                return
            yield tag("p", "Computed again for this page, on one scale of lengths.")
            yield _plot(panels, f"Point spreads of the worst, median and best {merit.name}")
            return


def _failures(results: Results) -> Iterator[Html]:
    causes = sorted(results.failures().items(), key=lambda item: -item[1])
    rows = [(text, str(count)) for text, count in causes[:12]]
    yield wide_table("Points that failed", {"Message": None, "Points": "number"}, rows)
    if len(causes) > 12:
        yield tag("p", f"{len(causes) - 12} more messages are left out.")


def _tables(results: Results) -> Iterator[Html]:
    text = json.dumps(results.study.definition, indent=2, ensure_ascii=False)
    yield tag("pre", text, tabindex=0)


def _plot(axes: Any, title: str) -> Html:
    from ..views.saving import figure_file

    return plot(figure_file(axes), title, f"Picture of {title}.")
