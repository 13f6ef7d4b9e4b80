"""
How inputs are drawn and counted: the same ones every time, more of them on request.

``LOWSNR_FUZZ=20 python scripts/test.py test/fuzz`` tries twenty times as many as usual.
"""

from collections import Counter
from collections.abc import Callable
import functools
import os
from typing import Any

from hypothesis import given
from hypothesis import HealthCheck
from hypothesis import Phase
from hypothesis import settings
from hypothesis.strategies import SearchStrategy

TIMES = float(os.environ.get('LOWSNR_FUZZ', '1'))
# Inputs by kind: those that were given, and those that the tests set out to give.
GIVEN: Counter[str] = Counter()
PLANNED: Counter[str] = Counter()

# What makes an example small or explains it takes minutes where an input is large.
PHASES = (Phase.explicit, Phase.generate)
# Derandomized: what an input is follows from the test and its number alone.
settings.register_profile(
    'lowsnr', derandomize=True, database=None, deadline=None, phases=PHASES,
    suppress_health_check=list(HealthCheck))
settings.load_profile('lowsnr')


def fuzz(kind: str, inputs: int, **strategies: SearchStrategy) -> Callable:
    """
    Give a test this many inputs, times ``LOWSNR_FUZZ``, and count them by their kind.

    Fixtures of the test are shared by all of its inputs.
    """
    PLANNED[kind] += inputs

    def decorate(test: Callable) -> Callable:
        @settings(max_examples=max(1, round(inputs * TIMES)))
        @given(**strategies)
        @functools.wraps(test)
        def counted(*args, **kwargs):
            GIVEN[kind] += 1
            test(*args, **kwargs)
        return counted

    return decorate


def tried(named: object, call: Callable, *arguments: Any) -> Any:
    """
    Return what a call returns, or None where it refuses its arguments.

    A refusal is one line that begins with what it names and that any terminal shows as it is.
    """
    try:
        return call(*arguments)
    except ValueError as error:
        line = str(error)
    assert line.startswith(str(named)), line
    assert line.isprintable(), line
    assert 0 < len(line) < 2000
    return None
