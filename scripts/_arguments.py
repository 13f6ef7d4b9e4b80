# SPDX-License-Identifier: Apache-2.0
"""
What the command lines of all scripts share: errors of one line, and checked values.

A script parses its command line before it needs an installed package, so that an option that is
wrong is named at once, also where nothing is installed yet.
"""

import argparse
from collections.abc import Iterable
from collections.abc import Sequence
import difflib
from importlib.util import find_spec
from itertools import takewhile
import math
import os
from pathlib import Path
import re
import shlex
import stat
import sys
from typing import Any
from typing import NoReturn

import _environment  # which leaves a Python that is too old for what follows
import _parameters

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / 'config'
SCENARIOS = CONFIG / 'scenarios'
RESULTS = (Path.cwd() if _environment.INSTALLED else ROOT) / 'results'
USAGE, INTERRUPTED = 2, 130
SNR_DB = -30.0, 80.0  # of SensorModel
MOST_TILES = 16  # of TileSettings, along each axis


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line; it knows ``--version``, and completes words."""

    def __init__(self, **how: Any) -> None:
        super().__init__(allow_abbrev=False, **how)
        self._needed: dict[str, tuple[str, str]] = {}
        self.add_argument('--version', action='version', version=f'lowsnr {version()}')

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None,
    ) -> argparse.Namespace:
        """Return the options; an argument that is none is named, with the option like it."""
        self.complete_words()
        words = sys.argv[1:] if args is None else list(args)
        # First: argparse would rather say that the one it was meant for is missing.
        for word in takewhile('--'.__ne__, words):
            if word.startswith('--') and ' ' not in word:
                self.check_option(word)
        options, unknown = self.parse_known_args(words, namespace)
        if unknown:
            self.check_option(unknown[0])
        given = {word.partition('=')[0] for word in takewhile('--'.__ne__, words)}
        for option, (needed, unless) in self._needed.items():
            if option in given and not {needed, unless} & given:
                self.error(f'{option}: only with {needed}')
        return options

    def only_with(self, needed: str, *options: str, unless: str = '') -> None:
        """
        Reject options that do nothing without another one, where that is not given.

        With the option ``unless`` they are rejected later, and it is said why.
        """
        self._needed |= dict.fromkeys(options, (needed, unless))

    def complete_words(self) -> None:
        """Answer a shell that asks for the words that can follow, and end."""
        try:
            import argcomplete
        except ImportError:  # it is for comfort alone
            return
        argcomplete.autocomplete(self)

    def check_option(self, word: str) -> None:
        """End with an error that names the option like it, unless the word is an option."""
        name = word.partition('=')[0]
        if name not in self._option_string_actions:
            self.error(
                f'{word!r} is no argument' + did_you_mean(name, self._option_string_actions))

    def error(self, message: str) -> NoReturn:
        """Print the message without the usage, and exit with the code of a usage error."""
        self.exit(USAGE, f'{self.prog}: {message}\n')


def number(
    least: float, most: float = math.inf, *, whole: bool = False, above: bool = False,
) -> Any:
    """
    Return an argparse type for finite numbers.

    Parameters
    ----------
    least, most
        Smallest and largest number allowed.
    whole
        Whether the number must be a whole one.
    above
        Whether the number must be larger than ``least``.

    """
    def convert(text: str) -> float:
        kind = 'a whole number' if whole else 'a number'
        try:
            value = int(text) if whole else float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f'{text!r} is not {kind}') from None
        if not least <= value <= most or value == math.inf or (above and value == least):
            bound = f'above {least:g}' if above else f'of at least {least:g}'
            bound += f' and at most {most:g}' if most < math.inf else ''
            raise argparse.ArgumentTypeError(f'{text!r} is not {kind} {bound}')
        return value
    return convert


def tiles(text: str) -> tuple[int, int]:
    """Return how many tiles a frame has down and across, from ``2x1``."""
    found = re.fullmatch(r'(\d{1,2})x(\d{1,2})', text, re.ASCII)
    down, across = map(int, found.groups()) if found else (0, 0)
    if not (1 <= down <= MOST_TILES and 1 <= across <= MOST_TILES):
        raise argparse.ArgumentTypeError(
            f'{text!r} is not two numbers from 1 to {MOST_TILES}, such as 2x1')
    return down, across


def version() -> str:
    """Return the version of the packages."""
    folder = ROOT if _environment.INSTALLED else ROOT / 'src' / 'lowsnr_bringup'
    text = (folder / 'package.xml').read_text(encoding='utf-8')
    return str(re.findall(r'<version>(.+)</version>', text)[0])


def command_line(name: str, arguments: Sequence[str]) -> str:
    """Return the line that runs a command of these scripts."""
    words = (['ros2', 'run', 'lowsnr_bringup', name] if _environment.INSTALLED
             else ['python', f'scripts/{name}.py'])
    return shlex.join([*words, *arguments])


def sources(package: str) -> Path:
    """Return the folder of the modules of a package, which need not be importable yet."""
    folder = ROOT / 'src' / package / package
    if _environment.INSTALLED:
        folder = Path(str(find_spec(package).origin)).parent  # type: ignore[union-attr]
    return folder


def did_you_mean(name: str, known: Iterable[str], alike: float = 0.6) -> str:
    """Return the end of a message that offers the known name nearest to a misspelt one."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=alike)
    return f'; did you mean {near[0]}?' if near else ''


