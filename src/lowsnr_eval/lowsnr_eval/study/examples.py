"""The six examples of Section VI: which methods they compare, and with which settings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Variant:
    """A registered detector with settings of its own, under a name of its own."""

    label: str
    detector: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Example:
    """
    An example of the paper.

    Parameters
    ----------
    number
        1 to 6.
    title
        Subject of the example.
    solid, dashed
        The methods that the paper's figures compare, by their line style; the second is
        empty if there is only one.
    also
        Further methods that the claims of the example need in all runs.
    variants
        Detectors whose settings differ from those of ``config/``: with settings that the
        paper states, or extensions that it names.
    max_speed_mps
        Highest speed in the motion models of detectors and tracker [m/s], 0 for that of
        ``config/``; it covers the speeds of the scenario.

    """

    number: int
    title: str
    solid: str
    dashed: str = ''
    also: tuple[str, ...] = ()
    variants: tuple[Variant, ...] = ()
    max_speed_mps: float = 0.0

    @property
    def scenario(self) -> str:
        """Return the name of the scenario file."""
        return f'example{self.number}'

    @property
    def compared(self) -> tuple[str, ...]:
        """Return the methods that take part in all runs."""
        pair = (self.solid, self.dashed) if self.dashed else (self.solid,)
        return (*pair, *self.also)


EXAMPLES = {example.number: example for example in (
    Example(1, 'MMTBD2 and TBD2: the effect of multiple models', 'mmtbd2', 'tbd2',
            also=('mmtbd1',)),
    Example(2, 'MMTBD2 and CDT', 'mmtbd2', 'cdt'),
    Example(3, 'SDT and CDT', 'sdt', 'cdt'),
    Example(4, 'SDT with s_m = 3 and MMTBD2', 'sdt', 'mmtbd2', also=('mmtbd1', 'tbd2', 'tbd1'),
            variants=(Variant('sdt', 'sdt', ('sdt.max_iterations=3',)),
                      Variant('sdt_sm5', 'sdt', ('sdt.max_iterations=5',)))),
    Example(5, 'SDT and MMTBD2 with a fast object that turns sharply', 'sdt', 'mmtbd2',
            also=('sdt_r2',), variants=(Variant('sdt_r2', 'sdt', ('sdt.radius=2',)),),
            max_speed_mps=1.5),
    Example(6, 'SDT with very faint objects', 'sdt', also=('mmtbd2',)),
)}
