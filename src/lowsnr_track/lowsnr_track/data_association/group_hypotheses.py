# SPDX-License-Identifier: Apache-2.0
"""
Joint hypotheses of tracks that may be unresolved.

A hypothesis says which tracks have an object, which of these form groups, and the detection of
each group or that it has none (:mod:`lowsnr_track.data_association.unresolved`, which defines the
symbols).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_NONE = -1
_OPEN = -2  # of a track that is still to be assigned


@dataclass(frozen=True)
class Groups:
    """
    Groups of tracks that may be unresolved, each with one detection or none.

    Parameters
    ----------
    members : (G, T) ndarray of bool
        Tracks of each group.
    cause : (G,) ndarray of int
        Its detection, -1 for none.
    connected : (G,) ndarray
        c(S), the probability that links connect its tracks.

    """

    members: np.ndarray
    cause: np.ndarray
    connected: np.ndarray

    def __getitem__(self, index: np.ndarray) -> Groups:
        """Return the groups of an index."""
        return Groups(self.members[index], self.cause[index], self.connected[index])


def group_hypotheses(gated: np.ndarray, linked: np.ndarray) -> tuple[Groups, np.ndarray]:
    """
    Return the joint hypotheses of tracks that may be unresolved.

    These are all partitions of all subsets of the tracks into groups that links may connect, each
    group with a detection in all its gates or none, and no two with the same.

    Parameters
    ----------
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.
    linked : (T, T) ndarray
        Probabilities that two objects are unresolved; 0 on the diagonal.

    Returns
    -------
    Groups
        Groups that occur.
    (H, T) ndarray of int
        Group that each track is in; -1 where it has no object.

    """
    groups = _groups(gated, connected_probability(linked))
    first = groups.members.argmax(axis=1)
    group = cause = np.full((1, len(gated)), _OPEN)
    for t in range(len(gated)):
        is_open = group[:, t] == _OPEN
        absent = np.where(np.arange(len(gated)) == t, _NONE, group[is_open])
        parts = [(group[~is_open], cause[~is_open]), (absent, cause[is_open])]
        for number in np.flatnonzero(first == t):
            members, j = groups.members[number], groups.cause[number]
            rows = is_open & (group[:, members] == _OPEN).all(axis=1)
            if j != _NONE:
                rows &= (cause != j).all(axis=1)
            parts.append((
                np.where(members, number, group[rows]), np.where(members, j, cause[rows])))
        group, cause = (np.concatenate(part) for part in zip(*parts))
    return groups, group


def _groups(gated: np.ndarray, probability: np.ndarray) -> Groups:
    """Return the groups that links may connect, (2^T,) probabilities, with their causes."""
    members = np.arange(len(probability))[:, None] >> np.arange(len(gated)) & 1 == 1
    found = [(code, j) for code in np.flatnonzero(probability) for j in (
        _NONE, *set.intersection(*map(set, gated[members[code]].tolist())) - {_NONE})]
    code, cause = np.array(found).T
    return Groups(members[code], cause, probability[code])


def log_weights(
    groups: Groups, chosen: np.ndarray, log_likelihood: np.ndarray, existence: np.ndarray,
    linked: np.ndarray,
) -> np.ndarray:
    """Return the log weights (H,) of hypotheses (H, T), from L (G,), pi_t (T,), links (T, T)."""
    exists = chosen != _NONE
    log_weight: np.ndarray = np.where(
        exists, floored_log(existence), floored_log(1.0 - existence)).sum(axis=1)
    # Each group counts once, at its first track; the last value is that of no group.
    value = np.append(floored_log(groups.connected) + log_likelihood, 0.0)
    first = np.append(groups.members.argmax(axis=1), _NONE)
    log_weight += np.where(
        first[chosen] == np.arange(chosen.shape[1]), value[chosen], 0.0).sum(axis=1)
    for s, t in np.argwhere(np.triu(linked) > 0.0):
        resolved = exists[:, s] & exists[:, t] & (chosen[:, s] != chosen[:, t])
        log_weight += resolved * floored_log(1.0 - linked[s, t])
    return log_weight


def floored_log(values: np.ndarray) -> np.ndarray:
    """Return logarithms, -708 of what is 0: impossible hypotheses keep an order."""
    logs: np.ndarray = np.log(np.maximum(values, np.finfo(float).tiny))
    return logs


def connected_probability(linked: np.ndarray) -> np.ndarray:
    """
    Return c(S), the probability that links (T, T) connect a set of tracks, of all sets.

    For the first track u of S and the last one v, with B the tracks that links connect to u
    without those of v, and q(v, B) the probability that v has no link to B::

        c(S) = sum_B c(B) (1 - q(v, B)) c(S - B) prod_(b in B, r in S - B - v) (1 - p_br)

    Returns
    -------
    (2^T,) ndarray
        Of the set of all tracks t with bit t; 0 exactly where links cannot connect it.

    """
    found = np.zeros(2**len(linked))
    for code in range(1, len(found)):
        first, last = code & -code, 1 << code.bit_length() - 1
        if first == last:
            found[code] = 1.0
            continue
        part = code & ~last
        while part:
            if part & first:
                found[code] += found[part] * found[code & ~part] * _unlinked(
                    linked, part, code & ~part & ~last) * (1.0 - _unlinked(linked, part, last))
            part = part - 1 & code & ~last
    return found


def _unlinked(linked: np.ndarray, one: int, other: int) -> float:
    """Return the probability that no link is between two sets of tracks."""
    first, second = (
        [t for t in range(len(linked)) if code >> t & 1] for code in (one, other))
    return float(np.prod(1.0 - linked[np.ix_(first, second)]))
