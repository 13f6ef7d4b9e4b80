# SPDX-License-Identifier: Apache-2.0
"""
The six examples of Section VI and the paper's claims, as data.

A claim names two sides, which get the same frames in each run.  Its effect is by how much the
side that the paper names first is better: a difference of P_D, or the RMSE of the other side
minus its own.  A claim is not resolved if the interval of the effect contains zero.
"""

from __future__ import annotations

from dataclasses import dataclass

PD, POSITION, VELOCITY = 'pd', 'rmse_position_m', 'rmse_velocity_mps'
TIME = 'time_ms'
DETECTION, TRACKING = 'detection', 'tracking'
# How a method "outperforms" another: the first figure decides, the tables show the others too.
_OUTPERFORMS = (
    (DETECTION, PD), (TRACKING, PD), (TRACKING, POSITION), (TRACKING, VELOCITY))
_FAST, _SLOW = ((5, 16), (29, 35)), ((17, 28),)
Frames = tuple[tuple[int, int], ...]


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


@dataclass(frozen=True)
class Claim:
    """
    A sentence of the paper, and the comparison that tests it.

    Parameters
    ----------
    key
        Short name.
    example
        Example whose runs test it.
    sentence
        The paper's words, or close to them.
    better, worse
        The methods; ``worse`` is empty if the claim compares the first with ``bound``.
    measures
        Levels and figures that are compared; the first gives the verdict on the claim.
    reading
        The meaning that the test gives to the sentence.
    better_frames, worse_frames
        First and last frame of each interval that counts for a side; empty for all frames
        with the object.
    bound
        P_D must exceed this if there is no other side.

    """

    key: str
    example: int
    sentence: str
    better: str
    worse: str
    measures: tuple[tuple[str, str], ...] = _OUTPERFORMS
    reading: str = 'higher P_D'
    better_frames: Frames = ()
    worse_frames: Frames = ()
    bound: float = 0.0


CLAIMS = (
    Claim('VI', 1, 'MMTBD2 outperforms MMTBD1', 'mmtbd2', 'mmtbd1'),
    Claim('1', 1, 'MMTBD2 outperforms TBD2', 'mmtbd2', 'tbd2'),
    Claim('2a', 2, 'MMTBD2 outperforms CDT in detection', 'mmtbd2', 'cdt',
          measures=((DETECTION, PD), (TRACKING, PD))),
    Claim('2b', 2, 'MMTBD2 does not outperform CDT in tracking', 'cdt', 'mmtbd2',
          measures=((TRACKING, POSITION), (TRACKING, VELOCITY)),
          reading="the error of CDT's tracks is smaller"),
    Claim('3', 3, 'SDT outperforms CDT', 'sdt', 'cdt'),
    Claim('4', 4, 'SDT outperforms MMTBD2', 'sdt', 'mmtbd2'),
    *(Claim(f'abstract, {name.upper()}', 4,
            f'SDT outperforms the particle filter TBD methods, here {name.upper()}', 'sdt', name)
      for name in ('tbd1', 'tbd2', 'mmtbd1')),
    Claim('5a', 5, 'SDT does not work well when the object moves more than one cell', 'sdt',
          'sdt', measures=((DETECTION, PD), (TRACKING, PD)),
          reading='higher P_D in frames 17 to 28 than in 5 to 16 and 29 to 35',
          better_frames=_SLOW, worse_frames=_FAST),
    Claim('5b', 5, 'allowing moves of two cells resolves this', 'sdt_r2', 'sdt',
          measures=((DETECTION, PD), (TRACKING, PD)),
          reading='higher P_D with radius 2 in frames 5 to 16 and 29 to 35',
          better_frames=_FAST, worse_frames=_FAST),
    Claim('5d', 5, 'SDT outperforms MMTBD2 from frame 17 to 28, with a sharp turn', 'sdt',
          'mmtbd2', better_frames=_SLOW, worse_frames=_SLOW),
    Claim('6', 6, 'SDT can even handle very low SNR objects', 'sdt', '',
          measures=((DETECTION, PD), (TRACKING, PD)), reading='P_D above 0.5', bound=0.5),
    Claim('conclusions, a', 6, 'SDT detects even a very low SNR object with a high probability',
          'sdt', '', measures=((DETECTION, PD), (TRACKING, PD)), reading='P_D above 0.9',
          bound=0.9),
    Claim('conclusions, b', 6, 'SDT outperforms MMTBD2, at very low SNR too', 'sdt', 'mmtbd2'),
)
# The one claim on time; its verdict follows from the times of blocks of runs.
COST_CLAIM = Claim(
    '5c', 5, 'allowing moves of two cells increases the computational cost', 'sdt_r2', 'sdt',
    measures=((DETECTION, TIME),), reading='more CPU time for a frame with radius 2')
