"""What damaged and hostile files, full disks and killed commands end in, and the table of it in a page."""

from __future__ import annotations

from pathlib import Path


def write_table(page: Path, text: str, tool: str) -> None:
    """Put a text between the two lines of a page that name the tool and end its table."""
    begin, end = f"<!-- table of {tool} -->\n", f"<!-- end of {tool} -->\n"
    head, found, rest = page.read_text(encoding="utf-8").partition(begin)
    tail = rest.partition(end)[2]
    if not found or end not in rest:
        raise SystemExit(f"{page} has no lines {begin.strip()} and {end.strip()}")
    page.write_text(f"{head}{begin}{text}\n{end}{tail}", encoding="utf-8")
