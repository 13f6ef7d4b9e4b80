# SPDX-License-Identifier: Apache-2.0
"""Data association and the multiple-model particle filter."""
