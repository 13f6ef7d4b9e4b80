# SPDX-License-Identifier: Apache-2.0
"""From options and files to a checked graph."""
