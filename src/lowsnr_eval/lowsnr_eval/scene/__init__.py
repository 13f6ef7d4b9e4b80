# SPDX-License-Identifier: Apache-2.0
"""The scene of a run: pictures, marks, and the files that keep them for the report."""
