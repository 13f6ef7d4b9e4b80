# SPDX-License-Identifier: Apache-2.0
"""Models of the noise in a cell, of the intensity of an object, and their likelihood ratios."""
