# SPDX-License-Identifier: Apache-2.0
"""From the frames of a real camera to what detectors expect."""
