# SPDX-License-Identifier: Apache-2.0
"""
A detector in several nodes, each with a tile of the frame, and a merger of what they find.

A tile is computed with a halo of cells around it, so that its statistic is that of the whole
frame.  A tile sends all cells above the threshold, not its declarations, because what is declared
near a seam depends on both sides: the cells are thinned together, as those of one detector.
"""
