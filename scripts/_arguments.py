"""The command line of every script: errors in one line, numbers within their bounds."""

import argparse
import math
from typing import Any
from typing import NoReturn

USAGE, INTERRUPTED = 2, 130


class Parser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Print the message alone and end with the status of a usage error."""
        self.exit(USAGE, f'{self.prog}: {message}\n')


def number(least: float, *, whole: bool = False, above: bool = False) -> Any:
    """Return an argparse type for finite numbers from ``least`` on, or above it."""
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
