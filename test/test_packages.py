# SPDX-License-Identifier: Apache-2.0
"""What package.xml and setup.py say is what the code is."""

import ast
from importlib import import_module
from pathlib import Path
import re
import runpy
import sys
from unittest import mock
import xml.etree.ElementTree as ElementTree

import _environment
import _venv
import lowsnr
from lowsnr_bringup.cli import commands
from lowsnr_bringup.cli.executables import own_executables
import lowsnr_detect.detectors  # noqa: F401  (its files register themselves)
from lowsnr_detect.parts.registry import DETECTORS
import metadata
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent.name for path in (ROOT / 'src').glob('*/package.xml'))
# What package.xml and setup.py both state.
STATED = ('name', 'version', 'license', 'description', 'maintainer')
# The rosdep key of an imported module, where it is not the module's own name.
KEYS = {name: f'python3-{name}' for name in (
    'matplotlib', 'numba', 'numpy', 'scipy', 'setproctitle', 'tornado', 'tqdm', 'yaml')} | {
    'cv2': 'python3-opencv'}
# What rosdep installs on Ubuntu 24.04 by the keys of the manifests, as rosdep/base.yaml,
# rosdep/python.yaml and jazzy/distribution.yaml of ros/rosdistro have it.
JAZZY = {
    'ament_flake8', 'ament_index_python', 'ament_pep257', 'builtin_interfaces', 'diagnostic_msgs',
    'geometry_msgs', 'lifecycle_msgs', 'nav_msgs', 'rcl_interfaces', 'rclpy', 'rosgraph_msgs',
    'sensor_msgs', 'std_msgs', 'vision_msgs', 'visualization_msgs'}
UBUNTU = {*KEYS.values(), 'python3-pytest'}
# Imported without a key: rosdistro has none.  Commands that need them name them; so they are
# imported where they are used, or in modules that nothing else imports.
OPTIONAL = {'astropy', 'distributed', 'lz4', 'mcap', 'rosbags', 'zstandard'}


def manifest(package: str) -> ElementTree.Element:
    """Return the parsed package.xml."""
    return ElementTree.parse(ROOT / 'src' / package / 'package.xml').getroot()


def declared(package: str) -> set[str]:
    """Return what package.xml names as needed to run."""
    tags = ('depend', 'exec_depend')
    return {item.text for tag in tags for item in manifest(package).iter(tag)}


def imported(package: str) -> set[str]:
    """Return the dependency keys of everything that the package's modules import."""
    tops = set()
    for path in (ROOT / 'src' / package / package).rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                tops |= {alias.name.partition('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                tops.add(node.module.partition('.')[0])
    tops -= {package, *sys.stdlib_module_names, *OPTIONAL}
    return {KEYS.get(top, top) for top in tops}


def setup_arguments(package: str) -> dict:
    """Return the arguments that setup.py calls ``setup`` with."""
    arguments: dict = {}
    with mock.patch('setuptools.setup', lambda **given: arguments.update(given)):
        runpy.run_path(str(ROOT / 'src' / package / 'setup.py'))
    return arguments


def test_six_packages_are_there():
    assert PACKAGES == [
        'lowsnr_bringup', 'lowsnr_common', 'lowsnr_detect', 'lowsnr_eval', 'lowsnr_sensor',
        'lowsnr_track']


@pytest.mark.parametrize('package', PACKAGES)
def test_dependencies_are_those_of_the_imports(package):
    assert declared(package) == imported(package)


@pytest.mark.parametrize('package', PACKAGES)
def test_rosdep_has_every_key(package):
    keys = {item.text for item in manifest(package) if item.tag.endswith('depend')}
    assert keys <= {*PACKAGES, *JAZZY, *UBUNTU}


def test_keys_that_are_listed_are_used():
    used = {item.text for package in PACKAGES for item in manifest(package)}
    assert used >= JAZZY | UBUNTU


def test_packages_without_a_key_are_extras_of_the_environment():
    assert set(_venv.asked_of(_environment.EXTRAS)) >= OPTIONAL


@pytest.mark.parametrize('package', PACKAGES)
def test_manifest_agrees_with_setup(package):
    found = {key: manifest(package).findtext(key) for key in STATED}
    arguments = setup_arguments(package)
    assert found == {key: arguments[key] for key in STATED}
    assert found['name'] == package
    assert '@' in arguments['maintainer_email']


def test_version_maintainer_and_addresses_are_the_same_everywhere():
    for path, text in metadata.stated(ROOT):
        assert path.read_text(encoding='utf-8') == text, 'python scripts/metadata.py writes it'
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert citation['version'] == lowsnr.__version__
    for package in PACKAGES:
        assert manifest(package).findtext('version') == lowsnr.__version__
        log = (ROOT / 'src' / package / 'CHANGELOG.rst').read_text(encoding='utf-8')
        releases = re.findall(r'^(\d+\.\d+\.\d+) \(\d{4}-\d\d-\d\d\)\n-+$', log, re.MULTILINE)
        assert releases[0] == lowsnr.__version__


def test_address_that_is_filled_in_reaches_every_file(tmp_path):
    for path, _ in metadata.stated(ROOT):
        copy = tmp_path / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(path.read_text())
    init = tmp_path / 'src' / 'lowsnr' / 'lowsnr' / '__init__.py'
    init.parent.mkdir(parents=True)
    init.write_text("__version__ = '7.8.9'\n")
    project = (ROOT / 'pyproject.toml').read_text()
    (tmp_path / 'pyproject.toml').write_text(
        project.replace('lowsnr.example', 'a.org').replace(
            "'lowsnr maintainers'", r"'A & \1 B'").replace("'maintainers@", "'\"x\"@"))
    found = {path.relative_to(tmp_path).as_posix(): text
             for path, text in metadata.stated(tmp_path)}
    assert len(found) == len(PACKAGES) + 2
    for name, text in found.items():
        assert 'lowsnr.example' not in text, name
        if name != 'SECURITY.md':
            assert '7.8.9' in text, name
    for package in PACKAGES:
        root = ElementTree.fromstring(found[f'src/{package}/package.xml'])
        assert root.findtext('maintainer') == r'A & \1 B'
        assert root.find('maintainer').get('email') == '"x"@a.org'
        assert {item.get('type') for item in root.iter('url')} == {
            'website', 'repository', 'bugtracker'}


@pytest.mark.parametrize('package', PACKAGES)
def test_entry_points_name_functions_that_exist(package):
    for entry in setup_arguments(package).get('entry_points', {}).get('console_scripts', []):
        module, _, function = entry.partition(' = ')[2].partition(':')
        assert callable(getattr(import_module(module), function)), entry


def test_ros2_run_finds_everything_that_the_packages_install():
    entries = {
        (package, *entry.split(' = ')) for package in PACKAGES for entry in
        setup_arguments(package).get('entry_points', {}).get('console_scripts', [])}
    assert {
        (package, name, ':'.join(place)) for (package, name), place in own_executables().items()
    } == entries
    assert {name for _, name, _ in entries if not name.endswith('_node')} == set(
        commands.COMMANDS)


def test_every_detector_has_its_entry_point():
    entries = setup_arguments('lowsnr_detect')['entry_points']['console_scripts']
    assert {entry.partition('_node ')[0] for entry in entries} == set(DETECTORS)
