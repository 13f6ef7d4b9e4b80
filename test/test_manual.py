# SPDX-License-Identifier: Apache-2.0
"""What the manual takes from the sources: parameters, links, formulas and public names."""

import importlib
from pathlib import Path
import runpy
from xml.etree import ElementTree

from lowsnr_bringup.plan.graph import known_nodes
from lowsnr_bringup.plan.graph import settings_classes
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.node_settings import NodeSettings
import pytest

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = """
import os
CONSTANT = 1
def public(): ...
def _private(): ...
class Public:
    def method(self): ...
    def _own(self): ...
    def __init__(self): ...
class _Private:
    def method(self): ...
"""


@pytest.fixture
def extension(monkeypatch):
    """Return a function that imports an extension of the manual."""
    monkeypatch.syspath_prepend(ROOT / 'docs' / 'extensions')
    return importlib.import_module


def cells(lines):
    """Return the rows of a table, without its head."""
    rows = []
    for line in lines:
        if line.startswith('   * - '):
            rows.append([])
        if line.startswith(('   * - ', '     - ')):
            rows[-1].append(line[7:])
    return rows[1:]


@pytest.mark.parametrize('name', known_nodes())
def test_every_parameter_of_a_node_has_a_row(extension, name):
    classes = settings_classes(name)
    rows = cells(extension('node_pages').parameters(classes, live=True))
    declared = [item for cls in classes for item in declared_settings(cls).values()]
    assert [row[0] for row in rows] == [f'``{item.name}``' for item in declared]
    assert [row[5] == 'yes' for row in rows] == [item.live for item in declared]
    assert all(row[1] and row[6] for row in rows)


@pytest.mark.parametrize(('key', 'row'), [
    ('silence_s', ('``silence_s``', 'double', '``10.0``', '(0.0, inf)', 's', '')),
    ('queue_depth', ('``queue_depth``', 'integer', '``1000``', '[1, 100000]', '', '')),
    ('autostart', ('``autostart``', 'bool', '``true``', '', '', ''))])
def test_row_of_a_parameter(extension, key, row):
    item = declared_settings(NodeSettings)[key]
    assert extension('node_pages').row(item, live=True)[:6] == row


def test_live_is_stated_only_of_nodes_that_take_it(extension):
    item = next(item for item in declared_settings(settings_classes('tracker')[-1]).values()
                if item.live)
    pages = extension('node_pages')
    assert (pages.row(item, live=True)[5], pages.row(item, live=False)[5]) == ('yes', '')


def test_public_names_are_those_without_underscore(extension):
    names = extension('public_names')
    assert list(names.public_names(SAMPLE)) == ['public', 'Public', 'Public.method']


def test_public_name_without_a_page_is_missed(extension):
    names = extension('public_names')
    every = set(names.missing_names(set()))
    assert {'lowsnr.api.track', 'lowsnr_detect.detectors.sdt.SDT.statistic'} <= every
    assert list(names.missing_names(every)) == []
    assert list(names.missing_names(every - {'lowsnr.api.track'})) == ['lowsnr.api.track']


@pytest.mark.parametrize(('link', 'becomes'), [
    ('[c](../config)', '[c](generated/configuration.rst)'),
    ('[s](../config/scenarios)', '[s](generated/scenarios.rst)'),
    ('[p](../src/lowsnr_track/lowsnr_track)',
     '[p](generated/api/lowsnr_track/lowsnr_track.rst)'),
    ('[d](../src/lowsnr_detect/lowsnr_detect/detectors)',
     '[d](generated/api/lowsnr_detect/lowsnr_detect.detectors.rst)'),
    ('[b](../benchmarks)', 'b'),
    ('[f](../config/tracker.yaml)', '[f](../config/tracker.yaml)'),
    ('[o](operations.md#who-may-get-in)', '[o](operations.md#who-may-get-in)')])
def test_link_to_a_folder_leads_to_its_page(extension, link, becomes):
    links = extension('repository_links')
    assert links.LINK.sub(links.page_of, link) == becomes


@pytest.mark.parametrize(('text', 'addresses'), [
    ('<script src="https://cdn.example/x.js">', ['https://cdn.example/x.js']),
    ('<link rel="stylesheet" href="//cdn.example/x.css">', ['//cdn.example/x.css']),
    ('@import url("https://fonts.example/a");', ['https://fonts.example/a']),
    ('<a href="https://example.org">link</a><img src="_images/a.png">', [])])
def test_what_a_page_loads_from_elsewhere_is_seen(extension, text, addresses):
    assert list(dict.fromkeys(extension('offline').loaded(text))) == addresses


def test_formula_is_mathml(extension):
    root = ElementTree.fromstring(extension('mathml').tex2mathml(r'\frac{I^2}{\sigma^2}'))
    names = [item.tag.rpartition('}')[2] for item in root.iter()]
    assert names[0] == 'math'
    assert (names.count('mfrac'), names.count('msup')) == (1, 2)


def test_page_of_a_node_that_is_gone_is_removed(extension, tmp_path):
    for name in ('index', 'sensor', 'memory_detector'):
        (tmp_path / f'{name}.rst').touch()
    extension('node_pages').remove_others(tmp_path, {'index', 'sensor', 'tracker'})
    assert {path.stem for path in tmp_path.iterdir()} == {'index', 'sensor'}


def test_manual_is_built_unless_tests_are_named(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / 'scripts')
    command = runpy.run_path(str(ROOT / 'scripts' / 'test.py'))
    assert '--fail-on-warning' in command['checks']([])['manual']
    assert 'manual' not in command['checks'](['test/detect'])
