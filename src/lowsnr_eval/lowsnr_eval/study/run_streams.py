"""The random streams of many runs as one, so that a batch draws what each run alone would."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from typing import Any

import numpy as np


class RunStreams:
    """
    Generators side by side: the first axis of what is drawn is the run.

    It has those methods of :class:`numpy.random.Generator` that detectors draw with.  Run r
    gets from them what its own generator gives for the shape without the first axis.

    Parameters
    ----------
    generators
        One for each run.

    """

    def __init__(self, generators: Sequence[np.random.Generator]) -> None:
        self._generators = tuple(generators)

    def random(self, size: Sequence[int]) -> np.ndarray:
        """Draw uniform numbers in [0, 1), (runs, ...)."""
        return self._draw(lambda own, shape: own.random(shape), size)

    def standard_normal(self, size: Sequence[int]) -> np.ndarray:
        """Draw normal numbers of mean 0 and variance 1, (runs, ...)."""
        return self._draw(lambda own, shape: own.standard_normal(shape), size)

    def uniform(self, low: Any, high: Any, size: Sequence[int]) -> np.ndarray:
        """Draw uniform numbers between bounds that are the same for every run, (runs, ...)."""
        return self._draw(lambda own, shape: own.uniform(low, high, shape), size)

    def integers(self, high: int, size: Sequence[int]) -> np.ndarray:
        """Draw whole numbers from 0 to below ``high``, (runs, ...)."""
        return self._draw(lambda own, shape: own.integers(high, size=shape), size)

    def _draw(
        self, draw: Callable[[np.random.Generator, tuple[int, ...]], np.ndarray],
        size: Sequence[int],
    ) -> np.ndarray:
        runs, *shape = size
        if runs != len(self._generators):
            raise ValueError(f'size {tuple(size)} must start with {len(self._generators)} runs')
        return np.stack([draw(own, tuple(shape)) for own in self._generators])
