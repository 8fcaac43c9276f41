"""The built site holds together: every link inside it leads somewhere, and nothing is loaded from outside.

`python -m tools.site_links out/site`; one line a fault, exit code 1 where there is one. Links to other sites
are not followed: a build must not depend on them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Attributes whose target the browser loads with the page; `href` of a link to click is not among them.
LOADED = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src"), ("source", "src")}
#: Links of this kind say something about a page and load nothing.
SAYING = {"canonical", "next", "prev", "search", "index", "author", "copyright", "up", "top"}


@dataclass
class Page(HTMLParser):
    """Targets and anchors of one page.

    Attributes
    ----------
    links : list of str
        What is clicked.
    loaded : list of str
        What is loaded with the page.
    anchors : set of str
        Names that a link may end in.
    """

    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take a tag's targets and names."""
        values = {name: value or "" for name, value in attrs}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        for name in ("href", "src"):
            if name in values and not (tag == "link" and set(values.get("rel", "").split()) & SAYING):
                (self.loaded if (tag, name) in LOADED else self.links).append(values[name])


def faults(folder: Path) -> list[str]:
    """What is wrong with a built site, a sentence each.

    Parameters
    ----------
    folder : Path
        Holds index.html.

    Returns
    -------
    sentences : list of str
        In the order of the pages.
    """
    files = [path.resolve() for path in sorted(folder.rglob("*.html")) if "_static" not in path.parts]
    pages = {path: Page() for path in files}
    for path, page in pages.items():
        page.feed(path.read_text(encoding="utf-8"))
    sentences = [] if pages else [f"{folder} has no page"]
    for path, page in pages.items():
        name = path.relative_to(folder.resolve())
        outside = [target for target in page.loaded if urlsplit(target).scheme in ("http", "https")]
        sentences += [f"{name} loads {target} from outside" for target in outside]
        for target in dict.fromkeys(page.links + page.loaded):
            sentences += [f"{name} links to {target}: {why}" for why in wrong_with(target, path, pages)]
    return sentences


def wrong_with(target: str, path: Path, pages: dict[Path, Page]) -> list[str]:
    """Why a link inside the site leads nowhere; empty where it leads somewhere, or out of the site."""
    address = urlsplit(target)
    if address.scheme or address.netloc:
        return []
    file = (path.parent / unquote(address.path)).resolve() if address.path else path
    if file.is_dir():
        file = file / "index.html"
    if not file.exists():
        return ["there is no such file"]
    anchor = unquote(address.fragment)
    if anchor and file in pages and anchor not in pages[file].anchors:
        return ["the page has no such place"]
    return []


def main() -> int:
    """Say what is wrong with the folder that the first argument names."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/site")
    sentences = faults(folder)
    print("\n".join(sentences) or f"{folder.resolve() / 'index.html'}: every link inside leads somewhere")
    return bool(sentences)


if __name__ == "__main__":
    sys.exit(main())
