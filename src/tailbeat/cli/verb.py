"""What the command line knows of a verb before it loads it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Verb:
    """`name` as typed, `place` as `module:function`, first sentence of its help, an example."""

    name: str
    place: str
    sentence: str
    example: str
