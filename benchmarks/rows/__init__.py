# SPDX-License-Identifier: Apache-2.0
"""The rows of the table of performance, one module for each kind."""
