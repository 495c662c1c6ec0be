"""Forecasts of `limits.feasibility`: verdicts, correlations and modes of diffuse light."""

from collections.abc import Iterator, Sequence

from .cells import Row, by, filled
from .page import Section

#: Ranges of the predicted spread.
SPREADS = (("below 0.05", 0.0, 0.05), ("0.05 to 0.1", 0.05, 0.1), ("above 0.1", 0.1, 1.0))


def by_spread(found: Sequence[Row]) -> Iterator[Row]:
    """Yield how near the predicted correlations are, by their predicted spread."""
    missed = sum(row["correlation"] == 0.0 for row in found)
    for name, low, high in SPREADS:
        part = [row for row in found if row["correlation"] and low <= row["spread"] < high]
        if not part:
            continue
        off = [abs(row["score"] - row["correlation"]) for row in part]
        between = [d for d, row in zip(off, part, strict=True) if 0.3 < row["correlation"] < 0.95]
        again = [
            abs(row["correlation_again"] - row["correlation"])
            for row in part
            if 0.3 < row["correlation"] < 0.95
        ]
        yield {
            "name": name,
            "fits": len(part),
            "off": off,
            "near": f"{sum(d < 0.05 for d in between)} of {len(between)}",
            "again": f"{sum(d < 0.05 for d in again)} of {len(again)}",
            "within": sum(d < r["spread"] for d, r in zip(off, part, strict=True)) / len(part),
        }
    yield {"name": "no object found", "fits": missed}


def largest_difference(part: Row) -> str:
    """Return a cell: the largest relative difference from the count by brute force."""
    pairs = zip(part["modes"], part["brute_force"], strict=True)
    return f"{max(abs(modes - count) / max(count, 1) for modes, count in pairs):.0%}"


def of_verdicts(found: Sequence[Row]) -> str:
    """Return the second table of a section on verdicts: differences of the correlations."""
    return filled(
        {
            "predicted spread": "{name}",
            "fits": "{fits}",
            "median difference": "{off?:median n}",
            "within 0.05, of fits with correlations of 0.3 to 0.95": "{near?}",
            "the same for two fits that differ in their noise": "{again?}",
            "within the spread": "{within?:.0%}",
        },
        by_spread(found),
    )


VERDICTS = {
    "predicted": lambda g: "recoverable" if g["predicted"] else "not recoverable",
    "correlation of the fit above 0.9": lambda g: sum(c > 0.9 for c in g["correlation"]),
    "below 0.9": lambda g: sum(c <= 0.9 for c in g["correlation"]),
}


def verdicts(file: str, title: str, text: str, options: str = "") -> Section:
    """Section of verdicts that were compared with fits."""
    return Section(
        file,
        title,
        text,
        f"python benchmarks/inverse/feasibility.py --json {{file}}{options}",
        table=VERDICTS,
        rows=by("predicted", order=lambda g: not g["predicted"]),
        note=of_verdicts,
    )


SECTIONS = (
    verdicts(
        "feasibility.jsonl",
        "Verdicts before the fit",
        "Does `limits.feasibility` predict correctly whether an object can be reconstructed? "
        "Random scenes of 64 x 64 pixels, none of them used to set the constants of the forecast, "
        "were reconstructed by `tv_deconvolve` with the point spread known. The second table has "
        "the differences between the predicted correlation and that of the fit. No forecast can be "
        "much nearer to two fits than they are to each other: with other noise, the verdict of the "
        "fit itself changes in 2 of the 200 scenes.",
    ),
    verdicts(
        "feasibility_occluders.jsonl",
        "Verdicts before the fit, with occluders",
        "The same for these scenes, each with a disc, a rectangle or a ball of 4 to 30 cm between "
        "the wall and the object. It casts shadows on the object and on the wall, and into the "
        "image.",
        " --occluders",
    ),
    Section(
        "relay_modes.jsonl",
        "Modes of diffuse light past occluders",
        "Shadows of an occluder add detail to diffuse light. Modes are the independent patterns "
        "of the object that exceed the noise. Their number by `limits.feasibility` is compared "
        "with a count of singular values of the full matrix from object to image (brute force). "
        "The random scenes have a matt wall, every third one with a wide mirror-like lobe too.",
        "python benchmarks/relay_modes.py --scenes 56 --json {file}",
        table={
            "occluder": "{kind}",
            "scenes": "{count}",
            "modes": "{brute_force:min} to {brute_force:max}",
            "largest difference": largest_difference,
            "CPU time": "{cpu_seconds:median time}",
            "of brute force": "{brute_force_cpu_seconds:median time}",
        },
        rows=by("kind"),
    ),
)
