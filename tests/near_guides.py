"""Sketches whose tendon guides stand as near to the hinges as new-fish once had them."""

from dataclasses import replace

from tailbeat.fish import first_draft
from tailbeat.fish.description import Fish
from tailbeat.fish.proportions import GAP, Given, sketch


def sketched(given: Given, narrow: bool = False) -> Fish:
    """A sketch; `narrow`: with guides as near to the hinges as a slender fish has them."""
    drawn = sketch(given)
    if narrow:
        near = [GAP * link.strip[1] for link in drawn.tail]
        tail = [
            replace(
                link, gap=gap, guide=link.guide and (link.guide[0] + gap - link.gap, link.guide[1])
            )
            for link, gap in zip(drawn.tail, near, strict=True)
        ]
        drawn = replace(drawn, tail=tuple(tail))
    return first_draft.described(drawn)
