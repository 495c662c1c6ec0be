"""Reconstructions: wall known, roughly known or unknown, phase retrieval, published networks."""

from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter

from .cells import Cell, Row, by, methods
from .page import Section

#: Columns of blind fits.
FITS: dict[str, Cell] = {
    "fits": "{count}",
    "above 0.9": lambda fits: sum(score > 0.9 for score in fits["correlation"]),
    "converged, not above 0.9": lambda fits: sum(
        row["status"] == "converged" and row["correlation"] <= 0.9 for row in fits["rows"]
    ),
    "median correlation": "{correlation:median n}",
    "median run time": "{seconds:median time}",
}
#: The same with processor time, for rows that were computed beside other work.
FITS_CPU = dict([*FITS.items()][:-1]) | {"median CPU time": "{cpu_seconds:median time}"}
PEERS = ("deepinv_told", "deepinv_best", "lucy_best", "wiener_best")


def largest_lead(group: Row) -> str:
    """Return by how much the best of the peers exceeds ours at most; negative if it never does."""
    return f"{max(max(row[peer] for peer in PEERS) - row['ours'] for row in group['rows']):.3f}"


by_strength = by("rms", order=lambda fits: fits["rms"])


def by_noise(found: Sequence[Row]) -> Iterator[Row]:
    """Yield, for each noise, the image itself and then each solver."""
    for noise in ("0.01", "0.05"):
        part = [row for row in found if row["case"].split()[-2] == noise]
        label = f", {float(noise):.0%}"
        images = [row["image"] for row in part]
        yield {"name": f"the image itself{label}", "correlation": images}
        for solver in by("method")(methods(part)):
            name = solver["method"].replace("skimage_", "scikit-image, ")
            yield solver | {"name": f"{name}{label}"}


def converged(low: float, high: float) -> Callable[[Row], str]:
    """Return a cell: how many results with a correlation in a range are called converged."""

    def cell(kind: Row) -> str:
        held = [row for row in kind["rows"] if low < row["correlation"] <= high]
        sure = sum(row["status"] == "converged" for row in held)
        return f"{sure} of {len(held)}" if held else ""

    return cell


