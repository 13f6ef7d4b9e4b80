# SPDX-License-Identifier: Apache-2.0
"""Every row of the table of what can happen, in docs/operations.md, names a test that is there."""

import ast
from pathlib import Path
import re

ROOT = Path(__file__).resolve().parents[1]
HEADER = '| what can happen | what the user sees | what is lost | held by |'
TEST = re.compile(r'`(test_\w+\.py)::(test_\w+)`')


def rows():
    """Return the cells of every row of the table."""
    table = (ROOT / 'docs' / 'operations.md').read_text().split(HEADER)[1].split('\n\n')[0]
    return [[cell.strip() for cell in line.strip('|').split('|')]
            for line in table.splitlines()[2:]]


def test_every_row_is_held_by_a_test_that_is_there():
    assert len(rows()) > 25
    tests = {
        (path.name, node.name) for path in (ROOT / 'test').rglob('test_*.py')
        for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)}
    for happens, seen, lost, held in rows():
        assert happens
        assert seen
        assert lost
        assert TEST.fullmatch(held), held
        assert TEST.fullmatch(held).groups() in tests, held
