"""Bounds of the stateful tests, which try random steps in random order."""

from hypothesis import HealthCheck, Phase, settings


def bounded(*, examples: int, steps: int) -> settings:
    """Settings for so many sequences of so many steps, the same at every run."""
    return settings(
        max_examples=examples,
        stateful_step_count=steps,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=[HealthCheck.too_slow],
    )
