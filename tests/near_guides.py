"""Sketches whose tendon guides stand as near to the hinges as new-fish once had them."""

from dataclasses import replace

from tailbeat.fish import first_draft
from tailbeat.fish.description import Fish
from tailbeat.fish.proportions import GAP, Given, sketch


def sketched(given: Given, narrow: bool = False) -> Fish:
    """A sketch; `narrow`: with guides as near to the hinges as a slender fish has them."""
    drawn = sketch(given)
    if narrow:
        near = GAP * drawn.tail[0].strip[1]
        moved = near - drawn.tail[0].gap
        tail = [
            replace(link, gap=near, guide=link.guide and (link.guide[0] + moved, link.guide[1]))
            for link in drawn.tail
        ]
        drawn = replace(drawn, tail=tuple(tail))
    return first_draft.described(drawn)
