# SPDX-License-Identifier: Apache-2.0
"""YAML of any kind is accepted, or refused with one line that names the file."""

import copy
import functools
from pathlib import Path
import re

from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.strategies import damaged
from fuzz.strategies import numbers
from fuzz.strategies import whole
from fuzz.strategies import wild_names
from hypothesis import strategies as st
from lowsnr_bringup.plan.config_files import CONFIG_FILES
from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.config_files import load_overrides
from lowsnr_bringup.plan.graph import known_nodes
from lowsnr_bringup.plan.graph import settings_classes
from lowsnr_common.settings.declare import declared_settings
from lowsnr_sensor.scenario import load_scenario
import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SCENARIOS = sorted((CONFIG / 'scenarios').glob('*.yaml'))
BOMB = 'a: &a [x, x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{new}: &{new} [{", ".join([f"*{old}"] * 10)}]\n' for old, new in zip('abcdefgh', 'bcdefghi'))
MERGE_BOMB = 'a: &a {x: 1}\n' + ''.join(
    f'{new}: &{new} {{<<: [{", ".join([f"*{old}"] * 10)}]}}\n'
    for old, new in zip('abcdefgh', 'bcdefghi'))
# YAML that is no value of any setting.
NASTY = [
    '', '\0', '\t', '---', '--- 1\n--- 2', '...', '&a [*a]', '&a {b: *a}', '? &a [*a]\n: 1',
    '&a {*a : 1}', '*a', '<<: 1', '{<<: [1]}', '!!python/object:os.system x', '!!python/name:os',
    '!!python/object/apply:os.system ["touch x"]', '!!set {a, b}', '!!omap [a: 1]',
    '!!pairs [a: b]', '!!binary "!"', '!!timestamp x', '!!int ""', '!!int "1_"', '!!float "x"',
    '!!bool x', '!!null x', '!!map x', '!!seq x', '!!str [1]', '!x y', '2001-99-99',
    '2001-12-14t21:59:43+99:99', '=', '{? {}: 1}', '{[1]: 1}', '{1: 1, a: 1}', '{null: 1}',
    '{2001-01-01: 1}', '1e400', '.inf', '.nan', '-.inf', '0x' + 'f' * 5000, '9' * 5000,
    '1:' * 3000 + '1.0', '0o8', '0b', '0b2', '"\\ud800"', '"\\0"', '"\\e[2J"', '"a\\nb"',
    '[' * 1500, '{a: ' * 1500, '- ' * 1500, 'a: ' * 9, "'", '"', '|', '>', '@', '`',
    '%YAML 9.9\n---\n1', '%TAG ! x\n---\n!y 1', BOMB, MERGE_BOMB, '{a: 1, a: 2}', '\ufeffa: 1']
nasty = st.sampled_from(NASTY)
scalars = st.none() | st.booleans() | whole.filter(lambda n: abs(n) < 10**400) | numbers | (
    wild_names) | st.dates() | st.binary(max_size=4)
trees = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
        st.text(max_size=6) | st.integers() | st.booleans() | st.none(), inner, max_size=4),
    max_leaves=12)
dumped = trees.map(yaml.safe_dump)
SETTINGS = sorted({
    (node, key) for node in known_nodes() for cls in settings_classes(node)
    for key in declared_settings(cls)})


@functools.cache
def shipped(path):
    """Return the bytes of a file and its content."""
    data = path.read_bytes()
    return data, yaml.safe_load(data)


@st.composite
def files(draw, paths):
    """Draw the bytes of a file: any bytes, any YAML, or a shipped file, damaged or changed."""
    data, tree = shipped(draw(st.sampled_from(paths)))
    how = draw(st.integers(0, 6))
    if how == 0:
        return draw(st.binary(max_size=200))
    if how == 1:
        return draw(nasty | dumped).encode('utf-8', 'surrogatepass')
    if how == 2:
        return draw(damaged(data))
    if how == 3:  # another number, wherever the old one is
        old = draw(st.sampled_from(sorted(set(re.findall(rb'\b\d+\b', data)))))
        return data.replace(old, str(draw(whole | numbers)).encode())
    tree = copy.deepcopy(tree)
    replace_somewhere(draw, tree)
    text = yaml.safe_dump(tree)
    if how == 4:  # instead of a value, a text that no dump would write
        text = text.replace('PLACE', draw(nasty))
    return text.encode('utf-8', 'surrogatepass')


def replace_somewhere(draw, tree):
    """Put another value or key somewhere into a tree."""
    node = tree
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = draw(st.sampled_from(keys))
        deeper = isinstance(node[key], (dict, list)) and node[key]
        if not deeper or draw(st.integers(0, 3)) == 0:
            break
        node = node[key]
    value = draw(st.just('PLACE') | trees)
    if isinstance(node, dict) and draw(st.integers(0, 3)) == 0:
        key = draw(st.text(max_size=5) | st.sampled_from(['objects', 'random', 'id', '<<']))
    node[key] = value


@pytest.fixture
def config(place):
    """Return a folder with empty parameter files."""
    for name in CONFIG_FILES:
        (place / name).touch()
    return place


@fuzz('parameter files', 420, name=st.sampled_from(CONFIG_FILES),
      data=files([CONFIG / name for name in CONFIG_FILES]))
def test_parameter_file_is_accepted_or_refused(config, name, data):
    (config / name).write_bytes(data)
    try:
        found = tried(config / name, load_config, config)
    finally:
        (config / name).write_bytes(b'')
    for section, values in (found or {}).items():
        assert section == '/**' or section in known_nodes()
        assert all(isinstance(key, str) for key in values)


@fuzz('scenario files', 900, data=files(SCENARIOS))
def test_scenario_file_is_accepted_or_refused(place, data):
    path = place / 'scenario.yaml'
    path.write_bytes(data)
    tried(path, load_scenario, path)


@fuzz('overrides', 900, target=st.sampled_from(SETTINGS) | st.tuples(wild_names, wild_names),
      value=nasty | dumped | wild_names)
def test_override_of_any_setting_is_accepted_or_refused(target, value):
    node, key = target
    detectors = [name.removesuffix('_detector') for name in known_nodes() if '_detector' in name]
    text = f'{node.removesuffix("_detector")}.{key}={value}'
    tried('--set ', load_overrides, [text], detectors)


@fuzz('overrides', 300, text=wild_names | nasty)
def test_any_override_is_accepted_or_refused(text):
    tried('--set ', load_overrides, [text], ['sdt'])
