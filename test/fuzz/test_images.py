# SPDX-License-Identifier: Apache-2.0
"""An image with any header and any data becomes an array, or is rejected in one line."""

from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.messages import images
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.messages import image_to_frame
from lowsnr_eval.report.palette import stretch
import numpy as np


@fuzz('images', 1500, image=images())
def test_image_becomes_an_array_or_is_rejected(image):
    array, frame = tried('', image_to_array, image), tried('', image_to_frame, image)
    if array is not None:
        assert array.shape == (image.height, image.width)
        assert array.size
        assert not np.isinf(array).any()
        assert stretch(array).shape == array.shape
    if frame is not None:
        assert array is not None
        assert frame.dtype == np.float64
        np.testing.assert_array_equal(frame, array)
        assert np.isfinite(frame).all()
