"""The page of the Python API: one entry for each public name."""

import tailbeat

HEAD = """# Python

`import tailbeat as tb` imports nothing else. Each name is imported when it is first used.
"""


def page() -> str:
    """The page, in mkdocstrings' notation."""
    names = [name for name in tailbeat.__all__ if not name.startswith("_")]
    return "\n".join([HEAD, *(f"::: tailbeat.{name}\n" for name in names)])
