# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Build the manual, with its tutorials, figures and the API, into build/manual."""

import argparse
from pathlib import Path
import subprocess
import sys

from _arguments import INTERRUPTED
from _arguments import Parser
import _environment

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / 'build' / 'manual'
PLACES = [str(ROOT / 'docs'), str(OUT)]
# Every page is read and written again, because a warning is shown when a page is read.
BUILD = ['sphinx', '--quiet', '--fresh-env', '--write-all', '--fail-on-warning', *PLACES]
DRAFT = ['sphinx', '--quiet', '--define', 'sphinx_gallery_conf.plot_gallery=False', *PLACES]


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='manual.py', description=__doc__,
        epilog='exit code: 0 done, 1 something failed or a warning was printed, 2 usage error, '
        '130 after Ctrl-C')
    parser.add_argument(
        '--draft', action='store_true',
        help='do not run tutorials and figures, and read again only the pages that have changed')
    return parser.parse_args(arguments)


def main() -> int:
    """Build; return the exit code."""
    options = parse_arguments(sys.argv[1:])
    _environment.ensure(dev=True)
    code = subprocess.run(
        [sys.executable, '-m', *(DRAFT if options.draft else BUILD)], check=False).returncode
    if not code:
        print(OUT / 'index.html')
    return int(code != 0)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
