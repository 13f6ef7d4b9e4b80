"""The refusal of a message that cannot be used."""

from __future__ import annotations


class Malformed(ValueError):
    """
    A message cannot be used.

    Parameters
    ----------
    reason
        Why, in words that are the same for all such messages, to count them by.
    sentence
        Why, with the values of this one.

    """

    def __init__(self, reason: str, sentence: str) -> None:
        super().__init__(sentence)
        self.reason = reason
