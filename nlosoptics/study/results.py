"""Results of a study: its store as arrays over the dimensions of the design."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted, path_of
from .._nouns import Noun
from ..errors import SceneError
from ..scene.file.addresses import value_at
from ..scene.file.errors import validated
from .design.base import Base
from .design.designs import Dimension, dimensions
from .design.figures import Figure
from .design.file import StudyTable
from .design.study import Study, search_variables
from .design.values import label, number
from .store import STATUSES, Store, reading
from .worker import Answers

if TYPE_CHECKING:
    import xarray as xr

    from ..psf import ScenePointSpread
    from ..scene import Scene


RUNNING = "running"  # state of a search that has not ended


@dataclass(frozen=True, eq=False, kw_only=True)
class Results(Noun):
    """Results of a design study, complete or not.

    A study computes figures of merit at many points. A point is a variant of the study's scene.
    Read results from their folder by `load`.

    Parameters
    ----------
    path : Path
        Folder of the results, also called the store.
    study : Study
        Study that was run.
    dataset : xarray.Dataset
        Figures of merit at all points of the study, as arrays of shape ``study.shape``; see Notes.

    See Also
    --------
    Study : Figures of merit over the points of a design.
    sensitivities : Change of a figure of merit with each value.
    fraction_within : Fraction of points that meet a specification.
    nlosoptics.views.study_map : Figure of merit over two dimensions.

    Notes
    -----
    Variables of ``dataset``:

    - one for each figure of merit, under its name; NaN where the computation failed or is pending;
    - ``<figure>_error``: numerical error of a figure of merit, if it has one;
    - ``status``: "done", "failed" (an error was raised), "lost" (the process that computed
      it crashed, and crashed again at a second try) or "pending" (not computed yet). Each point has
      one status for all its figures of merit: "pending" if one of them is pending, else "lost" if
      one is lost, else "done" if one of them is done, else "failed". A figure of merit that failed
      at a point that is "done" is NaN there, and ``message`` has its reason;
    - ``message``: errors and warnings; ``seconds``: computing time, s.

    Coordinates have the name of the value that varies, by table and key of the scene file, such as
    ``wall.radius``. They are numbers in SI units, or text. A study with the table ``one_at_a_time``
    has the dimension ``case`` with a text for each case. An optimisation has ``trial`` as its first
    dimension, and the attribute ``search`` states why it ended.
    """

    path: Path
    study: Study
    dataset: xr.Dataset

    @classmethod
    def load(cls, path: str | Path) -> Results:
        """Read the results of a study from its folder, also of one that is not finished.

        Parameters
        ----------
        path : str or Path
            Folder of the results, also called the store.

        Raises
        ------
        SceneError
            If the folder has no results of a study.
        """
        return results_at(path_of("path", path))

    def scene(self, index: int) -> Scene:
        """Return the scene of a point of the study.

        Parameters
        ----------
        index : int
            Number of the point, counted from 0 in the order of the flattened dataset.
        """
        return self.study.scene(index)

    def point_spread(self, index: int) -> ScenePointSpread:
        """Compute wave and point spread function of a point again, bit for bit as in the study.

        Parameters
        ----------
        index : int
            Number of the point, counted from 0 in the order of the flattened dataset.

        Raises
        ------
        NlosError
            If the scene is invalid or has no point spread function, as in the study itself.
        """
        from ..psf import scene_point_spread

        return scene_point_spread(self.scene(index), self.study.tol)

    def values(self, figure: str, *, incomplete: bool = False) -> NDArray[np.float64]:
        """Return a figure of merit at all points, as a flat array.

        Parameters
        ----------
        figure : str
            Name of the figure of merit.
        incomplete : bool
            Whether to accept results in which points are still to be computed.

        Returns
        -------
        ndarray, (n_points,)
            Values in C order of the dimensions; NaN where the computation failed or is pending.

        Raises
        ------
        SceneError
            If the study has no such figure of merit, or points are not computed yet and
            ``incomplete`` is False.
        """
        name = self.study.figure(figure).name
        pending = self.counts["pending"]
        if not self.complete and not pending and not incomplete:
            raise SceneError(
                f"the search in {self.path} has not ended; finish it, or pass incomplete=True"
            )
        if pending and not incomplete:
            raise SceneError(
                f"{counted(pending, 'point')} of {len(self.study)} in {self.path} are pending; "
                "finish the study, or pass incomplete=True"
            )
        return np.asarray(self.dataset[name].values, dtype=np.float64).ravel()

    @property
    def complete(self) -> bool:
        """Whether no point is pending, and an optimisation has ended."""
        return not self.counts["pending"] and self.dataset.attrs.get("search") != RUNNING

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of points with each status: "done", "failed", "lost" and "pending"."""
        values = self.dataset["status"].values
        return {status: int((values == status).sum()) for status in STATUSES}

    def failures(self) -> dict[str, int]:
        """Return each message of points that lack a figure with the number of those points."""
        status, texts = (self.dataset[name].values.ravel() for name in ("status", "message"))
        figures = [self.dataset[figure.name].values.ravel() for figure in self.study.figures]
        lacking = np.isnan(figures).any(axis=0) & (status != "pending")
        return dict(Counter(texts[lacking]))

    def to_xarray(self) -> xr.Dataset:
        """Return `dataset`: figures of merit over the values that vary."""
        return self.dataset

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each point: its values and figures."""
        return self.dataset.to_dataframe().reset_index()

    def __str__(self) -> str:
        """Return status and range of every figure as text."""
        n = self.counts
        told = ", ".join(f"{count} {status}" for status, count in n.items() if count)
        lines = [f"{self.path}: {counted(len(self.study), 'point')}: {told}"]
        for figure in self.study.figures:
            values = self.values(figure.name, incomplete=True)
            good = values[np.isfinite(values)]
            if len(good):
                low, middle, high = good.min(), np.median(good), good.max()
                lines.append(
                    f"{figure.name:24s} {low:.4g} to {high:.4g}, median {middle:.4g} {figure.unit}"
                )
        lines += [f"{count} x {text}" for text, count in self.failures().items()]
        return "\n".join(line.rstrip() for line in lines)


def results_at(path: Path, study: Study | None = None) -> Results:
    """Return what `Results.load` reads; ``study`` is not built again if it is the stored one."""
    with reading(path):
        store = Store.open(path)
        if store is None:
            raise SceneError(f"{path} has no results of a study; run the study first")
        known = study is not None and about_study(study).items() <= store.about.items()
        if study is None or study.variables or not known:
            study = study_of(store)
        return Results(path=path, study=study, dataset=_dataset(study, store))


def about_study(study: Study, figures: tuple[Figure, ...] | None = None) -> dict[str, Any]:
    """Return what the store keeps of a study beside the files of its base scene, as JSON."""
    return {
        "definition": study.definition,
        "folder": str(study.folder),
        "source": study.base.source,
        "tables": study.base.tables,
        "names": study.base.names,
        "figures": [asdict(figure) for figure in figures or study.figures],
    }


def study_of(store: Store) -> Study:
    """Return the study of a store, without reading any other file."""
    about = store.about
    table: StudyTable = validated(StudyTable, about["definition"])
    base = Base(
        source=about["source"], tables=about["tables"], files=store.files(), names=about["names"]
    )
    found = dimensions(table, lambda address: value_at(base.tables, address))
    study = Study(
        definition=about["definition"],
        folder=Path(about["folder"]),
        base=base,
        dimensions=tuple(
            Dimension(name=d.name, deltas=tuple(base.packed(delta) for delta in d.deltas))
            for d in found
        ),
        figures=tuple(Figure(**given) for given in about["figures"]),
        tol=table.tol,
        seed=table.seed,
        variables=search_variables(table, base),
    )
    return study.with_trials(store.trials()) if study.variables else study


def _dataset(study: Study, store: Store) -> xr.Dataset:
    """Return the rows of a store in the order of the design."""
    rows = {name: row for row, name in enumerate(store.ids)}
    at = np.array([rows.get(name, -1) for name in study.ids], dtype=int)
    names = [figure.name for figure in study.figures]

    def columns(name: str, empty: Any) -> Any:
        """Return the columns of figures at all points, (points, figures)."""
        values = store.column(name, names)
        blank = np.full((1, *values.shape[1:]), empty, dtype=values.dtype)
        return np.concatenate([values, blank])[at]

    answers = Answers(
        values=columns("value", np.nan),
        errors=columns("error", np.nan),
        statuses=columns("status", 0),
        messages=columns("message", ""),
        seconds=columns("seconds", np.nan),
    )
    return answered(study, answers, {"search": store.ended or RUNNING} if study.variables else {})


def answered(study: Study, answers: Answers, attributes: dict[str, str]) -> xr.Dataset:
    """Return the answers of all points, in the order of the design, over its dimensions."""
    dims, shape = [d.name for d in study.dimensions], study.shape
    names = [figure.name for figure in study.figures]
    arrays: dict[str, Any] = {}
    for figure, value, error in zip(study.figures, answers.values.T, answers.errors.T, strict=True):
        told = {"long_name": figure.meaning} | ({"units": figure.unit} if figure.unit else {})
        arrays[figure.name] = (dims, value.reshape(shape), told)
        if figure.has_error:
            arrays[f"{figure.name}_error"] = (dims, error.reshape(shape), told)
    # of all figures: pending before lost, done and failed
    ranks = np.array([3, 1, 0, 2])[answers.statuses].max(axis=1)
    arrays["status"] = (dims, np.array(STATUSES)[np.array([2, 1, 3, 0])[ranks]].reshape(shape))
    texts = [_joined(names, point) for point in answers.messages]
    arrays["message"] = (dims, np.array(texts, dtype=object).reshape(shape))
    arrays["seconds"] = (dims, answers.seconds.reshape(shape), {"units": "s"})
    coordinates: dict[str, Any] = {}
    for dimension in study.dimensions:
        coordinates |= _coordinates(dimension)
    import xarray as xr  # here, so that a script's workers load without

    return xr.Dataset(arrays, coordinates, attributes)


def _joined(names: list[str], texts: NDArray[Any]) -> str:
    """Return the messages of a point's figures in one line, equal ones once."""
    figures: dict[str, list[str]] = {}
    for name, text in zip(names, texts, strict=True):
        if text:
            figures.setdefault(str(text), []).append(name)
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in figures.items())


def _coordinates(dimension: Dimension) -> dict[str, Any]:
    """Return the coordinates of a dimension: values by address, and a label or number."""
    found: dict[str, Any] = {}
    addresses = set(dimension.addresses)
    if any(delta.keys() != addresses for delta in dimension.deltas):
        return {dimension.name: (dimension.name, list(dimension.labels()))}  # one at a time
    for address in dimension.addresses:
        values = [delta[address] for delta in dimension.deltas]
        numbers = [number(value) for value in values]
        units = {one[1] for one in numbers if one is not None}
        if len(units) == 1 and None not in numbers:
            data: list[Any] = [one[0] for one in numbers if one is not None]
            found[address] = (dimension.name, data, {"units": units.pop()})
        else:
            found[address] = (dimension.name, [label(value) for value in values])
    return found
