# SPDX-License-Identifier: Apache-2.0
"""What an earlier process left in a results folder, validated: each error names its file."""

from __future__ import annotations

from collections import Counter
import csv
import json
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.plan.graph import node_of
from lowsnr_bringup.run import results_folder as files
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import NodeSettings
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import read_yaml

_MOST_FRAMES = 2**53


def evaluator_parameters(folder: Path) -> dict[str, Any]:
    """Return the parameters of the evaluator; ValueError names a file without sound ones."""
    path = folder / files.PARAMETERS_FILE
    tree = read_yaml(path)
    try:
        values = dict(tree['/evaluator']['ros__parameters'].items())
    except (LookupError, TypeError, AttributeError):
        raise ValueError(f'{path}: holds no parameters of an evaluator') from None
    for cls in (NodeSettings, RunSettings, Evaluation):
        build(cls, values, f'{path}: evaluator')
    return values


def earlier_counts(folder: Path) -> dict[str, int]:
    """Return the numbers of frames in an earlier summary; nothing where it is not sound."""
    try:
        text = (folder / files.SUMMARY_FILE).read_text(encoding='utf-8')
        counts = dict(json.loads(text)['frames'].items())
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}
    sound = all(type(n) is int and 0 <= n < _MOST_FRAMES for n in counts.values() if n is not None)
    return counts if sound else {}


def earlier_alarm_rates(folder: Path) -> dict[str, AlarmRate]:
    """Return the false-alarm rates in an earlier summary that are sound, by node."""
    try:
        text = (folder / files.SUMMARY_FILE).read_text(encoding='utf-8')
        chains = dict(json.loads(text)['detectors'].items())
        found = {node_of(name): (figures['pfa_asked'], figures['pfa_measured'])
                 for name, figures in chains.items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}
    return {name: AlarmRate(*shares) for name, shares in found.items() if all(
        share is None or (type(share) is float and 0.0 <= share <= 1.0) for share in shares)}


def earlier_restarts(folder: Path) -> Counter[str]:
    """Return how often each node was started again; ValueError names a damaged file."""
    path = folder / files.RESTARTS_FILE
    if not path.is_file():
        return Counter()
    try:
        with path.open(encoding='utf-8', newline='') as file:
            return Counter(one_line(row['node']) for row in csv.DictReader(file))
    except (OSError, ValueError, LookupError, csv.Error) as error:
        raise ValueError(f'{path}: is not the table of the restarts: '
                         f'{type(error).__name__} {one_line(error)}') from None
