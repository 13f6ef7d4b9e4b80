"""Pages that need nothing but themselves: no script, style or picture from elsewhere."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from collections.abc import Sequence
from html import escape
from importlib.metadata import version
import platform
import sys

_PACKAGES = ('numpy', 'scipy', 'numba', 'distributed', 'matplotlib')
_CSS = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem; color: #1b1b1b; background: #fff; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.2rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; font-size: 13px; margin: .6rem 0; }
.wide { overflow-x: auto; }
th, td { padding: .2rem .55rem; border-bottom: 1px solid #ddd; text-align: left;
  vertical-align: top; }
th { background: #f3f3f3; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0; } figure img { max-width: 100%; height: auto; }
figcaption, .note { color: #555; font-size: 13px; }
code, pre { background: #f3f3f3; border-radius: 3px; padding: .1rem .3rem; overflow-x: auto; }
.figures { white-space: nowrap; }
.holds { color: #00694a; font-weight: 600; } .fails { color: #a63603; font-weight: 600; }
.open { color: #555; }
"""
_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:;
 style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>{css}</style>
</head>
<body>
<h1>{title}</h1>
{body}
{script}
</body>
</html>
"""


class Markup(str):
    """Text that is HTML already."""


def page(title: str, sections: Iterable[str], script: str = '') -> str:
    """Return a whole page; a script goes to its end."""
    ending = f'<script>\n{script}\n</script>' if script else ''
    return _PAGE.format(
        title=escape(title), css=_CSS, body='\n'.join(sections), script=ending)


def section(title: str, *parts: str) -> Markup:
    """Return a section with a heading; plain text becomes paragraphs."""
    body = '\n'.join(part if isinstance(part, Markup) else f'<p>{escape(part)}</p>'
                     for part in parts)
    return Markup(f'<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>')


def table(headers: Sequence[str], rows: Iterable[Sequence[object]]) -> Markup:
    """Return a table; numbers stand to the right, what does not exist is a dash."""
    head = ''.join(f'<th>{escape(name)}</th>' for name in headers)
    body = '\n'.join(f'<tr>{"".join(map(_cell, row))}</tr>' for row in rows)
    return Markup(f'<div class="wide"><table>\n<tr>{head}</tr>\n{body}\n</table></div>')


def picture(svg: str, caption: str) -> Markup:
    """Return a figure with an SVG in it."""
    data = base64.b64encode(svg.encode()).decode()
    return Markup(
        f'<figure><img alt="{escape(caption)}" src="data:image/svg+xml;base64,{data}">'
        f'<figcaption>{escape(caption)}</figcaption></figure>')


def preformatted(text: str) -> Markup:
    """Return text as it is, in a box."""
    return Markup(f'<pre>{escape(text)}</pre>')


def folded(title: str, content: str) -> Markup:
    """Return content that is shown on demand."""
    return Markup(f'<details><summary>{escape(title)}</summary>{content}</details>')


def versions() -> Markup:
    """Return a table of what the numbers were made with."""
    return table(('software', 'version'), [
        ('Python', sys.version.split()[0]),
        *((name, version(name)) for name in _PACKAGES),
        ('system', platform.platform(terse=True))])


def _cell(value: object) -> str:
    if isinstance(value, Markup):
        return f'<td>{value}</td>'
    if value is None:
        return '<td class="n">–</td>'
    if isinstance(value, float):
        return f'<td class="n">{value:.3g}</td>'
    kind = ' class="n"' if isinstance(value, int) else ''
    return f'<td{kind}>{escape(str(value))}</td>'
