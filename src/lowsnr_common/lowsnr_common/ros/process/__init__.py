# SPDX-License-Identifier: Apache-2.0
"""What the nodes of one process share: their executor, and topics between them."""