def detectors() -> dict[str, str]:
    """Return the names of all detectors, and what each is, from the sources."""
    found = {}
    for path in sorted((sources('lowsnr_detect') / 'detectors').glob('*.py')):
        text = path.read_text(encoding='utf-8')
        title = text.strip('"\n').partition('\n')[0].strip('"')
        found.update(dict.fromkeys(
            re.findall(r"^@?register\('(\w+)'", text, re.MULTILINE), title))
    return dict(sorted(found.items()))


def scenarios() -> dict[str, str]:
    """Return the names of the scenarios that come with lowsnr, and what each is for."""
    found = {}
    for path in sorted(SCENARIOS.glob('*.yaml')):
        text = path.read_text(encoding='utf-8')
        found[path.stem] = (re.findall(r'^description: *(.+)', text, re.MULTILINE) or [''])[0]
    return found


def detector_name(text: str) -> str:
    """Return the name of a detector that there is."""
    if text not in (known := detectors()):
        raise argparse.ArgumentTypeError(
            f'detector {text!r} is not one of {", ".join(known)}{did_you_mean(text, known)}')
    return text


def scenario_name(text: str) -> str:
    """Return the name of a scenario that there is, or the path of a file."""
    known = scenarios()
    if text not in known and not os.path.isfile(text):  # which takes a name of any length
        raise argparse.ArgumentTypeError(
            f'scenario {text!r} is neither a file nor one of {", ".join(known)}'
            + did_you_mean(text, known))
    return text


def nodes() -> list[str]:
    """Return the names of all nodes that ``--set`` takes, from the sources."""
    text = (sources('lowsnr_bringup') / 'plan' / 'graph.py').read_text(encoding='utf-8')
    return [*detectors(), *re.findall(r"^    '(\w+)': NodeKind", text, re.MULTILINE), 'all']


def override(text: str) -> str:
    """Return a text that reads ``NODE.PARAMETER=VALUE`` with names that there are."""
    name, equals, _ = text.partition('=')
    node, _, parameter = name.partition('.')
    if not equals or not parameter:
        raise argparse.ArgumentTypeError(f'{text!r} does not read NODE.PARAMETER=VALUE')
    if node not in (known := nodes()):
        raise argparse.ArgumentTypeError(
            f'{text!r}: {node} is not one of {", ".join(known)}{did_you_mean(node, known)}')
    names = _parameters.names(node)
    if names and parameter not in names:  # of a detector newer than the table the plan knows
        raise argparse.ArgumentTypeError(
            f'{text!r}: {parameter} is not a parameter of {_whose(node)}'
            + (did_you_mean(parameter, names) or _below(parameter, names)))
    return text


def _below(name: str, known: Iterable[str]) -> str:
    """Return the end of a message that offers a parameter whose group was left out."""
    found = sorted(each for each in known if each.endswith(f'.{name}'))
    return f'; did you mean {" or ".join(found)}?' if found else ''


def _whose(node: str) -> str:
    return 'any node' if node == _parameters.ALL else node


def shown_path(path: Path, typed: Path | None) -> str:
    """Return a path as the user typed it, or from the working folder where it was not typed."""
    relative = path.is_relative_to(Path.cwd()) if typed is None else not typed.is_absolute()
    return os.path.relpath(path) if relative else str(path)


def input_path(text: str) -> Path:
    """Return the path of a file or folder to read; a pipe or a device is not read twice."""
    try:
        mode = os.stat(text).st_mode
    except (OSError, ValueError) as error:
        raise argparse.ArgumentTypeError(
            f'{text!r}: {getattr(error, "strerror", None) or error}') from None
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise argparse.ArgumentTypeError(
            f'{text!r} is neither a file nor a folder: copy what it holds into a file')
    return Path(text)
