"""What package.xml and setup.py say is what the code is."""

import ast
from importlib import import_module
from pathlib import Path
import runpy
import sys
from unittest import mock
import xml.etree.ElementTree as ElementTree

from lowsnr_bringup.cli.executables import own_executables
import lowsnr_detect.detectors  # noqa: F401  (its files register themselves)
from lowsnr_detect.parts.registry import DETECTORS
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent.name for path in (ROOT / 'src').glob('*/package.xml'))
# The rosdep key of an imported module, where it is not the module's own name.
KEYS = {name: f'python3-{name}' for name in (
    'astropy', 'distributed', 'lz4', 'matplotlib', 'mcap', 'numba', 'numpy', 'rosbags',
    'scipy', 'setproctitle', 'tqdm', 'yaml', 'zstandard')} | {
    'cv2': 'python3-opencv'}


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
    return {KEYS.get(top, top) for top in tops - {package} - set(sys.stdlib_module_names)}


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
def test_manifest_agrees_with_setup(package):
    found = {key: manifest(package).findtext(key) for key in ('name', 'version', 'license')}
    arguments = setup_arguments(package)
    assert found == {
        'name': package, 'version': arguments['version'], 'license': arguments['license']
    }


@pytest.mark.parametrize('package', PACKAGES)
def test_entry_points_name_functions_that_exist(package):
    for entry in setup_arguments(package).get('entry_points', {}).get('console_scripts', []):
        module, _, function = entry.partition(' = ')[2].partition(':')
        assert callable(getattr(import_module(module), function)), entry


def test_ros2_run_finds_every_node_that_the_packages_install():
    entries = {
        (package, *entry.split(' = ')) for package in PACKAGES for entry in
        setup_arguments(package).get('entry_points', {}).get('console_scripts', [])}
    assert {
        (package, name, ':'.join(place)) for (package, name), place in own_executables().items()
    } == {entry for entry in entries if entry[1].endswith('_node')}


def test_every_detector_has_its_entry_point():
    entries = setup_arguments('lowsnr_detect')['entry_points']['console_scripts']
    assert {entry.partition('_node ')[0] for entry in entries} == set(DETECTORS)
