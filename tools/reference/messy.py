"""The page of the messy pool: every nuisance with its sizes and source."""

from reference.markdown import code, page, table
from tailbeat.evaluate.advice import ADVICE
from tailbeat.pool.mess import LEVELS, NUISANCES, fingerprint

HEAD = """What labs get wrong, as drawn for one lab. `evaluate --tasks messy` swims at these levels,
`margins` one nuisance at a time. All are 0 in every other trial. [Messy
labs](../explain/messy-labs.md) explains how they act."""


def messy_page() -> str:
    """Markdown of the page."""
    levels = ", ".join(f"{name} {factor:g}" for name, factor in LEVELS.items())
    rows = [
        [one.name, f"{one.everyday:g} {one.unit}", f"{one.most:g} {one.unit}", one.what, one.source]
        for one in NUISANCES
    ]
    columns = ["nuisance", "everyday", "largest", "what it is", "source of the size"]
    advice = table(["nuisance", "what widens its margin"], [[k, v] for k, v in ADVICE.items()])
    frozen = f"Levels, in everyday sizes: {levels}. Fingerprint {code(fingerprint())}."
    return page("Messy pool", HEAD, frozen, table(columns, rows), "## What to do", advice)
