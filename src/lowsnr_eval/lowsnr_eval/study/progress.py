"""How far it is, how fast it goes, and how long it will still take."""

from __future__ import annotations

from types import TracebackType

from tqdm import tqdm


class Bar:
    """A progress bar for each thing that is done, on a terminal; use it in ``with``."""

    def __init__(self) -> None:
        self._bar: tqdm | None = None

    def __enter__(self) -> Bar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, what: str, total: int, more: int) -> None:
        """Show that ``more`` of ``total`` has just been finished."""
        if self._bar is None:
            unit = 'run' if what.startswith('example') else 'threshold'
            # What an earlier start finished says nothing about the speed of this one.
            self._bar = tqdm(total=total, initial=more, desc=what, unit=unit, dynamic_ncols=True)
        else:
            self._bar.update(more)
