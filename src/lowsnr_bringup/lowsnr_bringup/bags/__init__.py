# SPDX-License-Identifier: Apache-2.0
"""Rosbag2 bags: written, read, repaired, replayed, and made of files."""
