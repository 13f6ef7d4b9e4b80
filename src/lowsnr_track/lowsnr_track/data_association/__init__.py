# SPDX-License-Identifier: Apache-2.0
"""Which detection is of which track: gating, association and joint association."""
