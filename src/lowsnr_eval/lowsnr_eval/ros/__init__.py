# SPDX-License-Identifier: Apache-2.0
"""Messages of recorded runs and of viewers."""
