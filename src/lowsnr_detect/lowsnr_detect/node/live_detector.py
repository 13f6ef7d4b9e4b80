"""A detector at work, and how its settings change from a frame to the next."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from functools import partial
from typing import Any

from lowsnr_common.settings.config import flat_values
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.calibration import at_operating_point
from lowsnr_detect.node.tuner import Tuner
from lowsnr_detect.parts.detector import Declarations
import numpy as np

# The operating points at which a setting acts, where these are not all.
_ACTS_AT = {
    'threshold': ('manual',), 'upper_threshold': ('manual', 'matched'),
    'false_alarm_prob': ('matched',)}

Settings = tuple[Any, DetectionSettings]


class LiveDetector:
    """
    A detector with the thresholds of its operating point, and its memory.

    Parameters
    ----------
    name
        Name it is registered under, for the log.
    settings
        Detector with the threshold set by hand, and its operating point.
    shape
        Rows and columns of a frame.
    log, complain
        Told what happens, a sentence at a time; the second, what went wrong.

    """

    def __init__(
        self, name: str, settings: Settings, shape: tuple[int, int],
        log: Callable[[str], None], complain: Callable[[str], None],
    ) -> None:
        self.settings = settings
        self.shape = shape
        self._tune = partial(at_operating_point, name, shape=shape, log=log)
        self._log, self._complain = log, complain
        self._tuner = Tuner()
        self._detector = self._tune(*settings)
        self._memory = self._detector.init(shape)

    def step(self, frame: np.ndarray, rng: np.random.Generator) -> Declarations:
        """Advance by a frame (rows, cols) and return what is declared in it."""
        self._memory, declared = self._detector.step(self._memory, frame, rng)
        return declared

    def thresholds(self) -> dict[str, float]:
        """Return the thresholds in force [nat], by name."""
        values = flat_values(self._detector)
        return {name: values[name] for name in ('threshold', 'upper_threshold') if name in values}

    def change(self, settings: Settings, number: int) -> None:
        """
        Go over to other settings, at once or when the threshold for them is calibrated.

        Until then all is as it was.  ``number`` is that of the next frame.
        """
        self._tuner.give_up()
        self._wanted = settings
        if settings[1].operating_point == 'matched':
            self._tuner.start(partial(self._tune, *settings))
        else:
            self._adopt(self._tune(*settings), number)

    def settle(self, number: int) -> bool:
        """
        Put in force what was calibrated meanwhile.

        Returns whether it could be; otherwise ``settings`` stay those in force.
        """
        if (done := self._tuner.finished()) is None:
            return True
        try:
            detector = done.result()
        except (ValueError, MemoryError) as error:
            self._complain(f'not calibrated, so all stays as it is: {error}')
            return False
        self._adopt(detector, number)
        return True

    def close(self) -> None:
        """End a calibration that is under way."""
        self._tuner.close()

    def _adopt(self, detector: Any, number: int) -> None:
        # Sums of log ratios for one intensity say nothing for another.
        forgets = detector.sensor != self._detector.sensor
        if forgets:
            self._memory = detector.init(self.shape)
        self._detector, self.settings = detector, self._wanted
        held = ', '.join(f'{name} {value:.2f} nat' for name, value in self.thresholds().items())
        self._log(
            f'in force from frame {number} on: {self.settings[1].operating_point}, {held}, '
            f'design SNR {detector.sensor.snr_db:g} dB, memory '
            + ('begins anew' if forgets else 'kept'))


def refuse_without_effect(names: Iterable[str], settings: Settings) -> None:
    """
    Refuse to change settings that would do nothing, or more than they say.

    Parameters
    ----------
    names
        Settings that are to be changed.
    settings
        Detector and operating point with these changes.

    Raises
    ------
    ValueError
        For the first that does nothing at the operating point, and for a design SNR, with
        which the memory begins anew, where frames are counted from the start.

    """
    detector, operating = settings
    point = operating.operating_point
    for name in names:
        if point not in (acts_at := _ACTS_AT.get(name, (point,))):
            raise ValueError(
                f'{name} does nothing while operating_point is {point!r}; set operating_point '
                f'to {" or ".join(map(repr, acts_at))} first, or with it')
        destination = getattr(detector, 'destination', None)
        if name == 'sensor.snr_db' and destination and destination.probability:
            raise ValueError(
                'sensor.snr_db is read-only where destination.probability is above 0: its '
                'arrival_frame is counted from the first frame')
