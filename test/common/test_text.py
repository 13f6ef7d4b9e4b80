# SPDX-License-Identifier: Apache-2.0
"""Text from outside is shown, and does nothing where it is shown."""

from lowsnr_common.settings.text import cell_text
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import printable
from lowsnr_common.settings.text import printable_lines
import pytest

# A cleared screen, a forged line, a title of the terminal, reversed writing, half a character.
HOSTILE = '\x1b[2J\r\nbringup.py: all is well\x1b]0;x\x07\u202e\u2028\x9b31m\0\ud800'


def test_nothing_in_a_printable_text_acts_and_nothing_is_lost():
    shown = printable(HOSTILE)
    assert shown.isprintable()
    assert shown.encode('ascii').decode('unicode_escape') == HOSTILE
    assert printable('object 7, é 物体 😀') == 'object 7, é 物体 😀'


def test_lines_of_ours_are_kept():
    assert printable_lines('one\n  two\x1b[2J\n\rthree') == 'one\n  two\\x1b[2J\n\\rthree'


def test_message_is_one_line_that_shows_what_does_not_print():
    assert one_line(' a\n\tb\x1b[2J\u202ec ') == r'a b\x1b[2J\u202ec'
    assert len(one_line('x' * 10_000)) < 700


@pytest.mark.parametrize(('text', 'cell'), [
    ('=1+1', "'=1+1"), ('+1', "'+1"), ('-1', "'-1"), ('@SUM(A1)', "'@SUM(A1)"),
    ('sdt', 'sdt'), ('a=b', 'a=b'), ('', '')])
def test_no_cell_is_a_formula(text, cell):
    assert cell_text(text) == cell
