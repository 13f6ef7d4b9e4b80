# SPDX-License-Identifier: Apache-2.0
"""
Motion of objects that each have a destination of their own: general CM_L sequences.

In :mod:`lowsnr_common.core.destination` origin and destination of an object depend on each other
as in the base motion.  Here their densities are independent: x_1 has a density of its own, and so
have the place d of the arrival and its frame N, of which an object carries one draw.  Given these
it moves by ::

    x_{k+1} = G_{k+1,k} x_k + G_{k+1,N} d + e_{k+1}

with the matrices stated there, for a destination that is known (s = 0): the base motion, given
that it is at d in frame N (Rezaie and Li, "CM sequence based trajectory modeling with
destination", arXiv 1811.08021, there for a whole state d and a known N).  After frame N, and
without a destination, it is the base motion.

Note: in a turn the motion after a step is taken to be straight, so that the object still arrives
in frame N.  Between frames, it arrives in the one nearest in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields
from dataclasses import replace
import functools

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.streams import standard_normal
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
import numpy as np

# Frame of the arrival of an object that is bound for no destination.
UNBOUND = 0


@dataclass(frozen=True, kw_only=True)
class PlaceDensity:
    """A normal density of a position, alike in each direction."""

    x_m: float = setting(0.0, 'mean along the columns [m]')
    y_m: float = setting(0.0, 'mean along the rows, down [m]')
    std_m: float = setting(1.0, 'standard deviation in each direction [m]', ge=0.0)

    def __post_init__(self) -> None:
        check_settings(self)

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """Return positions x, y of a leading shape, (..., 2) [m]."""
        return self.at(standard_normal((*shape, 2), rng))

    def at(self, deviations: np.ndarray) -> np.ndarray:
        """Return the positions x, y that lie so many standard deviations off, (..., 2) [m]."""
        return (self.x_m, self.y_m) + self.std_m * deviations


@dataclass(frozen=True, kw_only=True)
class DestinationDensity(PlaceDensity):
    """One of the destinations of an object: its probability, its place and when it arrives."""

    probability: float = setting(
        1.0, 'probability that the object is bound for this destination; with the rest to one it '
        'is bound for none', gt=0.0, le=1.0)
    earliest_frame: int = setting(40, 'first frame in which it may arrive', ge=1)
    latest_frame: int = setting(
        40, 'last frame in which it may arrive; all from earliest_frame on are alike', ge=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.latest_frame < self.earliest_frame:
            raise ValueError(
                f'latest_frame = {self.latest_frame}, must be at least earliest_frame = '
                f'{self.earliest_frame}')

    @property
    def arrivals(self) -> range:
        """Return the frames in which it may arrive, all alike."""
        return range(self.earliest_frame, self.latest_frame + 1)


@dataclass(frozen=True, kw_only=True)
class Destinations:
    """The destinations of objects, as lists with an element for each; empty for none."""

    probability: tuple[float, ...] = setting(
        (), 'probability that an object is bound for each destination; with the rest to one it '
        'is bound for none', gt=0.0, le=1.0)
    x_m: tuple[float, ...] = setting((), 'their positions along the columns [m]')
    y_m: tuple[float, ...] = setting((), 'their positions along the rows, down [m]')
    std_m: tuple[float, ...] = setting(
        (), 'their standard deviations in each direction [m]', ge=0.0)
    earliest_frame: tuple[int, ...] = setting(
        (), 'first frame in which an object may arrive, counted from the first that the detector '
        'gets', ge=1)
    latest_frame: tuple[int, ...] = setting(
        (), 'last frame in which it may arrive; all from earliest_frame on are alike', ge=1)

    def __post_init__(self) -> None:
        check_settings(self)
        for item in fields(self):
            if len(getattr(self, item.name)) != len(self.probability):
                raise ValueError(
                    f'Destinations.{item.name} has {len(getattr(self, item.name))} elements, '
                    f'must have one for each of the {len(self.probability)} of probability')
        if sum(self.probability) > 1.0 + 1e-9:
            raise ValueError('Destinations.probability: the sum must be at most 1')
        _ = self.densities

    def check_motion(self, motion: MotionModes) -> None:
        """Check that objects of a motion can reach destinations."""
        if self.densities and not motion.acceleration_density:
            raise ValueError(
                'motion.acceleration_density = 0.0, must be above 0 where there are destinations')

    def check_only(self, destination: Destination) -> None:
        """Check that there is no other destination beside these."""
        if self.densities and destination.probability:
            raise ValueError('destination and destinations exclude each other: set one of them')

    @functools.cached_property
    def densities(self) -> tuple[DestinationDensity, ...]:
        """Return the density of each destination."""
        names = [item.name for item in fields(self)]
        return tuple(
            DestinationDensity(**dict(zip(names, values)))
            for values in zip(*(getattr(self, name) for name in names)))


@dataclass(frozen=True)
class Bound:
    """
    Where objects are bound for.

    Parameters
    ----------
    place : (..., 2) ndarray
        Position x, y of the arrival [m].
    arrival : (...,) ndarray of int
        Its frame; ``UNBOUND`` for none.

    """

    place: np.ndarray
    arrival: np.ndarray

    def __getitem__(self, index: np.ndarray | slice) -> Bound:
        """Return the destinations that an index along the first axis picks."""
        return Bound(self.place[index], self.arrival[index])

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Bound:
        """Return them in cells whose first one moved ``by`` rows and columns."""
        return replace(self, place=self.place - np.multiply(by[::-1], cell_size_m))

    def left_s(self, frame: float, period_s: float) -> np.ndarray:
        """Return the time from a frame to each arrival, (...,) [s]; below 0 after it."""
        left: np.ndarray = (self.arrival - frame) * period_s
        return left

    @classmethod
    def join(cls, parts: Sequence[Bound]) -> Bound:
        """Return the destinations of the objects of all parts, along the last axis of objects."""
        return cls(
            np.concatenate([part.place for part in parts], axis=-2),
            np.concatenate([part.arrival for part in parts], axis=-1))


def draw_bound(
    densities: Sequence[DestinationDensity], shape: tuple[int, ...], rng: np.random.Generator,
) -> Bound:
    """Draw the destinations of objects of a leading shape, of which each has one or none."""
    place, arrival = np.zeros((*shape, 2)), np.full(shape, UNBOUND)
    ends = np.cumsum([each.probability for each in densities])
    chosen = np.searchsorted(ends, rng.random(shape), side='right')
    # Of the same length whatever was chosen, so that each run of a batch has its own stream.
    when, noise = rng.random(shape), standard_normal((*shape, 2), rng)
    for number, each in enumerate(densities):
        own = chosen == number
        place[own] = each.at(noise[own])
        arrival[own] = each.earliest_frame + np.floor(
            len(each.arrivals) * when[own]).astype(int)
    return Bound(place, arrival)


def move_bound(
    motion: MotionModes, states: np.ndarray, modes: np.ndarray, place: np.ndarray,
    left_s: np.ndarray, period_s: float, rng: np.random.Generator,
) -> np.ndarray:
    """
    Draw x_{k+1} given x_k, the mode r_{k+1}, and the destination that each object carries.

    Parameters
    ----------
    motion
        Base motion, with process noise: without it no object could be anywhere else.
    states : (..., N, 4) ndarray
        States x_k [m, m/s].
    modes : (..., N) ndarray of int
        Modes that govern the step.
    place : (..., N, 2) ndarray
        Positions of their arrivals [m].
    left_s : (..., N) ndarray
        Times from the end of the step to their arrivals [s]; below 0 for none.
    period_s
        Time step [s].
    rng
        Source of randomness.

    Returns
    -------
    (..., N, 4) ndarray
        States x_{k+1}.

    """
    moved = motion.move(states, modes, period_s, rng)
    noise = standard_normal((*modes.shape, 2), rng)
    density = motion.acceleration_density
    ahead, left_s = left_s > -period_s / 2.0, np.maximum(left_s, 0.0)
    variance = density * left_s**3 / 3.0
    axis = process_noise_cov(period_s, density)[:2, :2]
    cross = axis[0] + left_s[..., None] * axis[1]
    gain = cross / (cross[..., 0] + left_s * cross[..., 1] + variance)[..., None]
    # A draw of the base motion, corrected by how far its end misses the destination, is a draw
    # of the motion given the destination.
    missing = (
        place + np.sqrt(variance)[..., None] * noise
        - moved[..., POS] - left_s[..., None] * moved[..., VEL]) * ahead[..., None]
    moved[..., POS] += gain[..., :1] * missing
    moved[..., VEL] += gain[..., 1:] * missing
    return moved
