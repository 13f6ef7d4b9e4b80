# SPDX-License-Identifier: Apache-2.0
"""Scores of frames and runs."""
