"""Loops that are compiled to machine code, and the numba that does it."""

from __future__ import annotations

from collections.abc import Callable
import functools
from types import FunctionType
from typing import Any

_DISPATCHERS: list[Any] = []


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """
    Return a function that numba compiles when it is called first.

    numba is imported then, not before: a process that runs no such loop does not wait for it.
    The machine code is kept on disk, beside the source, or in the user's cache folder where
    that cannot be written, or where ``NUMBA_CACHE_DIR`` says.  No operation is reordered, and
    the interpreter is free for other threads meanwhile.  A compiled function may call others of
    its module; those of another would not be compiled anew when they change.
    """
    @functools.wraps(function)
    def call(*args: Any) -> Any:
        return _machine_code(function)(*args)
    return call


def variants() -> int:
    """Return how many variants of functions, one for each types of arguments, are compiled."""
    return sum(len(function.signatures) for function in _DISPATCHERS)


@functools.cache
def _machine_code(function: FunctionType) -> Callable[..., Any]:
    import numba
    options = {'nogil': True, 'error_model': 'numpy'}
    known = dict(function.__globals__)
    for name in set(function.__code__.co_names) & set(known):
        if isinstance(inner := getattr(known[name], '__wrapped__', None), FunctionType):
            known[name] = _machine_code(inner)
    plain = functools.wraps(function)(FunctionType(function.__code__, known))
    try:
        made = numba.njit(plain, cache=True, **options)
    except RuntimeError:
        # There is no folder that can be written: compiled anew in every process.
        made = numba.njit(plain, **options)
    _DISPATCHERS.append(made)
    return made
