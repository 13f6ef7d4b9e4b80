# SPDX-License-Identifier: Apache-2.0
"""Plans, starts, supervises and ends a run; bags, recorder, player."""
