# SPDX-License-Identifier: Apache-2.0
"""Command lines: what is misspelt is named at once, with what was meant, before any set-up."""

import importlib.util
import os
from pathlib import Path
import shutil
import subprocess
import sys
import time

import _arguments
import _environment
import _parameters
import _venv
import bringup
import calibrate
import convert
import evaluate
import learn_noise
import lowsnr
from lowsnr_bringup.plan.config_files import describe_parameters
from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.config_files import load_overrides
from lowsnr_bringup.plan.graph import KINDS
from lowsnr_bringup.plan.graph import known_nodes
from lowsnr_bringup.plan.graph import settings_classes
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.text import read_yaml
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_eval.study.examples import EXAMPLES
import manual
import metadata
import pytest
import reproduce

ROOT = Path(__file__).resolve().parents[2]
SPEC = importlib.util.spec_from_file_location('test_script', ROOT / 'scripts' / 'test.py')
test_script = importlib.util.module_from_spec(SPEC)  # whose name the standard library has too
SPEC.loader.exec_module(test_script)
SCRIPTS = [bringup, calibrate, convert, evaluate, learn_noise, manual, reproduce, test_script]
NAMES = sorted(
    path.stem for path in (ROOT / 'scripts').glob('[!_]*.py') if path.stem != 'ros2')
MISSPELT = [
    (bringup, ['--detctor', 'sdt'], '--detector'), (bringup, ['--lock-step'], '--lockstep'),
    (bringup, ['--detector', 'stt'], 'sdt'), (bringup, ['--scenario', 'exmple4'], 'example4'),
    (bringup, ['--snrr=9'], '--snr'),
    (calibrate, ['--detectors', 'sdt'], '--detector'), (calibrate, ['--detector', 'hmn'], 'hmm'),
    (calibrate, ['--scenario', 'crosing'], 'crossing'),
    (convert, ['a', '--out', 'b', '--perod', '1'], '--period'),
    (evaluate, ['a', '--result', 'b'], '--results'),
    (bringup, ['--set', 'sdtt.alpha=1'], 'sdt'), (bringup, ['--set', 'sdt.alhpa=1'], 'alpha'),
    (bringup, ['--set', 'all.sensor.nois.model=k'], 'sensor.noise.model'),
    (bringup, ['--set', 'sdt.shape=3'], 'sensor.noise.shape'),
    (calibrate, ['--set', 'sdt.max_iteration=8'], 'max_iterations'),
    (calibrate, ['--set', 'traker.rows=1'], 'tracker'),
    (convert, ['a', '--ot', 'b'], '--out'), (reproduce, ['--exampel', '3'], '--example'),
    (learn_noise, ['--frames-topc', 'x'], '--frames-topic'), (test_script, ['--slo'], '--slow'),
    (manual, ['--drat'], '--draft'),
    (test_script, ['--coverag', '-n0'], '--coverage'),
    (reproduce, ['--all', '--detectors', 'sdt'], '--detector'),
    (reproduce, ['--all', '--detector', 'sdtt'], 'sdt')]


@pytest.mark.parametrize(('script', 'arguments', 'meant'), MISSPELT)
def test_misspelt_word_is_answered_by_what_was_meant(capsys, script, arguments, meant):
    with pytest.raises(SystemExit) as end:
        script.parse_arguments(arguments)
    out, err = capsys.readouterr()
    assert (end.value.code, out, err.count('\n')) == (2, '', 1)
    assert f'did you mean {meant}?' in err


@pytest.mark.parametrize('script', SCRIPTS)
def test_version_is_that_of_the_library(capsys, script):
    with pytest.raises(SystemExit) as end:
        script.parse_arguments(['--version'])
    assert (end.value.code, capsys.readouterr().out) == (0, f'lowsnr {lowsnr.__version__}\n')


