"""Joint association by enumeration: every way to give detections to the tracks of a cluster."""

from __future__ import annotations

from lowsnr_common.core.particles import log_sum_exp
import numpy as np

_NONE = -1


def clusters(index: np.ndarray) -> list[np.ndarray]:
    """
    Return the groups of tracks that share detections, directly or through others.

    Parameters
    ----------
    index : (T, G) ndarray of int
        Gated detections of each track, -1 for none.

    Returns
    -------
    list of ndarray of int
        Tracks of each group of two or more, ascending.

    """
    track, slot = np.nonzero(index >= 0)
    if track.size == 0:
        return []
    if np.bincount(index[track, slot]).max() < 2:
        return []
    groups: list[tuple[set[int], list[int]]] = []  # detections and tracks
    for number, claims in enumerate(index.tolist()):
        found, members, apart = set(claims) - {_NONE}, [number], []
        for group in groups:
            if found.isdisjoint(group[0]):
                apart.append(group)
            else:
                found, members = found | group[0], group[1] + members
        groups = [*apart, (found, members)]
    shared = sorted(sorted(members) for _, members in groups if len(members) > 1)
    return [np.array(members) for members in shared]


def log_marginals(log_claim: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the probabilities of each track's association, over all joint hypotheses.

    A joint hypothesis gives each track a detection or none, and no detection to two tracks;
    its weight is the product of the claims it grants (Fortmann, Bar-Shalom and Scheffe 1983).

    Parameters
    ----------
    log_claim : (T, G) ndarray
        Log weight of each detection over none.
    index : (T, G) ndarray of int
        Detection of every claim, -1 for none.

    Returns
    -------
    (T, G) ndarray
        Log probability that the track has the detection.
    (T,) ndarray
        Log probability that it has none.

    """
    choice, log_weight = _hypotheses(log_claim, index)
    log_weight = log_weight - log_sum_exp(log_weight)
    # Enumerate over the slots and none at once; (H, T, G + 1).
    options = np.append(np.arange(index.shape[1]), _NONE)
    chosen = choice[..., None] == options
    beta = log_sum_exp(np.where(chosen, log_weight[:, None, None], -np.inf), axis=0)
    return beta[:, :-1], beta[:, -1]


def _hypotheses(log_claim: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the slot that each track has in each hypothesis (H, T), and its log weight (H,)."""
    tracks = len(index)
    choice = np.empty((1, 0), dtype=np.intp)
    used = np.full((1, tracks), _NONE)
    log_weight = np.zeros(1)
    for t in range(tracks):
        slots = np.append(np.flatnonzero(index[t] >= 0), _NONE)
        detection = np.where(slots >= 0, index[t, slots], _NONE)
        gain = np.where(slots >= 0, log_claim[t, slots], 0.0)
        taken = (used[:, None] == detection[:, None]).any(axis=-1) & (detection >= 0)
        parent, option = np.nonzero(~taken)
        choice = np.column_stack([choice[parent], slots[option]])
        used = used[parent]
        used[:, t] = detection[option]
        log_weight = log_weight[parent] + gain[option]
    return choice, log_weight
