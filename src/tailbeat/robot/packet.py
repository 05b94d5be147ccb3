"""Dynamixel Protocol 2.0: packets to bytes and back (ROBOTIS e-manual, protocol 2.0).

`FF FF FD 00 | id | length (2) | instruction | parameters | CRC-16 (2)`, little endian; inside
instruction and parameters an FD follows every FF FF FD (stuffing), which the length counts. The CRC
is taken after stuffing.
"""

from dataclasses import dataclass, field

HEADER = b"\xff\xff\xfd\x00"
MARK, STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
PING, READ, WRITE, REBOOT, STATUS = 0x01, 0x02, 0x03, 0x08, 0x55
BROADCAST = 0xFE
OVERHEAD = 7  # bytes before the instruction
LONGEST = 1024  # a larger length is garbage: no control table is so large
ALERT = 0x80  # bit of a status's error byte: a hardware error; the data are valid
ERRORS = {
    1: "result fail",
    2: "unknown instruction",
    3: "CRC",
    4: "data range",
    5: "data length",
    6: "data limit",
    7: "access",
}
POLYNOMIAL = 0x8005


def _table() -> tuple[int, ...]:
    rows = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = ((value << 1) ^ POLYNOMIAL if value & 0x8000 else value << 1) & 0xFFFF
        rows.append(value)
    return tuple(rows)


TABLE = _table()


def crc16(data: bytes) -> int:
    """CRC-16: polynomial 0x8005, initial value 0, most significant bit first, not reflected."""
    value = 0
    for byte in data:
        value = ((value << 8) & 0xFFFF) ^ TABLE[(value >> 8) ^ byte]
    return value


@dataclass(frozen=True)
class Packet:
    """One packet. In a status packet, `instruction` is 0x55 and the first parameter is its error
    byte."""

    ident: int
    instruction: int
    parameters: bytes = b""

    @property
    def error(self) -> int:
        """Error number of a status packet, without the alert bit."""
        return self.parameters[0] & ~ALERT

    @property
    def alert(self) -> bool:
        """Whether there is a hardware error."""
        return bool(self.parameters[0] & ALERT)

    @property
    def data(self) -> bytes:
        """Data of a status packet."""
        return self.parameters[1:]


def encode(packet: Packet) -> bytes:
    """The bytes on the wire."""
    body = bytes([packet.instruction]) + packet.parameters
    body = body.replace(MARK, STUFFED)
    whole = HEADER + bytes([packet.ident]) + (len(body) + 2).to_bytes(2, "little") + body
    return whole + crc16(whole).to_bytes(2, "little")


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
            if crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little"):
                body = whole[OVERHEAD:-2].replace(STUFFED, MARK)
                found.append(Packet(whole[4], body[0], body[1:]))
                del self.held[:length]
            else:
                self._skip()
        return found

    def _length(self) -> int | None:
        """Length of the packet at the front once it is complete; garbage before it is dropped."""
        while True:
            start = self.held.find(HEADER)
            if start < 0:  # the last bytes may be the beginning of a header
                del self.held[: max(len(self.held) - len(HEADER) + 1, 0)]
                return None
            del self.held[:start]
            if len(self.held) < OVERHEAD:
                return None
            length = int.from_bytes(self.held[5:7], "little")
            if not 3 <= length <= LONGEST:
                self._skip()
                continue
            whole = OVERHEAD + length
            return whole if len(self.held) >= whole else None

    def _skip(self) -> None:
        self.bad += 1
        del self.held[:1]