@pytest.mark.parametrize(('script', 'arguments', 'culprit'), [
    (bringup, ['--set', 'sdtmax'], 'sdtmax'), (bringup, ['--set', 'sdt=3'], 'sdt=3'),
    (bringup, ['--set', 'nobody.x=3'], 'nobody'),
    (bringup, ['--set', 'tracker.max_iterations=3'], 'not a parameter of tracker'),
    (bringup, ['--snr', '900'], '900'),
    (bringup, ['--snr', 'nan'], 'nan'), (bringup, ['--replay', 'nope.npz'], 'nope.npz'),
    (calibrate, ['--false-alarm-prob', '1.5'], '1.5'), (convert, ['nope', '--out', 'b'], 'nope'),
    (evaluate, ['nope'], 'nope'), (evaluate, ['x' * 5000], 'xxx'), (evaluate, ['a\0b'], 'a'),
    (learn_noise, ['nope'], 'nope'), (reproduce, ['--example', '9'], '9'),
    (reproduce, ['--all', '--runs', '0'], '0'), (reproduce, ['--all', '--snr', 'nan'], 'nan'),
    (reproduce, ['--all', '--snr', '99'], '99'), (reproduce, ['--all', '--seed', '-1'], '-1'),
    (reproduce, ['--all', '--jobs', '0'], '0')])
def test_value_out_of_bounds_or_reach_is_named_at_once(
        tmp_path, monkeypatch, capsys, script, arguments, culprit):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        script.parse_arguments(arguments)
    out, err = capsys.readouterr()
    assert (end.value.code, out, err.count('\n')) == (2, '', 1)
    assert culprit in err


def test_bounds_and_nodes_of_the_command_line_are_those_of_the_settings():
    detector_class('sdt')
    assert set(_arguments.nodes()) == {*DETECTORS, *KINDS, 'all'}
    snr = declared_settings(SensorModel)['snr_db']
    assert (snr.ge, snr.le) == _arguments.SNR_DB
    for number in EXAMPLES:
        assert reproduce.parse_arguments(['--example', str(number)]).example == number
    with pytest.raises(SystemExit):
        reproduce.parse_arguments(['--example', str(max(EXAMPLES) + 1)])


def test_set_knows_the_declared_settings_and_no_other_fields():
    every = set()
    for node in known_nodes():
        declared = {name for cls in settings_classes(node) for name in declared_settings(cls)}
        assert _parameters.names(node.removesuffix('_detector')) == declared
        every |= declared
    assert _parameters.names('all') == every
    assert not _parameters.names('nobody')


@pytest.mark.parametrize('words', [
    ['test/detect', '-k', 'sdt', '-n0'], ['--cov'], ['--co'], ['--sw'], ['--color=no'], ['--lf'],
    ['--durations=9'], ['--verbose']])
def test_options_of_pytest_are_left_to_it(words):
    assert test_script.parse_arguments([*words, '--slow'])[1] == words


def test_names_that_are_listed_are_those_that_there_are(capsys):
    detector_class('sdt')  # the detectors register themselves
    assert list(_arguments.detectors()) == sorted(DETECTORS)
    scenarios = {path.stem: read_yaml(path)['description']
                 for path in (ROOT / 'config' / 'scenarios').glob('*.yaml')}
    assert _arguments.scenarios() == scenarios
    for what, names in (('detectors', sorted(DETECTORS)), ('scenarios', sorted(scenarios))):
        with pytest.raises(SystemExit) as end:
            bringup.parse_arguments(['--list', what])
        lines = capsys.readouterr().out.splitlines()
        assert end.value.code == 0
        assert [line.split()[0] for line in lines] == names
        assert all(len(line.split()) > 1 for line in lines)


def described(detectors, config=bringup.CONFIG):
    """Return what the declarations and the parameter files say of all parameters."""
    return [(name, *map(str, row))
            for name, *row in describe_parameters(load_config(config), detectors)]


def test_table_of_parameters_is_what_is_declared():
    assert _parameters.TABLE.read_text() == metadata.parameters(
        bringup.CONFIG), 'python scripts/metadata.py writes it'
    for detectors in (['sdt'], ['hmm', 'cdt'], list(DETECTORS)):
        assert _parameters.listed(bringup.CONFIG, detectors) == described(detectors)


def test_parameter_files_that_were_changed_win_over_the_table(tmp_path):
    config = tmp_path / 'config'
    shutil.copytree(bringup.CONFIG, config)
    path = config / 'detectors.yaml'
    path.write_text(path.read_text().replace('max_iterations: 5', 'max_iterations: 9'))
    assert _parameters.listed(config, ['sdt']) is None
    assert dict(row[:2] for row in described(['sdt'], config))['sdt.max_iterations'] == '9'
    assert _parameters.listed(bringup.CONFIG, ['not_yet_in_the_table']) is None


