"""Design studies: throughput on many workers, and the fast tier."""

from collections.abc import Iterator, Sequence
from statistics import median

from tables import number, seconds

from .cells import Row, fill, filled
from .page import Section

CORES = 1000


def bottleneck(found: Sequence[Row]) -> str:
    """Return what limits the workers."""
    full = [row for row in found if row.get("share", 1.0) < 0.7]
    cpu = median(row["client"] * row["block"] for row in full)
    cores, blocks = (median(row[key] for row in full) for key in ("busy", "blocks"))
    real = next(row for row in found if row["kind"] == "measured")
    return (
        f"The client is the bottleneck. It needs {seconds(cpu)} of CPU time to write the "
        f"results of a block, so that on a core of its own it can write {number(1 / cpu, 2)} "
        f"blocks per second. In these runs it had only {number(cores, 2)} of a core, because of "
        f"other work, and wrote {number(blocks, 2)} blocks per second. The last row of each "
        "store has expensive points, with 300 workers. With a real worker, the client needs "
        f"{seconds(real['client'] * real['block'])} per block."
    )


def on_paper(found: Sequence[Row]) -> Iterator[Row]:
    """Yield what each kind of point gives on `CORES` cores, by the CPU time of one worker."""
    for row in found:
        client, worker, block = row["client"], row["worker"], row["block"]
        limit = "client" if CORES * client > worker else "workers"
        yield row | {
            "client block": client * block,
            "worker block": worker * block,
            "fed": worker / client,
            "rate": min(CORES / worker, 1 / client),
            "limit": limit,
            "needed": CORES * client * block,
        }


SECTIONS = (
    Section(
        "studies.json",
        "Design studies on up to 1,000 workers",
        "How many processes can compute a study at the same time? One client process sends blocks "
        "of points to the workers and writes their results to the store. The first row is "
        "measured with a real worker. In the others the workers only wait as long as a block "
        "would take; client, messages and store are real. The share is the throughput divided by "
        "that of workers that never wait for the client.",
        "python benchmarks/studies.py --memory /dev/shm --json {file}",
        table={
            "kind": "{kind}",
            "workers": "{workers}",
            "time for one block": lambda row: seconds(row["point"] * row["block"]),
            "client's CPU time for one point": "{client:time}",
            "cores used by the client": "{busy?:n2}",
            "blocks per second": "{blocks?:n2}",
            "share": "{share?:n2}",
        },
        note=bottleneck,
    ),
    Section(
        "study_workers.json",
        "Cost of a study, and scaling on paper",
        "What does a study add to the computation of its points, and what would 1,000 cores give? "
        "Each heavy point needs a point spread of its own; the light points share one. The loop "
        "calls `simulate` for the same scenes, which also computes the image. The second table "
        "extrapolates from the processor times of client and worker, with one worker on each core, "
        "and the client on a core of its own. The time for messages over a network is not "
        "included. The bottleneck is the client if the workers could compute more points than it "
        "can write. The last column is the time that a worker must take for a block, so that the "
        "client can keep 1,000 workers busy. Blocks are planned to take about 1 s; they take "
        "longer only if a single point does. If the client is the bottleneck, more cores help "
        "only if the study is divided into several studies, each with its own client.",
        "python benchmarks/study_workers.py --json {file}",
        table={
            "points": "{points} {kind}",
            "study, one worker": "{one:time}",
            "two workers": "{two?:time}",
            "loop": "{loop?:time}",
            "growth of the client's memory": "{grown:.2f} MiB",
        },
        note=lambda found: filled(
            {
                "points": "{kind}, {block} per block",
                "client's time for a block": "{client block:time}",
                "worker's time for a block": "{worker block:time}",
                "workers that keep the client busy": "{fed:n2}",
                "points per second, 1,000 cores": "{rate:,.0f}",
                "bottleneck": "{limit}",
                "time for a block that 1,000 workers need": "{needed:time}",
            },
            on_paper(found),
        ),
    ),
    Section(
        "fast_tier.json",
        "Tolerance draws by expanded waves",
        'The yield is the share of random draws that meet a limit. With `tier = "fast"`, the wave '
        "of each draw is computed from a Taylor series of second order in the drawn values, and "
        'the yield is corrected by 440 draws that are computed in full. The columns "in full" and '
        '"fast" are yields of the same 2,048 draws. The last columns are the corrected yield of '
        "all 16,384 draws and its 95 % interval.",
        "python benchmarks/studies.py --fast --json {file}",
        table={
            "figure of merit": "{kind}",
            "limit": "{limit:n2}",
            "in full": "{full:percent .2f} %",
            "fast": "{fast:percent .2f} %",
            "draws that differ": "{disagree}",
            "corrected yield": "{value:percent .2f} %",
            "95 % interval": "{low:percent .2f} to {high:percent .2f} %",
        },
        rows=lambda found: found[1:],
        note=lambda found: fill(
            "A draw in full takes {in full, of a draw:time} of CPU time, all {draws:,} fast ones "
            "together {fast, of all draws:time}. The whole study takes {whole study:time} of CPU "
            "time, most of it for the draws in full, and {whole study, wall:time} by two workers.",
            found[0],
        ),
    ),
)
