"""Design studies: their cost, and what many workers would give."""

from collections.abc import Iterator, Sequence

from .cells import Row, filled
from .page import Section

CORES = 1000


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
)
