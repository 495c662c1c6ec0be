"""Forecasts of `limits.feasibility`: verdicts, correlations and modes of diffuse light."""

from statistics import median

from .cells import Row, by
from .page import Section


def largest_difference(part: Row) -> str:
    """Return a cell: the largest relative difference from the count by brute force."""
    pairs = zip(part["modes"], part["brute_force"], strict=True)
    return f"{max(abs(modes - count) / max(count, 1) for modes, count in pairs):.0%}"


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
    )


#: Kinds of scenes of `benchmarks/inverse/shadows.py`.
SHADOWS = {
    "one": "one disc",
    "three": "three discs",
    "ambient": "three discs, light of the room",
    "unknown": "one disc, place unknown",
    "random": "one to three discs, 0.2 to 100 ms",
}


SECTIONS = (
    verdicts(
        "feasibility.jsonl",
        "Verdicts before the fit",
        "Does `limits.feasibility` predict correctly whether an object can be reconstructed? "
        "Random scenes of 64 x 64 pixels, none of them used to set the constants of the forecast, "
        "were reconstructed by `tv_deconvolve` with the point spread known. With other noise, the "
        "verdict of the fit itself changes in 2 of the 200 scenes.",
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
    Section(
        "shadows.jsonl",
        "Pictures from shadows",
        "Letters and drawings 1 m from a matt wall of 64 x 64 pixels, past one disc of 12 cm, past "
        "three discs, past three discs in light of the room that is ten times the signal, and past "
        "a disc whose place is known to 5 cm. In the last row, discs of any size, distances and "
        "exposures are random, and the correlation is compared with that of the forecast. A "
        "registered correlation allows for a shift.",
        "python benchmarks/inverse/shadows.py one three ambient --first 700 --scenes 10 --json "
        "{file}, then unknown --first 1500 --scenes 50, and random --first 1900 --scenes 60",
        table={
            "light and occluders": lambda g: SHADOWS[g["kind"]],
            "scenes": "{count}",
            "median correlation": lambda g: f"{median(g['raw']):.3f}",
            "registered": lambda g: f"{median(g['registered']):.3f}",
            "converged": lambda g: sum(set(s.split()) == {"converged"} for s in g["status"]),
            "of these below 0.8, registered": lambda g: sum(
                set(row["status"].split()) == {"converged"} and row["registered"] < 0.8
                for row in g["rows"]
            ),
            "median error of the place": lambda g: (
                f"{median(row['mm off'] for row in g['rows']):.1f} mm"
                if g["kind"] == "unknown"
                else ""
            ),
            "forecasts within 0.07": lambda g: (
                sum(abs(row["forecast"] - row["raw"]) < 0.07 for row in g["rows"])
                if g["kind"] == "random"
                else ""
            ),
            "verdicts right": lambda g: (
                sum((row["forecast"] >= 0.9) == (row["raw"] >= 0.9) for row in g["rows"])
                if g["kind"] == "random"
                else ""
            ),
        },
        rows=by("kind", order=lambda g: list(SHADOWS).index(g["kind"])),
    ),
)
