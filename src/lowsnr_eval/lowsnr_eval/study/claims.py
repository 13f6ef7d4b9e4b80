"""
The paper's claims as data: which methods they compare, in which frames, by which figure.

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
