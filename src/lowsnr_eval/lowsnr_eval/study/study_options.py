"""What a user asks of a study, and how many runs follow from that."""

from __future__ import annotations

from dataclasses import dataclass

_LEAST_RUNS = 10


@dataclass(frozen=True)
class StudyOptions:
    """What a user asks for; None where the example decides."""

    example: int
    runs: int = 500
    snrs_db: tuple[float, ...] | None = None
    detectors: tuple[str, ...] | None = None
    seed: int = 0

    @property
    def few_runs(self) -> int:
        """Return the runs of whatever is beyond the paper's own comparisons."""
        return min(self.runs, max(_LEAST_RUNS, self.runs // 20))

    @property
    def empty_runs(self) -> int:
        """Return the runs without the object, for the paper's own comparisons."""
        return min(self.runs, max(_LEAST_RUNS, self.runs // 10))

    @property
    def crowded_runs(self) -> int:
        """Return the runs in which a chain that declares dozens of objects is tracked."""
        return min(self.runs, max(2, self.runs // 50))
