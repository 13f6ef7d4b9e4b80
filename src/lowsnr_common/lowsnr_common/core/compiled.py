# SPDX-License-Identifier: Apache-2.0
"""Compile loops to machine code with numba, at their first call."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
import functools
from types import FunctionType
from typing import Any

_DISPATCHERS: list[Any] = []


class NotOnDisk(Exception):
    """The machine code of a loop is not on disk, and was not to be compiled."""


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


@contextmanager
def loading_only() -> Iterator[None]:
    """Have loops loaded from disk within the ``with`` block, and `NotOnDisk` raised for others."""
    from numba.core import event

    class Refusal(event.Listener):

        def on_start(self, event: Any) -> None:
            raise NotOnDisk(event.data['dispatcher'].__name__)

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener('numba:compile', Refusal()):
        yield


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
