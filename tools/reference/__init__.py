"""The pages of the site's reference, made from the code that they describe."""

from reference import api

INDEX = """# Reference

These pages are made from the code when the site is built.

| page | what it lists |
|---|---|
| [Python](python.md) | every public name of `import tailbeat as tb` |
"""


def pages() -> dict[str, str]:
    """Markdown by path below `reference/`."""
    return {"index.md": INDEX, "python.md": api.page()}
