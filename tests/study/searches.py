"""Studies that search, for several files of tests."""

from __future__ import annotations

from pathlib import Path

from nlosoptics.study import Results, Study, run_study

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "examples" / "scenes"
CONCAVE = str(SCENES / "letter_concave.toml")
POWER = {"laser.power": {"from": "0.1 mW", "to": "10 mW"}}
PLANE = POWER | {"camera.exposure": {"from": "1 ms", "to": "2 s"}}
OFF = {"figure": "own_figures:off", "power": 3.0, "name": "off"}
METHODS = ("cobyqa", "gradient", "differential-evolution", "tpe", "nsga-ii")


def made(figures, objectives, method="cobyqa", evaluations=60, **tables) -> Study:
    """A study that minimises its objectives, if not told otherwise."""
    search = {
        "method": method,
        "evaluations": evaluations,
        "objectives": [
            {"figure": one, "goal": "minimise"} if isinstance(one, str) else one
            for one in objectives
        ],
    }
    known = ("variables", "constraints", "population")
    search |= {key: tables.pop(key) for key in known if key in tables}
    return Study.from_tables(
        {"scene": CONCAVE, "figures": figures, "optimise": search, **tables}, HERE
    )


def run(study: Study, path: Path, **options) -> Results:
    return run_study(study, path / "store", workers=0, **options)
