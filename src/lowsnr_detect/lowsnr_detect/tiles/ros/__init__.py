# SPDX-License-Identifier: Apache-2.0
"""The messages between tiles and their merger."""
