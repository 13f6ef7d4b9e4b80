# SPDX-License-Identifier: Apache-2.0
"""
How inputs are drawn and counted: the same ones in every run, more of them on request.

``LOWSNR_FUZZ=20 python scripts/test.py test/fuzz`` tries twenty times as many inputs as the
nightly run (``--slow``), which tries twice as many as a usual run.
"""

from collections.abc import Callable
import functools
import os
from typing import Any

from hypothesis import given
from hypothesis import HealthCheck
from hypothesis import Phase
from hypothesis import settings
from hypothesis.strategies import SearchStrategy
from tally import INPUTS

TIMES = float(os.environ.get('LOWSNR_FUZZ', '0.5'))
# Without the phases that make an example small or explain it: they take minutes for large inputs.
PHASES = (Phase.explicit, Phase.generate)
# Derandomized: an input follows from the test and its number alone.
settings.register_profile(
    'lowsnr', derandomize=True, database=None, deadline=None, phases=PHASES,
    suppress_health_check=list(HealthCheck))
settings.load_profile('lowsnr')


def fuzz(kind: str, inputs: int, **strategies: SearchStrategy) -> Callable:
    """
    Give a test this many inputs, times ``LOWSNR_FUZZ``, and count them by their kind.

    Fixtures of the test are shared by all of its inputs.
    """
    def decorate(test: Callable) -> Callable:
        @settings(max_examples=max(1, round(inputs * TIMES)))
        @given(**strategies)
        @functools.wraps(test)
        def counted(*args, **kwargs):
            INPUTS[kind] += 1
            test(*args, **kwargs)
        return counted

    return decorate


def tried(named: object, call: Callable, *arguments: Any) -> Any:
    """
    Return what a call returns, or None where it refuses its arguments.

    A refusal is one printable line that begins with the name given.
    """
    try:
        return call(*arguments)
    except ValueError as error:
        line = str(error)
    assert line.startswith(str(named)), line
    assert line.isprintable(), line
    assert 0 < len(line) < 2000
    return None
