# SPDX-License-Identifier: Apache-2.0
"""
A fixed lag: the answer about a frame waits for the frames after it, which are evidence too.

The memory of a detector with a lag holds what it knew after each of the last ``lag + 1`` frames,
its beliefs.  The answer is about the oldest of these, given all of them.  The last frames of a
run are answered with the later frames that there are.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import replace
import math
from typing import Any
from typing import ClassVar

from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.detector import Detector
import numpy as np

# Lower bound of the ratio r of a backward recursion: outliers may underflow it to zero, and its
# sum must have a logarithm.
LEAST_RATIO = 1e-200


@dataclass(frozen=True, kw_only=True)
class FixedLag:
    """
    The settings and steps of a detector with a lag, which defines a belief and its answer.

    ``costly`` names the settings that its number of states depends on.
    """

    costly: ClassVar[tuple[str, ...]] = ()

    lag: int = setting(
        0, 'frames by which the answer is late: it is about the frame so many frames ago', ge=0,
        le=20)

    @property
    def state_planes(self) -> int:
        """Return the number of states in a cell."""
        raise NotImplementedError

    @property
    def step_arrays(self) -> int:
        """Return how many arrays of all states a step makes, beside the beliefs that it keeps."""
        return 2

    def memory_bytes(self, shape: tuple[int, int]) -> int:
        """Return the memory that the states take in frames of a shape (rows, cols)."""
        arrays = self.lag + 1 + self.step_arrays
        return 8 * self.state_planes * math.prod(shape) * arrays

    def init(self, shape: tuple[int, ...]) -> tuple[Any, ...]:
        """Return the beliefs of the last ``lag + 1`` frames, none at first."""
        return ()

    def step(
        self, state: tuple[Any, ...], frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[tuple[Any, ...], Declarations]:
        """
        Advance by a frame and declare what was there ``lag`` frames ago.

        Parameters
        ----------
        state : tuple
            Beliefs after the last frames, the newest last.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Not used; the filter is deterministic.

        """
        last = state[-1] if state else None
        state = (*state[max(len(state) - self.lag, 0):], self.filtered(last, frame))
        declared = self.smoothed(state)
        return state, declared if len(state) > self.lag else nothing(declared)

    def flush(self, state: tuple[Any, ...]) -> list[Declarations]:
        """Return the answers about the frames that have none yet, the oldest first."""
        first = len(state) - min(len(state), self.lag)
        return [self.smoothed(state[number:]) for number in range(first, len(state))]

    def filtered(self, last: Any, frame: np.ndarray) -> Any:
        """Return the belief after a frame, given that before it; None before the first."""
        raise NotImplementedError

    def smoothed(self, beliefs: tuple[Any, ...]) -> Declarations:
        """Declare what was there in the frame of the first belief, given all of them."""
        raise NotImplementedError


def nothing(declared: Declarations) -> Declarations:
    """Return declarations of the same shape that declare nothing."""
    return replace(
        declared, peak=np.full_like(declared.peak, -np.inf), score=np.zeros_like(declared.score),
        state=np.full_like(declared.state, np.nan), cov=np.full_like(declared.cov, np.nan))


def lag_of(detector: Any) -> int:
    """Return the frames by which the answers of a detector are late."""
    return detector.lag if isinstance(detector, FixedLag) else 0


def flushed(detector: Any, state: Any) -> list[Declarations]:
    """Return the answers of a detector about the frames that have none yet, the oldest first."""
    return detector.flush(state) if isinstance(detector, FixedLag) else []


def answers(
    detector: Detector, frames: Iterable[np.ndarray], rng: np.random.Generator,
) -> Iterator[Declarations]:
    """Yield the answer of a detector about every frame (..., rows, cols), in their order."""
    state, lag = None, lag_of(detector)
    for number, frame in enumerate(frames):
        if number == 0:
            state = detector.init(frame.shape)
        state, declared = detector.step(state, frame, rng)
        if number >= lag:
            yield declared
    yield from flushed(detector, state)
