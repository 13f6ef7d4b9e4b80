# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo studies of the claims of Section VI."""
