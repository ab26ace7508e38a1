"""Markdown: tables, marked parts, code."""

import re


def marked(text: str, name: str, content: str) -> str:
    """``text`` with the part between the marks of ``name`` replaced."""
    start, end = f"<!-- docs/make.py: {name} -->", "<!-- docs/make.py: end -->"
    before, found, rest = text.partition(start)
    _old, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"the marks of {name!r} are missing")
    return f"{before}{start}\n{content}{end}{after}"


def markdown_table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    escaped = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    lines = [head, ["---"] * len(head), *escaped]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def single(text: str) -> str:
    """``text`` with the double backticks of docstrings made single."""
    return re.sub(r"(?<!`)``(?!`)", "`", text)
