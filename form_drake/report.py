"""Self-contained HTML reports: headings, paragraphs, tables and matplotlib figures in one file."""

import base64
import io
from collections.abc import Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from form_drake.files import write_text

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
  color: #1d232b; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.2rem; border-top: 1px solid #d5dae0; padding-top: 1rem; }
table { border-collapse: collapse; } th, td { padding: .3rem .9rem; text-align: right;
  border-bottom: 1px solid #e3e7eb; } th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } footer { margin-top: 3rem; color: #6a737d; font-size: 85%; }
"""


class Report:
    """A page that grows part by part.

    Args:
        title: heading of the page.
    """

    def __init__(self, title: str):
        self._title = title
        self._parts = [f"<h1>{escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """A section's heading."""
        self._parts.append(f"<h2>{escape(text)}</h2>")

    def paragraph(self, text: str) -> None:
        """A paragraph of plain text."""
        self._parts.append(f"<p>{escape(text)}</p>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table of plain text."""
        cells = "".join(f"<th>{escape(c)}</th>" for c in head)
        lines = [f"<tr>{cells}</tr>"]
        for row in rows:
            lines.append("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>")
        self._parts.append(f"<table>{''.join(lines)}</table>")

    def figure(self, figure: Any, caption: str) -> None:
        """A matplotlib figure with its caption."""
        _literal(figure)
        image = io.BytesIO()
        # tight: drawn twice, first to see its size
        box = "tight" if figure.get_layout_engine() is None else None
        figure.savefig(image, format="png", dpi=110, bbox_inches=box)
        self._picture(image.getvalue(), caption)

    def image(self, path: Path, caption: str) -> None:
        """A PNG file with its caption, taken into the page."""
        self._picture(path.read_bytes(), caption)

    def _picture(self, png: bytes, caption: str) -> None:
        data = base64.b64encode(png).decode()
        text = escape(caption)
        self._parts.append(
            f'<figure><img alt="{text}" src="data:image/png;base64,{data}">'
            f"<figcaption>{text}</figcaption></figure>"
        )

    def write(self, path: Path) -> None:
        """Write the page, whole."""
        footer = f"<footer>form_drake {version('form-drake')}, Warp {version('warp-lang')}</footer>"
        page = (
            '<!doctype html><html lang="en"><meta charset="utf-8">'
            f"<title>{escape(self._title)}</title><style>{STYLE}</style>"
            f"<body>{''.join(self._parts)}{footer}</body></html>\n"
        )
        write_text(path, page)


def _literal(figure: Any) -> None:
    """Names in titles, labels and legends are theirs who gave them: a dollar is no mathematics."""
    for axes in figure.axes:
        legend = axes.get_legend()
        texts = () if legend is None else legend.get_texts()
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label, *texts):
            text.set_parse_math(False)
