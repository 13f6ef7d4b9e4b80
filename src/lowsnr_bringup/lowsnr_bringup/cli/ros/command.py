# SPDX-License-Identifier: Apache-2.0
"""The command line of the small ``ros2``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
import sys
from typing import NoReturn

from lowsnr_common.settings.text import printable_lines

_NOTE = ('this is the small ros2 of lowsnr, for environments without an installed ROS 2, whose '
         'ros2 has all verbs and options')
_COMMANDS = {
    'bag': 'info',
    'lifecycle': 'get, nodes, set',
    'node': 'info, list',
    'param': 'describe, dump, get, list, set',
    'run': 'start an executable of a package',
    'topic': 'delay, echo, hz, info, list',
}
FAILED, USAGE, INTERRUPTED = 1, 2, 130


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        """Print the message and where there is more, and exit with the code of a usage error."""
        self.exit(USAGE, f'{self.prog}: {message}; {_NOTE}\n')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit code: 0, 1 failed, 2 usage error, 130 after Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        options = _parser(arguments[:1]).parse_args(arguments)
        return int(options.run(options) or 0)
    except BrokenPipeError:  # as of ros2 ... | head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (LookupError, OSError, RuntimeError, ValueError) as error:
        print(printable_lines(error), file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED


def _parser(first: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; of the commands only the first argument's needs its modules."""
    parser = Parser(prog='ros2', description=_NOTE, allow_abbrev=False)
    commands = parser.add_subparsers(metavar='COMMAND', required=True)
    for name, verbs in _COMMANDS.items():
        command = commands.add_parser(
            name, help=verbs, description=f'{name}: {_NOTE}', allow_abbrev=False)
        if [name] == list(first):
            _add_verbs(name, command)
    return parser


def _add_verbs(name: str, command: argparse.ArgumentParser) -> None:
    if name == 'run':
        command.add_argument('package_name', help='name of the package')
        command.add_argument('executable_name', help='name of the executable, such as sdt_node')
        command.add_argument(
            'argv', nargs=argparse.REMAINDER, help='arguments of the executable')
        command.set_defaults(run=_run)
        return
    verbs = command.add_subparsers(metavar='VERB', required=True)
    if name == 'bag':
        info = verbs.add_parser('info', help='print what a bag holds', allow_abbrev=False)
        info.add_argument('bag_path', help='bag to look at')
        info.set_defaults(run=_bag_info)
    elif name == 'lifecycle':
        from lowsnr_bringup.cli.ros.lifecycle import add_verbs
        add_verbs(verbs)
    elif name == 'node':
        from lowsnr_bringup.cli.ros.nodes import add_verbs
        add_verbs(verbs)
    elif name == 'param':
        from lowsnr_bringup.cli.ros.param import add_verbs
        add_verbs(verbs)
    else:
        from lowsnr_bringup.cli.ros.topic import add_verbs
        add_verbs(verbs)


def _run(options: argparse.Namespace) -> NoReturn:
    from lowsnr_bringup.cli.executables import run_executable
    run_executable(options.package_name, options.executable_name, options.argv)


def _bag_info(options: argparse.Namespace) -> None:
    from pathlib import Path

    from lowsnr_bringup.cli.bag_info import bag_info
    info = bag_info(Path(options.bag_path))
    print(info)
    for note in info.notes:
        print(printable_lines(note), file=sys.stderr)
