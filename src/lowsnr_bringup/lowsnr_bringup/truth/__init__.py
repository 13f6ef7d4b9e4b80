# SPDX-License-Identifier: Apache-2.0
"""Where the objects truly are, from tables and boxes that others made."""
