"""Points of a study in the rows of its store: which are open, and in which blocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SceneError
from ..runs.record import versions
from .design.base import leaves
from .design.point import point_spread_key
from .design.study import Study, differing_steps
from .planning import plan_study
from .results import about_study, study_of
from .store import Store
from .worker import DONE, FAILED, LOST, Block

#: Tables on which the choices of a search depend.
SEARCHED = ("optimise", "inverse_sensitivity", "axes", "zip", "one_at_a_time", "draws")


def prepared(study: Study, path: Path) -> tuple[Store, Study]:
    """Open or create the store of a study, with a row for every point.

    The study is returned with the trials that the store has of its search.

    Raises
    ------
    SceneError
        If the store belongs to another base scene or design. The message names the difference.
    """
    store = Store.open(path, write=True)
    about: dict[str, Any] = about_study(study) | {"versions": versions()}
    if store is None:
        block = plan_study(study).block
        store = Store.create(path, block=block, about=about, files=study.base.files)
        kept = study
    else:
        kept = study_of(store)
        study = study.with_trials(store.trials()) if study.variables else study
        _check_same(study, kept, path)
        store.add_files(study.base.files)
    names = {figure.name for figure in study.figures}
    figures = (*(f for f in kept.figures if f.name not in names), *study.figures)
    known = set(store.ids())
    store.add([study.ids[i] for i in order(study) if study.ids[i] not in known], figures)
    store.set_about(about | {"figures": about_study(study, figures)["figures"]})
    return store, study


def _check_same(study: Study, kept: Study, path: Path) -> None:
    """Raise `SceneError` if a study does not continue the one of a store."""
    differences = study.base.differences(kept.base)
    for name in ("tol", "seed"):
        if getattr(study, name) != getattr(kept, name):
            differences.append(f"{name} = {getattr(study, name)} instead of {getattr(kept, name)}")
    for new in study.figures:
        for old in kept.figures:
            if new.name != old.name:
                continue
            if (new.source, new.options) != (old.source, old.options):
                differences.append(
                    f"figure {new.name} is {new.source} {new.options} instead of {old.source} "
                    f"{old.options}"
                )
            elif new.compensate != old.compensate:
                differences.append(f"figure {new.name} has another [compensate]")
    differences += _other_search(study, kept)
    if not differences and set(kept.ids) - set(study.ids):
        differences = list(differing_steps(study, kept))
    if differences:
        more = f" (and {len(differences) - 1} more)" if len(differences) > 1 else ""
        raise SceneError(
            f"{path} has the results of another study: {differences[0]}{more}; restore that, or "
            "name another folder"
        )


def _other_search(study: Study, kept: Study) -> list[str]:
    """Return where the search of a study, and what each trial consists of, differs from a store."""
    if not (study.variables or kept.variables):
        return []
    mine, theirs = (
        {
            address: value
            for address, value in leaves(one.definition)
            if address.startswith(SEARCHED) and address != "optimise.evaluations"
        }
        for one in (study, kept)
    )
    return [
        f"{address} = {mine.get(address, 'absent')} instead of {theirs.get(address, 'absent')}"
        for address in sorted(mine.keys() | theirs.keys())
        if mine.get(address) != theirs.get(address)
    ]


def order(study: Study) -> list[int]:
    """Return the points in the order of computation: those with the same point spread together.

    Draws of the fast tier that are not checked are left out.
    """
    groups: dict[str, list[int]] = {}
    for index in study.in_full:
        groups.setdefault(point_spread_key(study.delta(index)), []).append(index)
    return [index for group in groups.values() for index in group]


def open_blocks(study: Study, store: Store, again: bool) -> list[Block]:
    """Return the blocks of a store that lack figures, with these figures.

    With ``again`` they include blocks in which a figure failed or was lost.
    """
    index = {name: i for i, name in enumerate(study.ids)}
    ids = store.ids()
    finished = [DONE] if again else [DONE, FAILED, LOST]
    lacking = {figure.name: ~np.isin(store.statuses(figure), finished) for figure in study.figures}

    def blocks() -> Iterator[Block]:
        for first in range(0, len(ids), store.block):
            rows = range(first, min(first + store.block, len(ids)))
            used = [row for row in rows if ids[row] in index]
            # points of a block are at its start; other rows are empty
            missing = tuple(
                name for name, open_rows in lacking.items() if any(open_rows[row] for row in used)
            )
            if missing:
                deltas = tuple(study.delta(index[ids[row]]) for row in used)
                yield Block(first, deltas, tuple(ids[row] for row in used), missing)

    return list(blocks())
