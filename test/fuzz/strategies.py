# SPDX-License-Identifier: Apache-2.0
"""Inputs of every kind that a stranger, a broken disk or a mistake could give to the system."""

from hypothesis import strategies as st

# Numbers that break sums, squares, casts and comparisons.
EXTREMES = [
    0.0, -0.0, 1e-320, -1e-320, 1e-9, 0.5, 1.0, -1.0, 1.5, 20.0, 255.0, 65536.0, 2.0**31, 2.0**63,
    -2.0**63, 1e20, 1e38, 3.4e38, -3.4e38, 1e154, 1e155, 1e308, -1e308, float('inf'),
    -float('inf'), float('nan')]
numbers = st.sampled_from(EXTREMES) | st.floats() | st.floats(-2.0, 30.0)
whole = st.sampled_from([
    0, 1, -1, 2**15, 2**31 - 1, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64, 10**400]
) | st.integers()
# Names that break out of a folder, a line, a cell, a tag, a shell or an encoding.
HOSTILE = [
    '', ' ', '.', '..', '../../x', '/etc/passwd', 'a/b', 'a\\b', '~', '$(touch x)', '`id`', ';id',
    '| id', '%n%s', '=1+1', '@SUM(A1)', '+1', '-1', 'a,b', '"', "'", 'a\nb', 'a\r\nb', '\0',
    'a\0b', '\x1b[2J', '<script>alert(1)</script>', '</script><script>x()',
    '<img src=x onerror=x()>', '&amp;', ']]>', '{0}', '{last}', '$x^{$', '_hidden',
    '\u202e', '\u2028', 'é', '物体', '😀',
    '\ufeff', 'a' * 300, 'a' * 5000, 'nan', 'None', 'true', '1', '-0', '1e400']
names = st.sampled_from(HOSTILE) | st.text(max_size=12)
# The same, and names that no encoding can hold.
wild_names = names | st.just('\ud800') | st.text(
    st.characters(codec=None, exclude_categories=()), max_size=6)


@st.composite
def damaged(draw: st.DrawFn, data: bytes, most: int = 8) -> bytes:
    """Return bytes of which some are changed, cut out, repeated or inserted."""
    spoilt = bytearray(data)
    for _ in range(draw(st.integers(1, most))):
        start = draw(st.integers(0, max(0, len(spoilt) - 1)))
        how = draw(st.sampled_from(['flip', 'flip', 'flip', 'huge', 'cut', 'insert', 'repeat']))
        length = draw(st.sampled_from([1, 2, 8, 64, len(spoilt)]))
        if how == 'flip' and spoilt:
            spoilt[start] = draw(st.integers(0, 255))
        elif how == 'huge':  # lengths and counts of the largest values
            spoilt[start:start + 8] = draw(st.sampled_from(
                [b'\xff' * 8, b'\xff' * 7 + b'\x7f', bytes(8), b'\0\0\0\0\0\1\0\0']))
        elif how == 'cut':
            del spoilt[start:start + length]
        elif how == 'insert':
            spoilt[start:start] = draw(st.binary(max_size=16))
        else:
            spoilt[start:start] = spoilt[start:start + min(length, 64)]
    return bytes(spoilt)
