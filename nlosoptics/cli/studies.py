"""Commands study, study status, plot, optimum, report and export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from .shell import (
    FAILED,
    INTERRUPTED,
    Debug,
    Group,
    app,
    check_file,
    errors_told,
    file_or_example,
    interruptible,
    numbers,
    progress_bar,
    require,
)


class Kind(StrEnum):
    """Picture of a study."""

    AUTO = "auto"
    MAP = "map"
    PANELS = "panels"
    SLICES = "slices"
    TORNADO = "tornado"
    YIELD = "yield"
    SOBOL = "sobol"
    GALLERY = "gallery"


class _RunByDefault(Group):
    """Group of commands whose name ``run`` may be left out."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["run", *args]
        return list(super().parse_args(ctx, args))


studies = typer.Typer(
    cls=_RunByDefault,
    help="Compute many variants of a scene: design studies. They are sweeps, tolerances, yields "
    "and searches for the best design. `nlosoptics study FILE` runs or resumes a study, "
    "such as the examples read_a_letter, tolerances and light_or_sharpness (a search). "
    "Example: nlosoptics study read_a_letter",
    short_help="Compute many variants of a scene: design studies.",
)
app.add_typer(studies, name="study")

StudyFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="Study file (TOML) of scene, values that change and figures of merit, or the name of "
        "an example: read_a_letter, tolerances or light_or_sharpness (a search).",
    ),
]
StoreFolder = Annotated[
    Path, typer.Argument(metavar="STORE", help="Folder written by nlosoptics study.")
]


