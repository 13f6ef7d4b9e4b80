# SPDX-License-Identifier: Apache-2.0
"""Random streams: from one root seed, an independent stream for each use and run."""

from __future__ import annotations

import numpy as np

# The position in this tuple is the key of the stream: append, never reorder.
_USES = ('truth', 'noise', 'detector', 'tracker', 'calibration')


def stream(seed: int, use: str, run: int = 0) -> np.random.Generator:
    """
    Return the generator of one use in one run.

    Its seed is the child that ``numpy.random.SeedSequence(seed).spawn`` yields for the run and
    then for the use; a node needs the root seed alone to get it.

    Parameters
    ----------
    seed
        Root seed of the experiment.
    use
        ``'truth'``, ``'noise'``, ``'detector'``, ``'tracker'`` or ``'calibration'``.
    run
        Number of the Monte Carlo run; a graph run is run 0.

    Raises
    ------
    ValueError
        If the use is not one of these.

    """
    if use not in _USES:
        raise ValueError(f'stream {use!r} is not one of {", ".join(_USES)}')
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, _USES.index(use))))
