# SPDX-License-Identifier: Apache-2.0
"""The messages between tiles and the node that joins them."""
