"""Clock offset between the two ends of the link, and datagram loss."""

import math
from collections import deque
from dataclasses import dataclass, field

SECOND = 1_000_000_000  # ns
OFFSET_MEMORY = 20 * SECOND
DRIFT = 50e-6  # largest relative drift of two quartz clocks
LOSS_OVER = 300  # datagrams, five seconds of frames


@dataclass(eq=False)
class Clock:
    """Sender's clock minus ours, from echoes. The echo with the shortest round trip is used."""

    echoes: deque[tuple[int, int, int]] = field(default_factory=deque)  # ns: now, offset, trip

    def add(self, asked: int, received: int, sent: int, now: int) -> None:
        """Add one echo. `asked` and `now` [ns] are on our clock, `received` and `sent` on the
        sender's."""
        offset = ((received - asked) + (sent - now)) // 2
        self.echoes.append((now, offset, (now - asked) - (sent - received)))
        while now - self.echoes[0][0] > OFFSET_MEMORY:
            self.echoes.popleft()

    def offset(self, now: int) -> tuple[int, int] | None:
        """Offset and its largest error [ns] at `now`, or None before the first echo."""
        if not self.echoes:
            return None
        when, offset, trip = min(self.echoes, key=lambda echo: echo[2])
        return offset, trip // 2 + round(DRIFT * abs(now - when))


@dataclass(eq=False)
class Loss:
    """Fraction of numbered datagrams that were lost, over the last ones that arrived."""

    heard: deque[int] = field(default_factory=lambda: deque(maxlen=LOSS_OVER))

    def add(self, sequence: int) -> None:
        """Count a datagram that arrived; its number must be above all earlier ones (not
        checked)."""
        self.heard.append(sequence)

    def share(self) -> float:
        """Fraction lost, 0 to 1; NaN before two datagrams have arrived."""
        if len(self.heard) < 2:
            return math.nan
        return 1 - (len(self.heard) - 1) / (self.heard[-1] - self.heard[0])
