# SPDX-License-Identifier: Apache-2.0
"""Section II: scenarios, simulated sensor, conditioning of real frames."""
