"""Random streams: one root seed, one independent stream for every use of it."""

from __future__ import annotations

import numpy as np

# Position in this list is the stream's key: append, never reorder.
_USES = ('truth', 'noise', 'detector', 'tracker', 'calibration')


def stream(seed: int, use: str, run: int = 0) -> np.random.Generator:
    """
    Return the generator of one use in one run.

    It is the child that ``numpy.random.SeedSequence(seed).spawn`` gives for the run and then
    for the use, reached directly, so that a node needs to know the seed only.

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
        If there is no such use.

    """
    if use not in _USES:
        raise ValueError(f'stream {use!r} is not one of {", ".join(_USES)}')
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, _USES.index(use))))
