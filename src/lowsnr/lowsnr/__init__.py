# SPDX-License-Identifier: Apache-2.0
"""
Detect and track objects too faint to see in a single frame.

An array of frames to tracks::

    import lowsnr

    result = lowsnr.track(frames, detector='sdt', snr_db=8)
    print(result.tracks)

:func:`track` and :func:`detect` take frames of a camera or of a simulation,
:func:`condition` turns frames of a camera into those that detectors expect, :func:`calibrate`
simulates a threshold, :func:`confirm` sets when tracks are confirmed by frames without objects,
and :func:`simulate` makes frames of a scenario with their truth.  They run the algorithms,
settings, thresholds and random streams of the ROS 2 node graph, and give its results.  The
algorithms themselves are public in ``lowsnr_sensor``, ``lowsnr_detect`` and ``lowsnr_track``.

An error in an argument is a :class:`ValueError` of one line that names the argument and the
remedy.  Arrays that are passed in are never written to.
"""

from lowsnr.api import calibrate
from lowsnr.api import condition
from lowsnr.api import confirm
from lowsnr.api import detect
from lowsnr.api import simulate
from lowsnr.api import track
from lowsnr.confirmation import RecordedConfirmation
from lowsnr.results import ConditionedFrames
from lowsnr.results import Detections
from lowsnr.results import Simulation
from lowsnr.results import Table
from lowsnr.results import Tracking

__version__ = '0.2.0'
__all__ = [
    'ConditionedFrames', 'Detections', 'RecordedConfirmation', 'Simulation', 'Table', 'Tracking',
    'calibrate', 'condition', 'confirm', 'detect', 'simulate', 'track']
