# SPDX-License-Identifier: Apache-2.0
"""Models, statistics and loops that several detectors use."""
