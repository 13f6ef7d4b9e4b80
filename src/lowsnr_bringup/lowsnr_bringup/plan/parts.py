# SPDX-License-Identifier: Apache-2.0
"""The parts of a run: which of its nodes this host runs, and which ones other hosts run."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
import hashlib
from pathlib import Path

from lowsnr_bringup.plan.config_files import to_yaml
from lowsnr_bringup.plan.graph import MANAGER
from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.graph import node_of
from lowsnr_bringup.plan.graph import Values
from lowsnr_common.settings.text import did_you_mean
from lowsnr_common.settings.text import one_line

# Parameters that may differ from host to host: paths, and how a live page is shown.
_OF_A_HOST = ('bag', 'truth_bag', 'results', 'run_parameters', 'page_port', 'browser')


@dataclass(frozen=True)
class Part:
    """
    The part of a run that one host runs.

    ``nodes`` are those of the whole run, subscribers before publishers, and ``expected`` those
    that other hosts run.  ``options`` is a digest of what all parts must have in common.
    """

    nodes: tuple[Node, ...]
    expected: frozenset[Node] = frozenset()
    options: str = ''

    @property
    def own(self) -> tuple[Node, ...]:
        """Return the nodes that run here, in order."""
        return tuple(node for node in self.nodes if node not in self.expected)

    @property
    def label(self) -> str:
        """Return the name for people and folders; empty for a part with the evaluator."""
        return '' if self.evaluates else self.own[0].label

    @property
    def manager(self) -> str:
        """Return the name of the node of this part's bring-up."""
        return f'{MANAGER}_{self.label.replace(".", "_")}' if self.label else MANAGER

    @property
    def evaluates(self) -> bool:
        """Return whether the results of the run are this part's: it has the evaluator."""
        return not self.expected or any(node.name == 'evaluator' for node in self.own)


def part_of(
    nodes: Sequence[Node], parameters: Mapping[str, Values], only: Sequence[str],
    expect: Sequence[str],
) -> Part:
    """
    Return the part of a run that ``--only`` and ``--expect`` leave to this host.

    Parameters
    ----------
    nodes, parameters
        Those of the whole run.
    only, expect
        Names of nodes that run here and elsewhere, as :func:`_named` takes them.  Without
        ``only`` all that is not expected runs here.

    Raises
    ------
    ValueError
        One line, if a name is unknown, a node is in both lists or in neither, or no node is left
        for this host.
    OSError
        If the file of the scenario cannot be read.

    """
    expected = _named('--expect', expect, nodes)
    own = _named('--only', only, nodes) if only else [
        node for node in nodes if node not in expected]
    if both := _labels(node for node in own if node in expected):
        raise ValueError(f'{both}: in --only and in --expect: a node runs on one host')
    if missing := _labels(node for node in nodes if node not in own and node not in expected):
        raise ValueError(
            f'{missing}: neither in --only nor in --expect: --expect {missing.replace(",", "")} '
            'if another host runs them')
    if not own:
        raise ValueError('--expect: names all nodes of the run; one at least must run here')
    return Part(tuple(nodes), frozenset(expected), _digest(parameters))


def _named(option: str, names: Iterable[str], nodes: Sequence[Node]) -> list[Node]:
    """
    Return the nodes of these names.

    ``cdt.tracker`` is one node; ``tracker`` is the tracker of every chain, and ``cdt``, as in
    ``--set``, the node of a detector.
    """
    found = []
    for name in names:
        fits = [node for node in nodes if name in (node.label, node.name)
                or node.name == node_of(name)]
        if not fits:
            known = [node.label for node in nodes]
            raise ValueError(
                f'{option} {one_line(name)}: is not a node of this run, which has '
                f'{", ".join(known)}{did_you_mean(name, known)}')
        found += fits
    return found


def _labels(nodes: Iterable[Node]) -> str:
    return ', '.join(node.label for node in nodes)


def _digest(parameters: Mapping[str, Values]) -> str:
    """
    Return a digest of the parameters that all parts must have in common.

    The path of a scenario may differ and its content may not.  Of a bag, only the source reads
    more than what other parameters hold: name, size and number of frames.
    """
    common = {path: {key: value for key, value in values.items() if key not in _OF_A_HOST}
              for path, values in parameters.items()}
    if scenario := common.get('/sensor', {}).get('scenario'):
        content = Path(scenario).read_bytes()
        common['/sensor']['scenario'] = hashlib.sha256(content).hexdigest()
    return hashlib.sha256(to_yaml(common).encode()).hexdigest()[:16]
