# SPDX-License-Identifier: Apache-2.0
"""The one node that runs any detector."""
