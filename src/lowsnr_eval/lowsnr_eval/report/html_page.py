# SPDX-License-Identifier: Apache-2.0
"""HTML pages that hold all that they show: they load no script, style or picture."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from collections.abc import Sequence
import html
from importlib.resources import files
from string import Template

from lowsnr_common.settings.text import printable_lines
from lowsnr_eval.report.software import software


def _shown(text: object) -> str:
    """Return a text as HTML that shows it, and characters that do not print escaped."""
    return html.escape(printable_lines(text))


class Markup(str):
    """Text that is HTML already."""


def asset(name: str) -> str:
    """Return the text of a file in ``assets/``."""
    return files('lowsnr_eval.report').joinpath('assets', name).read_text('utf-8').strip()


def fill(name: str, **values: object) -> Markup:
    """Return a template of ``assets/`` with values, of HTML, for its ``$names``."""
    return Markup(Template(asset(name)).substitute(values) + '\n')


def page(title: str, sections: Iterable[str], connects: bool = False) -> Markup:
    """Return a whole page; only one that ``connects`` may ask its own server for anything."""
    return fill('page.html', title=_shown(title), style=asset('page.css'),
                body='\n'.join(sections), connect="'self'" if connects else "'none'")


def section(title: str, *parts: str) -> Markup:
    """Return a section with a heading; plain text becomes paragraphs."""
    body = '\n'.join(part if isinstance(part, Markup) else f'<p>{_shown(part)}</p>'
                     for part in parts)
    return Markup(f'<section>\n<h2>{_shown(title)}</h2>\n{body}\n</section>')


def table(headers: Sequence[str], rows: Iterable[Sequence[object]]) -> Markup:
    """Return a table; numbers are aligned to the right, and None is a dash."""
    head = ''.join(f'<th>{_shown(name)}</th>' for name in headers)
    body = '\n'.join(f'<tr>{"".join(map(_cell, row))}</tr>' for row in rows)
    return Markup(f'<div class="wide"><table>\n<tr>{head}</tr>\n{body}\n</table></div>')


def picture(svg: str, caption: str) -> Markup:
    """Return a figure of an SVG."""
    data = base64.b64encode(svg.encode()).decode()
    return Markup(
        f'<figure class="picture"><img alt="{_shown(caption)}" '
        f'src="data:image/svg+xml;base64,{data}">'
        f'<figcaption>{_shown(caption)}</figcaption></figure>')


def preformatted(text: str) -> Markup:
    """Return text in a box, with its spaces and line breaks."""
    return Markup(f'<pre>{_shown(text)}</pre>')


def folded(title: str, content: str) -> Markup:
    """Return content that the reader can unfold."""
    return Markup(f'<details><summary>{_shown(title)}</summary>{content}</details>')


def versions() -> Markup:
    """Return a table of the software that the numbers come from."""
    return table(('software', 'version'), software())


def _cell(value: object) -> str:
    if isinstance(value, Markup):
        return f'<td>{value}</td>'
    if value is None:
        return '<td class="n">–</td>'
    if isinstance(value, float):
        return f'<td class="n">{value:.3g}</td>'
    kind = ' class="n"' if isinstance(value, int) else ''
    return f'<td{kind}>{_shown(value)}</td>'
