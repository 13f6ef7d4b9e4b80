# SPDX-License-Identifier: Apache-2.0
"""Compile loops to machine code with numba, at their first call."""

from __future__ import annotations

from collections.abc import Callable
import functools
from types import FunctionType
from typing import Any

_DISPATCHERS: list[Any] = []


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """
    Return a function that numba compiles at its first call.

    numba is imported then and not before, so that a process that runs no such loop does not wait
    for it.  The machine code is cached on disk: beside the source, in the user's cache folder
    where that is read-only, or in ``NUMBA_CACHE_DIR``.  The compiler reorders no operation, and
    other threads run meanwhile.  A compiled function may call others of its module, but none of
    another module, because a change there would not compile it again.
    """
    @functools.wraps(function)
    def call(*args: Any) -> Any:
        return _machine_code(function)(*args)
    return call


def is_loaded() -> bool:
    """Return whether this process has called a compiled function, which loads numba."""
    return bool(_DISPATCHERS)


def variants() -> int:
    """Return the number of compiled variants, one for each function and types of arguments."""
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
        dispatcher: Callable[..., Any] = numba.njit(plain, cache=True, **options)
    except RuntimeError:
        # No folder can be written: every process compiles for itself.
        dispatcher = numba.njit(plain, **options)
    _DISPATCHERS.append(dispatcher)
    return dispatcher
