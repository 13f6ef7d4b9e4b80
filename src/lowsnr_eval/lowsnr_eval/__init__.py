# SPDX-License-Identifier: Apache-2.0
"""Section VI: scoring, Monte Carlo studies and reports."""