SECTIONS = (
    Section(
        "known_psf.jsonl",
        "Reconstruction, point spread known",
        "How well do the solvers find the object if the wall is known? The images have 128 x 128 "
        "pixels, are blurred by smooth and by speckled point spreads, and have 1 % or 5 % noise. "
        "They are computed by another model than the one that the solvers invert. The correlation "
        "is that of the result with the true object. scikit-image's solvers run with the best of "
        "the settings tried.",
        "python benchmarks/inverse/known_psf.py --json {file}",
        table={
            "method, noise": "{name}",
            "median correlation": "{correlation:median n}",
            "lowest": "{correlation:min n}",
            "median run time": "{seconds?:median time}",
        },
        rows=by_noise,
    ),
    Section(
        "known_defaults.jsonl",
        "Reconstruction, point spread known, default settings",
        "Random objects, blur as in the previous table, noise between 0.5 and 10 %, images "
        "of 64 x 64 pixels. `tv_deconvolve` gets the image and the model only, in the next column "
        "the true noise too. The other programs know more than a user can: of several settings "
        "they run with the one whose result is closest to the true object, in the column "
        '"noise known" with the one whose residual is closest to the true noise. deepinv minimises '
        "with FISTA and total variation. The columns are median correlations with the true object, "
        "the last one is the largest lead of the best other result over ours in any case.",
        "PEER/bin/python benchmarks/inverse/known_defaults.py --cases 24 --json {file}",
        table={
            "object": "{kind}",
            "blur": "{wall}",
            "cases": "{count}",
            "nlosoptics": "{ours:median n4}",
            "noise known": "{ours_told:median n4}",
            "deepinv, noise known": "{deepinv_told:median n4}",
            "deepinv, best": "{deepinv_best:median n4}",
            "scikit-image, best Richardson-Lucy": "{lucy_best:median n4}",
            "scikit-image, best Wiener": "{wiener_best:median n4}",
            "largest lead": largest_lead,
        },
        rows=by("kind", "wall", order=lambda group: (group["kind"], group["wall"])),
    ),
    Section(
        "mismatches.jsonl",
        "Status, point spread known",
        "Does the status of a reconstruction show that the model is wrong? In each row, the image "
        "differs from the model of `tv_deconvolve` in another way (mismatch). The three columns "
        "on the right sort the results by their correlation with the true object. Each states how "
        'many of these results have the status "converged": below 0.85 few should have it, above '
        "0.93 most. Images have 64 x 64 pixels and 0.5 to 10 % noise.",
        "python benchmarks/inverse/mismatches.py --json {file} --first 94000 --cases 200 --group "
        "mismatch; the same with --first 84000 --cases 400 --group foreign, and with --first 95000 "
        "--cases 60 --kinds none",
        table={
            "mismatch": lambda group: group["kind"].replace("_", " "),
            "cases": "{count}",
            "below 0.85": converged(-1.0, 0.85),
            "0.85 to 0.93": converged(0.85, 0.93),
            "above 0.93": converged(0.93, 1.0),
        },
        rows=by("kind"),
    ),
    Section(
        "pictures.jsonl",
        "Status, example scenes",
        "Does the status accept right answers, whatever the object? In six example scenes the "
        "object is replaced by soft drawings, text in four fonts, photographs and dots, of which "
        "no constant was chosen. `simulate` makes the image and reconstructs it with the default "
        "settings.",
        "python benchmarks/inverse/pictures.py --first 700 --json {file}",
        table={
            "object": "{kind}",
            "pixels a side": "{size}",
            "answers": "{count}",
            "lowest correlation": "{correlation:min n4}",
            "above 0.93, converged": converged(0.93, 1.0),
        },
        rows=by("kind", "size", order=lambda group: (group["kind"], group["size"])),
    ),
    Section(
        "evidence_two_frames.jsonl",
        "Wall unknown, two frames",
        "How often does `evidence_fit` find object and wall from two images (frames), of which "
        "the second has a known defocus? The fits start from random walls; images have 64 x 64 "
        "pixels. The columns count the fits, those whose object has a correlation above 0.9 with "
        "the true object, and those with a lower correlation that wrongly have the status "
        '"converged". None of the walls was used to tune the fit. Walls 101 to 112 are fits of '
        "an earlier state of the search, 171 and 172 of the present one.",
        "python benchmarks/inverse/evidence.py --frames 2 --rms 0.25 0.5 1.0 --json {file}, and "
        "again with --rms 0.25 1.0 --walls 171 171 and --rms 0.25 --walls 172 172",
        table={"rms aberration, waves": "{rms}"} | FITS_CPU,
        rows=by_strength,
    ),
    Section(
        "evidence_spoilt.jsonl",
        "Wall unknown, two frames of a real camera",
        "As above. Either ten pixels of each image are hot, with up to six times the maximum of "
        "the image, or the second image is 25 % brighter or 20 % darker than the first one. "
        "Neither is stated.",
        "python benchmarks/inverse/evidence.py --frames 2 --spoilt hot --rms 0.25 0.5 1.0 --walls "
        "761 761 --json {file}, with --rms 0.5 --walls 762 764, and again with --spoilt gains",
        table={
            "images": lambda fits: {"hot": "hot pixels", "gains": "gains"}[fits["spoilt"]],
            "above 0.95": lambda fits: sum(score > 0.95 for score in fits["correlation"]),
            "lowest correlation": "{correlation:min n}",
        }
        | FITS_CPU,
        rows=by("spoilt"),
    ),
    Section(
        "evidence_noisy.jsonl",
        "Wall unknown, two frames, much noise",
        "As above, with noise of 5 % of the image's maximum in place of 1 %. A wrong wall can then "
        "leave no residual beyond the noise, so that the search must find an object twice; three "
        "walls and three objects for each rms aberration.",
        "python benchmarks/inverse/evidence.py --frames 2 --noise 0.05 --rms 0.25 0.5 1.0 --walls "
        "731 733 --json {file}",
        table={"rms aberration, waves": "{rms}"} | FITS_CPU,
        rows=by_strength,
    ),
    Section(
        "evidence_one_frame.jsonl",
        "Wall unknown, one frame",
        "`evidence_fit` for a single image (frame), otherwise as for two; twelve walls and three "
        "objects for each rms aberration.",
        "python benchmarks/inverse/evidence.py --frames 1 --rms 0.25 0.5 1.0 --walls 721 726 "
        "--json {file}, and again with --walls 741 742 and --walls 751 754",
        table={"rms aberration, waves": "{rms}"} | FITS_CPU,
        rows=by_strength,
    ),
    Section(
        "evidence_outside.jsonl",
        "Wall unknown, one frame, objects of other kinds",
        "As above for photographs, a coast, printed and written text and medical images, of which "
        "the network of wall proposals has seen none in training; two walls for each.",
        "python benchmarks/inverse/outside_objects.py FOLDER; "
        "python benchmarks/inverse/evidence.py --frames 1 --rms 0.5 --walls 305 306 "
        "--folder FOLDER --objects cat coast coins head horse phantom portrait print retina "
        "writing --json {file}",
        table={"object": "{object}"} | FITS_CPU,
        rows=by("object"),
    ),
    Section(
        "bursts.jsonl",
        "Wall unknown and rough, bursts",
        "`burst_fit` for images of one object through different parts of a rough wall, 128 x 128 "
        "pixels, in the scenes of `examples/pcin_study`. In the last rows the object turns by a "
        "quarter after half of the images.",
        "python benchmarks/inverse/bursts.py --images 6 8 16 32 --turned 16 --first 10 --walls 2 "
        "--json {file}, and with --images 16 32 --first 12 for the other walls",
        table={
            "object": lambda fits: fits["object"] + (", turned" if fits["turned"] else ""),
            "images": "{images}",
            "walls": "{count}",
            "median correlation": "{correlation:median n}",
            "lowest": "{correlation:min n}",
            "converged": lambda fits: sum(status == "converged" for status in fits["status"]),
            "median CPU time": "{cpu_seconds:median time}",
        },
        rows=lambda found: by(
            "turned", "object", "images", order=itemgetter("turned", "images", "object")
        )([{"turned": False} | row for row in found]),
    ),
    Section(
        "known_start.jsonl",
        "Wall roughly known, or several walls",
        "`evidence_fit` with additional knowledge. The groups are: near10 and near25, one image, "
        "and a wave that is known to within 0.10 or 0.25 wavelengths rms; support, as near10, and "
        "the object is known to be dark outside a mask; noise5, as near10, with 5 % noise; "
        "diversity3, three images with different known defoci; walls4, images by way of four "
        "unknown walls; calibrate, the wall is first found from a known object.",
        "python benchmarks/inverse/known_start.py --json {file} --sizes 64 --walls 1 --groups "
        "near10 near25 support diversity3 walls4 calibrate noise5",
        table={"group, pixels a side": "{group}, {size}"} | FITS,
        rows=by("group", "size", keep=lambda row: "size" in row),
    ),
    Section(
        "diffusers.jsonl",
        "Phase retrieval behind diffusers",
        "Objects from the autocorrelation of one simulated speckle image of 512 x 512 pixels. "
        '"Halves agree" is the correlation between the results of two halves of the random '
        "starts; it needs no knowledge of the object.",
        "python benchmarks/inverse/diffusers.py --walls 2 --json {file}",
        table={
            "method": "{method}",
            "fits": "{count}",
            "median correlation": "{correlation:median n}",
            "lowest": "{correlation:min n}",
            "halves agree": "{halves:median n}",
            "median run time": "{seconds:median time}",
        },
        rows=lambda found: by("method")(methods(found)),
    ),
    Section(
        "real_speckle.json",
        "Phase retrieval from measured speckle",
        "Measured images of Metzler 2020. The true objects are not known. The only test is the "
        "correlation between the results of two independent halves of the random starts.",
        "python benchmarks/inverse/real_speckle.py --json {file}",
        table={
            "measured data, method": "{object}, {method}",
            "halves agree": "{halves:n}",
            "status": "{status}",
            "run time": "{seconds:time}",
        },
        rows=itemgetter("retrieved"),
    ),
    Section(
        "wu2024.jsonl",
        "PCIN as published",
        "The physics-constrained inverse network (PCIN) of Wu 2024 fits object and wall to one "
        "image, from random angles of the wall. Here the fitted object is the blurred image "
        'itself, which the status "ambiguous" states.',
        "python benchmarks/inverse/wu2024.py --walls 1 --rms 0.25 --objects F --size 512 --json "
        "{file}",
        table={
            "case": "{object}, wall of {rms:g} waves rms, {size} x {size}",
            "correlation": "{correlation:n}",
            "of the image itself": "{image:n}",
            "status": "{status}",
            "iterations": "{iterations}",
            "run time": "{seconds:time}",
        },
    ),
)
