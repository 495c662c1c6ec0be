"""Study files: TOML tables as pydantic models, the same for files and for Python."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator

from ...scene.file.errors import validated


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, populate_by_name=True)


class Range(_Table):
    """Even steps between two values, both included."""

    low: Any = Field(alias="from")
    high: Any = Field(alias="to")
    count: int = Field(ge=2, le=1_000_000)
    spacing: Literal["linear", "log"] = "linear"


class Distribution(_Table):
    """Normal if ``sigma`` is given, else uniform; ``from`` and ``to`` truncate a normal one.

    ``spread_of`` names a material of the library, whose values are all drawn from their spread.
    """

    mean: Any = Field(None, description="default: the value of the base scene")
    sigma: Any = None
    low: Any = Field(None, alias="from")
    high: Any = Field(None, alias="to")
    spacing: Literal["linear", "log"] = "linear"
    spread_of: str | None = None


class Limits(_Table):
    """Limits between which a search may choose a value."""

    low: Any = Field(alias="from")
    high: Any = Field(alias="to")
    spacing: Literal["linear", "log"] = "linear"


def _list_or(model: type[_Table]) -> Any:
    """Return the annotation of a list of values or a table of ``model``."""

    def checked(value: Any) -> Any:
        if isinstance(value, list | _Table):
            return value
        if not isinstance(value, dict):
            raise ValueError("is neither a list of values nor a table")
        return validated(model, value)

    return PlainValidator(checked)


Values = Annotated[list[Any] | Range, _list_or(Range)]
Choice = Annotated[list[Any] | Limits, _list_or(Limits)]
Law = Annotated[list[Any] | Distribution, _list_or(Distribution)]


class Draws(_Table):
    """Random values, drawn together."""

    count: int = Field(ge=1, le=1_000_000)
    method: Literal["random", "latin", "sobol", "saltelli"] = "sobol"
    of: dict[str, Law] = Field(min_length=1)


class FigureTable(_Table):
    """Figure of merit with options."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    figure: str
    name: str | None = Field(None, description="name in the results; default: that of the figure")


class Within(_Table):
    """Figure of merit with limits, over all points that a trial has beside others."""

    figure: str
    at_least: float | None = Field(None, allow_inf_nan=False)
    at_most: float | None = Field(None, allow_inf_nan=False)

    @property
    def limited(self) -> bool:
        """Whether a limit is given."""
        return self.at_least is not None or self.at_most is not None


class Objective(Within):
    """Figure to minimise or maximise; with limits, the share of points within them."""

    goal: Literal["minimise", "maximise"]
    over: Literal["worst", "mean"] = "worst"

    @property
    def maximised(self) -> bool:
        """Whether the largest value is the best."""
        return self.goal == "maximise"


class Constraint(Within):
    """Limits that a share of the points must meet."""

    share: float = Field(1.0, gt=0.0, le=1.0)


class Optimise(_Table):
    """Search for the best values."""

    method: Literal["cobyqa", "gradient", "differential-evolution", "tpe", "nsga-ii"]
    evaluations: int = Field(ge=1, le=100_000)
    population: int | None = Field(None, ge=1, le=10_000)
    objectives: list[Objective] = Field(min_length=1)
    constraints: list[Constraint] = []
    variables: dict[str, Choice] = Field(min_length=1)


class Compensate(_Table):
    """Values that are adjusted at every point for the best figure."""

    figure: str | FigureTable
    goal: Literal["minimise", "maximise"]
    variables: dict[str, Limits] = Field(min_length=1)


class StudyTable(_Table):
    """Study file."""

    scene: str
    figures: list[str | FigureTable] = Field(min_length=1)
    tol: float = 1e-3
    seed: int = Field(0, ge=0, lt=2**64)
    set: dict[str, Any] = {}
    axes: dict[str, Values] = {}
    zip: dict[str, list[Any]] = {}
    one_at_a_time: dict[str, Values] = {}
    draws: Draws | None = None
    optimise: Optimise | None = None
    compensate: Compensate | None = None
