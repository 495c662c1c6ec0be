"""Points of a study in the rows of its store: which are open, and in which blocks."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SceneError
from ..runs.record import versions
from .design.base import differing_leaves
from .design.point import point_spread_key
from .design.study import Study, differing_steps
from .results import about_study, study_of
from .store import Store
from .worker import DONE, FAILED, LOST, Block

#: Tables on which the choices of a search depend.
SEARCHED = ("optimise", "axes", "zip", "one_at_a_time", "draws")


def prepared(study: Study, path: Path) -> tuple[Store, Study]:
    """Open or create the store of a study, with a row for every point.

    The study is returned with the trials that the store has of its search.
    """
    store = Store.open(path, write=True)
    about: dict[str, Any] = about_study(study) | {"versions": versions()}
    if store is None:
        store = Store.create(path, study.base.files)
    else:
        stored = study_of(store)
        study = study.with_trials(store.trials()) if study.variables else study
        _check_same(study, stored, path)
        store.add_files(study.base.files)
        new = {figure["name"]: figure for figure in about["figures"]}
        # each figure stays in its column
        old = {figure["name"]: figure for figure in store.about["figures"]}
        about["figures"] = list((old | new).values())
    known = set(store.ids)
    store.add([study.ids[i] for i in order(study) if study.ids[i] not in known], about)
    return store, study


def _check_same(study: Study, stored: Study, path: Path) -> None:
    """Raise `SceneError` if a study does not continue the one of a store."""
    differences = study.base.differences(stored.base)
    for name in ("tol", "seed"):
        new, old = getattr(study, name), getattr(stored, name)
        if new != old:
            differences.append(f"{name} = {new} instead of {old}")
    known = {figure.name: figure for figure in stored.figures}
    for figure in study.figures:
        other = known.get(figure.name, figure)
        if (figure.source, figure.options) != (other.source, other.options):
            differences.append(
                f"figure {figure.name} is {figure.source} {figure.options} instead of "
                f"{other.source} {other.options}"
            )
        elif figure.compensate != other.compensate:
            differences.append(f"figure {figure.name} has another [compensate]")
    if study.variables or stored.variables:
        differences += differing_leaves(*map(_search_tables, (study, stored)))
    if not differences and set(stored.ids) - set(study.ids):
        differences = list(differing_steps(study, stored))
    if differences:
        more = f" (and {len(differences) - 1} more)" if len(differences) > 1 else ""
        raise SceneError(
            f"{path} has the results of another study: {differences[0]}{more}; restore that, or "
            "name another folder"
        )


def _search_tables(study: Study) -> dict[str, Any]:
    """Return what determines the search of a study and each of its trials."""
    tables = {name: study.definition[name] for name in SEARCHED if name in study.definition}
    if "optimise" in tables:  # a search may become longer
        tables["optimise"] = {k: v for k, v in tables["optimise"].items() if k != "evaluations"}
    return tables


def order(study: Study) -> list[int]:
    """Return the points in the order of computation: those with the same point spread together."""
    groups: dict[str, list[int]] = {}
    for index in range(len(study)):
        groups.setdefault(point_spread_key(study.delta(index)), []).append(index)
    return [index for group in groups.values() for index in group]


def open_blocks(study: Study, store: Store, size: int, *, again: bool = False) -> list[Block]:
    """Return blocks of ``size`` points of a study that lack figures, with these figures.

    With ``again``, they include those at which a figure failed or was lost.
    """
    index = {name: i for i, name in enumerate(study.ids)}
    names = [figure.name for figure in study.figures]
    finished = [DONE] if again else [DONE, FAILED, LOST]
    lacking = ~np.isin(store.column("status", names), finished)
    rows = [row for row in np.flatnonzero(lacking.any(axis=1)).tolist() if store.ids[row] in index]
    blocks = []
    for pattern, group in groupby(rows, key=lambda row: tuple(lacking[row])):
        alike = list(group)
        figures = tuple(name for name, open_ in zip(names, pattern, strict=True) if open_)
        for first in range(0, len(alike), size):
            own = tuple(alike[first : first + size])
            ids = tuple(store.ids[row] for row in own)
            blocks.append(Block(own, tuple(study.delta(index[i]) for i in ids), ids, figures))
    return blocks
