# SPDX-License-Identifier: Apache-2.0
"""What bring-up hears of a run: from its own nodes, of the frames, and from other parts."""
