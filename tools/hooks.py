"""What MkDocs calls while it builds the site: see `hooks` in mkdocs.yml."""

import re
from typing import Any

from mkdocs.structure.files import File, Files

import reference

# A link that leaves docs/: to a script, a fish file, CONTRIBUTING.
OUTSIDE = re.compile(r"\]\((?:\.\./)+(?=(?:examples|src|tests|tools)/|[A-Z][A-Z.a-z]*\b)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the reference."""
    for path, text in reference.pages().items():
        files.append(File.generated(config, f"reference/{path}", content=text))
    return files


def on_page_markdown(markdown: str, config: Any, **_: Any) -> str:
    """Point links that leave docs/ to the repository, where GitHub shows the same file."""
    return OUTSIDE.sub(f"]({config.extra['repository']}/blob/main/", markdown)
