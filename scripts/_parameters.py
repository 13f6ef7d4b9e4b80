# SPDX-License-Identifier: Apache-2.0
"""
The table of all parameters of all nodes, which answers also where nothing is installed yet.

``metadata.py`` writes it from the declarations and the files in config/.  Its values hold as long
as those files are the ones that they were read from; names, meaning and bounds always.
"""

from collections.abc import Iterable
from collections.abc import Iterator
import functools
import hashlib
import json
from pathlib import Path
from typing import Any

TABLE = Path(__file__).with_name('parameters.json')
ALL = 'all'  # stands for every node
_Row = tuple[str, str, str, str]  # parameter, value, what is allowed, meaning


def config_digest(config: Path) -> str:
    """Return the digest of the parameter files of a folder."""
    found = hashlib.sha256()
    for path in sorted(config.glob('*.yaml')):
        found.update(path.read_bytes())
    return found.hexdigest()


def listed(config: Path, detectors: Iterable[str]) -> list[tuple[str, str, str, str]] | None:
    """
    Return what ``describe_parameters`` yields, as text: ``NODE.PARAMETER``, value and so on.

    None where the parameter files were changed, or a detector is newer than the table.
    """
    table = _table()
    detectors = list(detectors)
    if table['config'] != config_digest(config) or not table['detectors'].keys() >= {*detectors}:
        return None
    found = [(name, table['detectors'][name]) for name in detectors] + [*table['nodes'].items()]
    return [(f'{node}.{row[0]}', *row[1:]) for node, own in found
            for row in (table['rows'][number] for number in own)]


def names(node: str) -> set[str]:
    """Return the parameters of a detector, of another node or of all; none of an unknown node."""
    table = _table()
    nodes = table['detectors'] | table['nodes']
    own = nodes.get(node, ()) if node != ALL else range(len(table['rows']))
    return {table['rows'][number][0] for number in own}


def as_table(digest: str, detectors: dict[str, list[_Row]], nodes: dict[str, list[_Row]]) -> str:
    """Return the text of the table; each row is written once, and nodes name their rows."""
    numbers: dict[_Row, int] = {}

    def numbered(own: dict[str, list[_Row]]) -> Iterator[str]:
        for name, rows in own.items():
            found = [numbers.setdefault(row, len(numbers)) for row in rows]
            yield f'{json.dumps(name)}: {json.dumps(found)}'

    parts = {'detectors': [*numbered(detectors)], 'nodes': [*numbered(nodes)]}
    groups = [f'"{key}": {{\n{_lines(lines)}\n}}' for key, lines in parts.items()]
    rows = _lines(map(json.dumps, numbers))
    return '{\n' + ',\n'.join(
        [f'"config": "{digest}"', f'"rows": [\n{rows}\n]', *groups]) + '\n}\n'


def _lines(items: Iterable[str]) -> str:
    return ',\n'.join(items)


@functools.cache
def _table() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(TABLE.read_text(encoding='utf-8'))
    return found
