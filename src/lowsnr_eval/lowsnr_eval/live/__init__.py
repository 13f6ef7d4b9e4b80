# SPDX-License-Identifier: Apache-2.0
"""The live page of a viewer: what it shows, and the server that brings it to browsers."""
