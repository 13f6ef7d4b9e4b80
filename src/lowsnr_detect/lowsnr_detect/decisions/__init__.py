# SPDX-License-Identifier: Apache-2.0
"""Whether an object is declared, and where: by one expected cost of both."""
