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
    """Normal if ``sigma`` is given, else uniform; ``from`` and ``to`` truncate a normal one."""

    mean: Any = Field(None, description="default: the value of the base scene")
    sigma: Any = None
    low: Any = Field(None, alias="from")
    high: Any = Field(None, alias="to")
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
