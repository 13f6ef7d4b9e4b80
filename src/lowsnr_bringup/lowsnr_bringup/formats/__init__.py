# SPDX-License-Identifier: Apache-2.0
"""Formats of files with frames, read within bounds whatever a file declares."""
