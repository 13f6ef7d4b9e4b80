# SPDX-License-Identifier: Apache-2.0
"""The verbs of ``ros2`` that look at a running graph."""
