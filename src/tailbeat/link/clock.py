"""What two ends of the link know of each other: the clocks' offset, and what was lost."""

import math
from collections import deque
from dataclasses import dataclass, field

SECOND = 1_000_000_000  # ns
OFFSET_MEMORY = 20 * SECOND
DRIFT = 50e-6  # of two quartz clocks, largest
LOSS_OVER = 300  # datagrams, five seconds of frames


@dataclass(eq=False)
class Clock:
    """Sender's clock less ours, from echoes; the one with the shortest way counts."""

    echoes: deque[tuple[int, int, int]] = field(default_factory=deque)  # when, offset, round trip

    def add(self, asked: int, received: int, sent: int, now: int) -> None:
        """One echo [ns]: asked and heard on our clock, received and sent on theirs."""
        offset = ((received - asked) + (sent - now)) // 2
        self.echoes.append((now, offset, (now - asked) - (sent - received)))
        while now - self.echoes[0][0] > OFFSET_MEMORY:
            self.echoes.popleft()

    def offset(self, now: int) -> tuple[int, int] | None:
        """Offset and how far it may be off [ns], or None before the first echo."""
        if not self.echoes:
            return None
        when, offset, trip = min(self.echoes, key=lambda echo: echo[2])
        return offset, trip // 2 + round(DRIFT * abs(now - when))


@dataclass(eq=False)
class Loss:
    """Share of numbered datagrams that did not come, over the last so many that did."""

    heard: deque[int] = field(default_factory=lambda: deque(maxlen=LOSS_OVER))

    def add(self, sequence: int) -> None:
        """One that came, its number above all before."""
        self.heard.append(sequence)

    def share(self) -> float:
        """0 to 1; NaN before two have come."""
        if len(self.heard) < 2:
            return math.nan
        return 1 - (len(self.heard) - 1) / (self.heard[-1] - self.heard[0])