def test_every_parameter_that_is_listed_can_be_set_to_its_value(capsys):
    with pytest.raises(SystemExit) as end:
        bringup.parse_arguments(['--list', 'parameters', '--detector', 'hmm', 'sdt'])
    lines = [line for line in capsys.readouterr().out.splitlines() if line[0] != ' ']
    assert (end.value.code, len(lines) > 200) == (0, True)
    values = dict(line.split(' = ', 1) for line in lines)
    for name in values:
        assert _arguments.override(f'{name}=1') == f'{name}=1'
    assert values['sdt.max_iterations'] == str(
        load_config(bringup.CONFIG)['sdt_detector']['max_iterations'])
    texts = [f'{name}={value}' for name, value in values.items() if value not in ('', '()')]
    assert load_overrides([
        text.replace('(', '[').replace(',)', ']').replace(')', ']') for text in texts],
        ['hmm', 'sdt'])


@pytest.fixture(scope='module')
def clone(tmp_path_factory):
    """Return a checkout that was never started."""
    root = tmp_path_factory.mktemp('clone')
    for name in ('config', 'interfaces', 'requirements', 'scripts', 'src'):
        shutil.copytree(
            ROOT / name, root / name, ignore=shutil.ignore_patterns('__pycache__', 'test'))
    return root


@pytest.mark.parametrize(('script', 'arguments', 'code'), [
    ('bringup', ['--detector', 'stt'], 2), ('bringup', ['--list', 'detectors'], 0),
    ('bringup', ['--list', 'parameters'], 0), ('bringup', ['--set', 'sdt.shape=3'], 2),
    ('calibrate', ['--snr', 'x'], 2), ('evaluate', ['nope'], 2), *(
        (name, [option], code) for name in NAMES
        for option, code in (('--help', 0), ('--version', 0), ('--verson', 2)))])
def test_fresh_clone_answers_without_an_environment(clone, script, arguments, code):
    start = time.monotonic()
    done = subprocess.run(
        [sys._base_executable, '-S', clone / 'scripts' / f'{script}.py', *arguments],
        capture_output=True, text=True, timeout=60.0, check=False,
        env={key: os.environ[key] for key in os.environ if key != 'PYTHONPATH'})
    assert done.returncode == code, done.stderr
    assert (done.stderr.count('\n'), bool(done.stdout)) == ((1, False) if code else (0, True))
    assert not list(clone.glob('.venv*'))
    assert time.monotonic() - start < 30.0  # it installs nothing; idle it takes 0.2 s


@pytest.mark.parametrize(('words', 'extras'), [
    ([], ()), (['--camera', '/image_raw'], ('images',)), (['--view'], ('images',)),
    (['--record', 'bag'], ('bags',)), (['--camera', '/x', '--record', 'bag'], ('bags', 'images')),
    (['--replay', str(ROOT)], ('bags', 'files'))])
def test_run_asks_for_the_extras_that_it_uses(words, extras):
    found = bringup.extras_of(bringup.parse_arguments(words))
    assert found == extras
    assert set(found) <= {*_environment.EXTRAS, *_environment.PARTS}
    assert all(package in _venv.asked_of([extra])
               for extra, package in _environment.PARTS.values())


@pytest.mark.parametrize(('typed', 'completed'), [
    ('bringup.py --detec', '--detector'), ('bringup.py --storage m', 'mcap'),
    ('reproduce.py --exa', '--example'), ('learn_noise.py --frames', '--frames-topic'),
    ('test.py --cove', '--coverage')])
def test_words_are_completed_by_argcomplete(tmp_path, typed, completed):
    path = tmp_path / 'words'
    script = ROOT / 'scripts' / typed.split()[0]
    assert b'PYTHON_ARGCOMPLETE_OK' in script.read_bytes()[:1024]  # which shells look for
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=60.0, check=False,
        env=os.environ | {
            '_ARGCOMPLETE': '1', 'COMP_LINE': typed, 'COMP_POINT': str(len(typed)),
            '_ARGCOMPLETE_STDOUT_FILENAME': str(path), '_ARGCOMPLETE_IFS': '\n'})
    assert done.returncode == 0, done.stderr
    assert [word.strip() for word in path.read_text().split('\n')] == [completed]


def test_paths_are_shown_as_they_were_typed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for typed in (Path('a/run'), Path('../run'), tmp_path / 'run'):
        assert _arguments.shown_path(Path(os.path.abspath(typed)), typed) == str(typed)
    assert _arguments.shown_path(tmp_path / 'results' / 'x', None) == 'results/x'
    assert _arguments.shown_path(Path('/elsewhere/x'), None) == '/elsewhere/x'
