"""Feetech's FT-SCS protocol: packets to bytes and back.

`FF FF | id | length | instruction or status | parameters | checksum`. The length counts what
follows it; the checksum is the inverted sum of all bytes after the header. STS servos send the low
byte first. Negative numbers are a magnitude with a sign bit (the maker's SDK, `sms_sts.py`).
"""

from dataclasses import dataclass, field

HEADER = b"\xff\xff"
PING, READ, WRITE, REBOOT = 0x01, 0x02, 0x03, 0x08
BROADCAST = 0xFE
OVERHEAD = 4  # bytes up to the length
LONGEST = 250  # a larger length is garbage, as in the maker's SDK


@dataclass(frozen=True)
class Packet:
    """One packet. In an answer, `instruction` is the servo's status: bits of its errors."""

    ident: int
    instruction: int
    parameters: bytes = b""


def encode(packet: Packet) -> bytes:
    """The bytes on the wire."""
    body = bytes([packet.ident, len(packet.parameters) + 2, packet.instruction])
    body += packet.parameters
    return HEADER + body + bytes([~sum(body) & 0xFF])


def signed(word: int, bit: int = 15) -> int:
    """The number of a magnitude with a sign bit."""
    return -(word & ~(1 << bit)) if word >> bit & 1 else word


def with_sign(number: int, bit: int = 15) -> int:
    """A number as a magnitude with a sign bit."""
    return -number | 1 << bit if number < 0 else number


@dataclass(eq=False)
class Parser:
    """Finds packets in a stream that may begin anywhere and contain garbage. `bad` counts what
    looked like a packet but was not one."""

    held: bytearray = field(default_factory=bytearray)
    bad: int = 0

    def feed(self, data: bytes) -> list[Packet]:
        """Packets that `data` completes."""
        self.held += data
        found = []
        while (length := self._length()) is not None:
            whole = bytes(self.held[:length])
            if ~sum(whole[2:-1]) & 0xFF == whole[-1]:
                found.append(Packet(whole[2], whole[4], whole[5:-1]))
                del self.held[:length]
            else:
                self._skip()
        return found

    def _length(self) -> int | None:
        """Length of the packet at the front once it is complete; garbage before it is dropped."""
        while True:
            start = self.held.find(HEADER)
            if start < 0:  # the last byte may be the beginning of a header
                del self.held[: max(len(self.held) - 1, 0)]
                return None
            del self.held[:start]
            if len(self.held) < OVERHEAD:
                return None
            ident, length = self.held[2], self.held[3]
            if ident == 0xFF or not 2 <= length <= LONGEST:
                self._skip()
                continue
            whole = OVERHEAD + length
            return whole if len(self.held) >= whole else None

    def _skip(self) -> None:
        self.bad += 1
        del self.held[:1]
