# SPDX-License-Identifier: Apache-2.0
"""Which nodes of a run a host runs, and what all parts must have in common."""

from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.plan.parts import part_of
import pytest

ONE = run_nodes(['sdt'])
TWO = run_nodes(['cdt', 'sdt'], viewed=True)


def labels(nodes):
    """Return the labels of nodes."""
    return [node.label for node in nodes]


def test_without_options_the_whole_run_is_here():
    part = part_of(ONE, {}, [], [])
    assert part.own == tuple(ONE)
    assert not part.expected
    assert (part.label, part.manager, part.evaluates) == ('', 'bringup', True)


def test_what_is_not_expected_runs_here_in_the_order_of_the_run():
    part = part_of(ONE, {}, [], ['sdt'])
    assert labels(part.own) == ['evaluator', 'tracker', 'sensor']
    assert labels(part.expected) == ['sdt_detector']
    assert part.evaluates


def test_parts_of_a_run_have_bringups_of_different_names():
    named = [part_of(TWO, {}, only, [node.label for node in TWO if node.label not in only])
             for only in (['evaluator', 'sensor'], labels(TWO[1:4]), labels(TWO[4:7]))]
    assert len({part.manager for part in named}) == 3
    assert [part.evaluates for part in named] == [True, False, False]
    assert sorted(node.label for part in named for node in part.own) == sorted(labels(TWO))


@pytest.mark.parametrize(('name', 'count'), [
    ('cdt.tracker', 1), ('tracker', 2), ('cdt', 1), ('sdt_detector', 1), ('viewer', 2)])
def test_name_stands_for_one_node_or_for_that_of_every_chain(name, count):
    assert len(part_of(TWO, {}, [], [name]).expected) == count


@pytest.mark.parametrize(('only', 'expect', 'words'), [
    (['sdt'], [], 'evaluator, tracker, sensor: neither'),
    (['sdt', 'sensor'], ['evaluator', 'tracker', 'sdt'], 'sdt_detector: in'),
    ([], ['evaluator', 'tracker', 'sdt', 'sensor'], 'all nodes'),
    ([], ['recorder'], '--expect recorder'), (['a\nb'], [], '--only')])
def test_lists_that_leave_no_part_are_refused_in_one_line(only, expect, words):
    with pytest.raises(ValueError) as caught:
        part_of(ONE, {}, only, expect)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_digest_changes_with_what_all_parts_share_and_with_nothing_of_one_host():
    def digest(**values):
        base = {'seed': 0, 'bag': '/a', 'results': '/r'}
        return part_of(ONE, {'/sensor': base | values}, [], ['sdt']).options
    assert digest() == digest(bag='/b', results='/s', page_port=3)
    assert digest() != digest(seed=1)
    assert Part(()).evaluates


def test_digest_depends_on_name_and_content_of_a_scenario_and_not_on_its_folder(tmp_path):
    def digest(folder, content, name='s'):
        path = tmp_path / folder / 'file.yaml'
        path.parent.mkdir(exist_ok=True)
        path.write_text(content)
        return part_of(ONE, {'/evaluator': {'scenario': name}, '/sensor': {'scenario': str(path)}},
                       [], ['sdt']).options
    assert digest('a', 'rows: 20') == digest('b', 'rows: 20')
    assert len({digest('a', content, name) for content, name in (
        ('rows: 20', 's'), ('rows: 21', 's'), ('rows: 20', 't'))}) == 3