@studies.command("run")
def run_command(
    study_file: StudyFile,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results; by default the name of the study file with .zarr."
        ),
    ] = None,
    only_plan: Annotated[
        bool,
        typer.Option(
            "--plan",
            help="Only print what the study will compute, with predicted time and size; "
            "without compiling and loading.",
        ),
    ] = False,
    workers: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Number of processes; by default one for each core. 0: compute in this process.",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Compute on a dask cluster: address of its scheduler, such as tcp://host:8786."
        ),
    ] = None,
    again: Annotated[
        bool,
        typer.Option(
            "--again", help="Also compute again the points that failed, or whose process crashed."
        ),
    ] = False,
    picture: Annotated[
        str | None,
        typer.Option(
            metavar="FIGURE",
            help="Also draw this figure of merit, as nlosoptics study plot does, next to the "
            "results, with .png.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Run a study, or resume it.

    Points that are already in the folder are kept. Only missing points, and values or figures of
    merit that were added to the file, are computed. Ctrl-C ends the study after the points that are
    being computed, and exits with code 130; the same command continues.

    Example: nlosoptics study tolerances --out tolerances.zarr
    """
    with errors_told(debug):
        _require_parts()
        if scheduler is not None:
            require("distributed", "study")
        from .. import study

        found = study.Study.load(file_or_example(study_file, "studies"))
        if picture is not None:
            require("matplotlib", "views")
            found.figure(picture)  # refuses an unknown name before the study runs
        if only_plan:
            typer.echo(str(study.plan_study(found)))
            return
        folder = Path(f"{study_file.stem}.zarr") if out is None else out
        if scheduler is not None:
            from ..study.engine import quieten

            quieten()
        with progress_bar(width=48) as progress, interruptible() as interrupted:
            results = study.run_study(
                found,
                folder,
                workers=workers,
                scheduler=scheduler,
                again=again,
                progress=progress,
                interrupted=interrupted,
            )
        typer.echo(_told(results))
        if not results.complete:
            typer.echo("nlosoptics: interrupted; the same command continues", err=True)
            raise typer.Exit(INTERRUPTED)
        names = [figure.name for figure in results.study.figures]
        if not results.dataset[names].notnull().to_dataarray().any():
            typer.echo("nlosoptics: every figure of every point failed, see above", err=True)
            raise typer.Exit(FAILED)
        if picture is not None:
            from .. import views
            from ..views.studies import study_picture

            drawing = folder.with_suffix(".png")
            views.save(study_picture(results, picture), drawing)
            typer.echo(f"{drawing}: {picture}")


@studies.command("status", short_help="Show the state and the results of a study.")
def status_command(store: StoreFolder, debug: Debug = False) -> None:
    """Show the state of a study: finished points, range of each figure of merit, and failures.

    For an optimisation, also show the best trials.

    Example: nlosoptics study status tolerances.zarr
    """
    with errors_told(debug):
        typer.echo(_told(_results(store)))


@studies.command("plot")
def plot_command(
    store: StoreFolder,
    figure: Annotated[str, typer.Argument(metavar="FIGURE", help="Name of the figure of merit.")],
    out: Annotated[Path, typer.Option(help="File to write: .png, .pdf or .svg.")] = Path(
        "study.png"
    ),
    kind: Annotated[
        Kind,
        typer.Option(
            help="Kind of picture: map of two axes, panels of maps or slices of curves for more "
            "axes, tornado (effect of each value alone), yield (share of the draws within a "
            "limit), sobol (share of each value in the variance), gallery of point spreads. By "
            "default (auto) the one that fits the tables of the study."
        ),
    ] = Kind.AUTO,
    x: Annotated[
        str | None, typer.Option("--x", help="Value across a map, such as camera.f_number.")
    ] = None,
    y: Annotated[str | None, typer.Option("--y", help="Value up a map.")] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="NAME=VALUE",
            help='Where to cut through the other values, such as "wall.radius=5 m"; by default in '
            "the middle of their steps. May be given several times.",
        ),
    ] = None,
    boundary: Annotated[
        float | None,
        typer.Option(help="Limit of the figure of merit, in its unit; a line is drawn there."),
    ] = None,
    contours: Annotated[
        str | None,
        typer.Option(
            help='Contour lines of a map, in the unit of the figure, such as "0.2,0.5,0.8".'
        ),
    ] = None,
    incomplete: Annotated[
        bool, typer.Option("--incomplete", help="Draw although some points are not yet computed.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Draw one figure of merit of a study.

    By default the picture is a tornado diagram for a table [one_at_a_time], Sobol indices for
    [draws] with method "saltelli", the yield against the limit for other [draws], and otherwise a
    map or curve.

    Example: nlosoptics study plot tolerances.zarr mtf --out mtf.png
    """
    with errors_told(debug):
        require("matplotlib", "views")
        from .. import views
        from ..views.studies import default_kind, step_of, study_picture

        results = _results(store)
        check_file(out)
        if results.study.dimensions[0].name == "trial":
            raise typer.BadParameter(f"{store} is a search; use nlosoptics study optimum {store}")
        results.values(figure, incomplete=incomplete)  # refuses pending points
        chosen = default_kind(results) if kind is Kind.AUTO else kind.value
        if contours is not None and chosen not in ("map", "panels"):
            raise typer.BadParameter("contours belong to a map; use --kind map or panels")
        if (x or y) and chosen != "map":
            raise typer.BadParameter("--x and --y belong to a map; use --kind map")
        if at and chosen not in ("map", "panels", "slices"):
            raise typer.BadParameter("--at belongs to maps and slices; use --kind map")
        pairs = [text.partition("=")[::2] for text in at or ()]
        options: dict[str, Any] = {
            "x": x,
            "y": y,
            "at": {name.strip(): step_of(results, name.strip(), step) for name, step in pairs},
            "boundary": boundary,
            "contours": list(numbers("--contours", contours)),
        }
        axes = study_picture(results, figure, chosen, **options)
        views.save(axes, out)
        typer.echo(f"{out}: {figure} of {results.path}")


@studies.command("report")
def report_command(
    store: StoreFolder,
    out: Annotated[
        Path | None,
        typer.Option(help="HTML file to write; by default the name of the folder with .html."),
    ] = None,
    gallery: Annotated[
        bool,
        typer.Option(
            "--gallery/--no-gallery",
            help="Show the point spreads of the worst, median and best point, which are computed.",
        ),
    ] = True,
    debug: Debug = False,
) -> None:
    """Write one HTML page about a study, complete or not. It needs no network.

    Example: nlosoptics study report tolerances.zarr
    """
    with errors_told(debug):
        require("matplotlib", "views")
        _results(store)  # check the input before the output path
        from .. import report
        from .._whole_files import write_whole

        file = Path(f"{store.resolve().stem}.html") if out is None else out
        check_file(file, ".html", ".htm")
        with progress_bar(width=48) as progress:
            progress("report", 0.0)
            text = report.page(store, computed=gallery)
        write_whole({file: text.encode()})
        typer.echo(f"{file}: {len(text.encode()) / 1e6:.2g} MB")


@studies.command("optimum")
def optimum_command(
    store: StoreFolder,
    out: Annotated[Path, typer.Option(help="File to write: .png, .pdf or .svg.")] = Path(
        "optimum.png"
    ),
    incomplete: Annotated[
        bool, typer.Option("--incomplete", help="Draw although the search has not ended.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Print the best trials of an optimisation and draw it.

    The picture shows the Pareto front of several objectives, or one objective over the trials.

    Example: nlosoptics study optimum light_or_sharpness.zarr --out optimum.png
    """
    with errors_told(debug):
        require("matplotlib", "views")
        from .. import views
        from ..study import optimum

        found = optimum(_results(store), incomplete=incomplete)
        check_file(out)
        views.save(views.search(found), out)
        typer.echo(f"{found}\n{out}: {len(found.feasible)} trials of {store}")


@studies.command("export", short_help="Write all points of a study to a CSV table.")
def export_command(
    store: StoreFolder,
    out: Annotated[Path, typer.Argument(metavar="CSV", help="Table to write (.csv).")],
    debug: Debug = False,
) -> None:
    """Write all points to a CSV table: changed values, figures of merit, errors and status.

    Example: nlosoptics study export tolerances.zarr points.csv
    """
    with errors_told(debug):
        check_file(out, ".csv")
        results = _results(store)
        from .._whole_files import write_whole

        table = results.dataset.to_dataframe().reset_index()
        write_whole({out: table.to_csv(index=False).encode()})
        typer.echo(f"{out}: {len(table)} points")


def _results(store: Path) -> Any:
    """Return the results in a store."""
    _require_parts()
    from ..study import Results

    return Results.load(store)


def _told(results: Any) -> str:
    """Return a study's results as text, with the best trials of a search."""
    from ..study import optimum

    search = results.study.table.optimise is not None
    return f"{results}\n{optimum(results, incomplete=True)}" if search else str(results)


def _require_parts() -> None:
    for part in ("xarray", "zarr"):
        require(part, "study")
