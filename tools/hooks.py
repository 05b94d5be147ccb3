"""What MkDocs calls while it builds the site: see `hooks` in mkdocs.yml."""

import posixpath
import re
from typing import Any

from mkdocs.structure.files import File, Files

import reference

# A link that leaves docs/: to a script, a fish file, CONTRIBUTING.
OUTSIDE = re.compile(r"\]\((?:\.\./)+(?=(?:examples|src|tests|tools)/|[A-Z][A-Z.a-z]*\b)")

NAMED = re.compile(r"(?<![\w/`])docs/([\w/-]+\.md)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the reference."""
    for path, text in reference.pages().items():
        files.append(File.generated(config, f"reference/{path}", content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Point links that leave docs/ to the repository, where GitHub shows the same file. A page of
    the reference names pages as the source does, `docs/explain/twin.md`: these become links."""
    here = posixpath.dirname(page.file.src_uri)
    if here.startswith("reference"):
        markdown = NAMED.sub(lambda m: f"[{m[1]}]({posixpath.relpath(m[1], here)})", markdown)
    return OUTSIDE.sub(f"]({config.extra['repository']}/blob/main/", markdown)
