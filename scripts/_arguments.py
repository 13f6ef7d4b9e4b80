"""What the command lines of all scripts share: errors of one line, and checked numbers."""

import argparse
import math
import os
from pathlib import Path
import stat
from typing import Any
from typing import NoReturn

USAGE, INTERRUPTED = 2, 130


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        """Print the message without the usage, and exit with the code of a usage error."""
        self.exit(USAGE, f'{self.prog}: {message}\n')


def number(least: float, *, whole: bool = False, above: bool = False) -> Any:
    """
    Return an argparse type for finite numbers.

    Parameters
    ----------
    least
        Smallest number allowed.
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
        if not least <= value < math.inf or (above and value == least):
            bound = f'above {least:g}' if above else f'of at least {least:g}'
            raise argparse.ArgumentTypeError(f'{text!r} is not {kind} {bound}')
        return value
    return convert


def input_path(text: str) -> Path:
    """Return the path of a file or folder to read; a pipe or a device is not read twice."""
    try:
        mode = os.stat(text).st_mode
    except (OSError, ValueError):
        return Path(text)  # whoever reads it says why it cannot
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise argparse.ArgumentTypeError(
            f'{text!r} is neither a file nor a folder: copy what it holds into a file')
    return Path(text)
