# SPDX-License-Identifier: Apache-2.0
"""Pages, figures, tables and overlays."""
